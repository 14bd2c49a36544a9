"""Units that are read without the registry mean what the registry says, and few records need it."""

import subprocess
import sys

import pytest

from residuum.identification import unit_registry
from residuum.identification.common_units import COMMON_UNITS
from residuum.identification.units import _common, compatible, convert, parse_unit


def _values(factors):
    return {named.symbol: (pytest.approx(named.scale), power, dict(named.base), named.offset) for named, power in factors}


@pytest.mark.parametrize("name", COMMON_UNITS)
def test_a_common_unit_is_what_the_registry_knows(name):
    ((known, power),) = unit_registry.factors(name)
    listed = COMMON_UNITS[name]
    assert (listed.symbol, power, dict(listed.base)) == (known.symbol, 1.0, dict(known.base))
    assert listed.scale == pytest.approx(known.scale, rel=1e-12) and listed.offset == pytest.approx(known.offset)


@pytest.mark.parametrize("text", ["kg*m**2/s", "N*m*s/rad", "1/s", "V/A**2", "m**0.5/h", "W/K**4", "kJ/kg/K", "mm/min"])
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
    found = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
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
