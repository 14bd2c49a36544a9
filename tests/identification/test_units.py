"""Units that are read without the registry mean what the registry says, and few records need it."""

import subprocess
import sys

import pytest

from residuum.identification import unit_registry
from residuum.identification.common_units import COMMON_UNITS
from residuum.identification.errors import BadUnit
from residuum.identification.units import _common, compatible, convert, parse_unit


def _values(factors):
    return {
        named.symbol: (pytest.approx(named.scale), power, dict(named.base), named.offset)
        for named, power in factors
    }


@pytest.mark.parametrize("name", COMMON_UNITS)
def test_a_common_unit_is_what_the_registry_knows(name):
    ((known, power),) = unit_registry.factors(name)
    listed = COMMON_UNITS[name]
    assert (listed.symbol, power, dict(listed.base)) == (known.symbol, 1.0, dict(known.base))
    assert listed.scale == pytest.approx(known.scale, rel=1e-12) and listed.offset == pytest.approx(
        known.offset
    )


@pytest.mark.parametrize(
    "text", ["kg*m**2/s", "N*m*s/rad", "1/s", "V/A**2", "m**0.5/h", "W/K**4", "kJ/kg/K", "mm/min"]
)
def test_a_product_is_read_as_the_registry_reads_it(text):
    assert _values(_common(text)) == _values(unit_registry.factors(text))


@pytest.mark.parametrize("text", ["kg m", "(N*m)/s", "ticks/s", "furlong", "N*", "*N", "N**x"])
def test_what_is_no_product_of_common_units_is_left_to_the_registry(text):
    assert _common(text) is None


def test_temperatures_shift_alone_and_are_differences_in_products():
    assert float(convert(68.0, "°F", "°C")) == pytest.approx(20.0)
    assert float(convert(3.0, "W/°C", "W/K")) == pytest.approx(3.0)
    assert compatible("W/°C", "W/K") and not compatible("W/°C", "W")


def test_a_unit_over_itself_is_a_plain_number():
    assert (parse_unit("N*m") / parse_unit("N*m")).factors == ()
    assert (parse_unit("rad/s") * parse_unit("s")).symbols == {"rad": 1.0}


def test_a_model_is_read_without_the_registry():
    script = "import sys, residuum as rs; rs.model('gate-drive'); rs.model('oven'); print('pint' in sys.modules)"
    found = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    assert found.stdout.strip() == "False"


@pytest.mark.parametrize(
    ("written", "meant"),
    [
        ("Nm", "N*m"),
        ("kNm", "kN*m"),
        ("rad/Nm", "rad/(N*m)"),
        ("Nm/rad", "N*m/rad"),
        ("m3/h", "m**3/h"),
        ("U/min", "rpm"),
        ("min-1", "rpm"),
        ("s⁻¹", "1/s"),
    ],
)
def test_spellings_of_loggers_and_data_sheets_are_understood(written, meant):
    assert compatible(written, meant)
    assert float(convert(1.0, written, meant)) == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("written", "meant", "factor"),
    [
        *(("min^-1", "rpm", 1), ("min⁻¹", "rpm", 1), ("rev/min", "rad/s", 0.10472), ("rps", "rad/s", 6.28319)),
        *(("Newtons", "N", 1), ("Volt", "V", 1), ("VDC", "V", 1), ("Amps", "A", 1), ("kOhm", "ohm", 1e3), ("Ncm", "N*m", 1e-2)),
        *(("m/s2", "m/s**2", 1), ("m s-2", "m/s**2", 1), ("W m-2", "W/m**2", 1), ("kg/cm²", "Pa", 98066.5)),
        *(("bar(g)", "Pa", 1e5), ("barg", "Pa", 1e5), ("Mpa", "Pa", 1e6), ("mb", "Pa", 1e2), ("PSI", "Pa", 6894.76)),
        *(("°/s", "rad/s", 0.0174533), ("G", "m/s**2", 9.80665), ("inHg", "Pa", 3386.39), ("days", "h", 24)),
        *(("lpm", "m**3/s", 1 / 60000), ("Nm3/h", "m**3/s", 1 / 3600), ("cfm", "m**3/s", 4.71947e-4), ("ft-lb", "N*m", 1.35582)),
        *(("mil", "m", 2.54e-5), ("pct", "", 0.01), ("kmh", "m/s", 1 / 3.6), ("kvar", "W", 1e3), ("kp", "N", 9.80665)),
    ],
)  # fmt: skip
def test_units_are_read_as_loggers_and_instruments_spell_them(written, meant, factor):
    assert float(convert(1.0, written, meant)) == pytest.approx(factor, rel=1e-4)


@pytest.mark.parametrize("written", ["deg C", "º C", "℃", "oC", "Cel", "DegC", "degrees C"])
def test_a_temperature_shifts_however_it_is_spelled(written):
    assert float(convert(20.0, written, "K")) == pytest.approx(293.15)


@pytest.mark.parametrize(
    ("written", "never"),
    [
        *(
            ("pH", "H"),
            ("RH", "kg*m**2/s**2/A**2"),
            ("point", "m"),
            ("cycle", "rad"),
            ("dB", ""),
            ("U", "mol/s"),
            ("kn", "N"),
        ),
        *(
            ("PSU", "Pa"),
            ("NTU", ""),
            ("grad", "rad"),
            ("pps", "1/s"),
            ("Mpts", "m"),
            ("state", "1"),
            ("ips", "m/s"),
        ),
    ],
)
def test_a_word_that_the_registry_would_misread_is_a_unit_of_its_own(written, never):
    assert compatible(written, written) and not compatible(written, never)


def test_what_one_unit_reads_as_does_not_hang_on_what_was_read_before():
    asked = "print(compatible('kn', 'm/s'), compatible('P', 'Pa*s'))"
    fresh = "from residuum.identification.units import compatible, parse_unit; {}" + asked
    for before in ("", "parse_unit('knot'); parse_unit('cP'); "):
        found = subprocess.run(
            [sys.executable, "-c", fresh.format(before)], capture_output=True, text=True, check=True
        )
        assert found.stdout.strip() == "False False"


@pytest.mark.parametrize(
    ("frequency", "rotation"), [("Hz", "rpm"), ("Hz", "rad/s"), ("1/s", "rad/s"), ("kHz", "deg/s")]
)
def test_a_frequency_is_no_speed_of_rotation_until_somebody_says_what_a_cycle_is(
    frequency, rotation
):
    for one, other in ((frequency, rotation), (rotation, frequency)):
        assert not compatible(one, other)
        with pytest.raises(BadUnit, match=r"units={'speed': 'rev/s'}"):
            convert(1.0, one, other, column="speed")
    assert float(convert(1.0, "rev/s", "rpm")) == pytest.approx(60.0)
