"""Over three hundred spellings of units from the heads of measurement files: the right factor or refused, never another."""

import math

import pytest

from residuum.identification.errors import BadUnit
from residuum.identification.units import convert

G, PSI, LBF = 9.80665, 6894.757293168361, 4.4482216152605
TURN, MINUTE, HOUR = 2 * math.pi, 60.0, 3600.0
SPELLINGS: dict[tuple[str, float], str] = {
    ("V", 1): "V|Volt|volt|Volts|volts|VOLT|VDC|Vdc|V DC|Vrms|V_rms|VAC|V AC",
    ("V*s/rad", 60 / TURN * 1e-3): "V/krpm|V/1000rpm|V/1000 rpm|mV/rpm",
    ("V", 1e-3): "mV|mVolt|millivolt|mVDC|milliVolts",
    ("V", 1e3): "kV|KV|kilovolt",
    ("V", 1e-6): "µV|uV|μV|microvolt",
    ("A", 1): "A(rms)|A|Amp|amp|Amps|amps|Ampere|ampere|amperes|ADC|Arms|A rms",
    ("A", 1e-3): "mA|milliampere|milliamps|mAmps",
    ("A", 1e-6): "µA|uA|μA",
    ("A", 1e3): "kA",
    ("W", 1): "W|Watt|watts|Watts|VA",
    ("W", 1e3): "kW|KW|kVA|kVAr|kvar|kilowatt",
    ("W", 1e6): "MW|MVA|Mvar|megawatt",
    ("W", 1e-3): "mW",
    ("W", 745.6998715822702): "hp|HP",
    ("W", 735.49875): "PS",
    ("J", 1): "J|Joule|joules|Ws|W s|W*s",
    ("J", 1e3): "kJ|kilojoule",
    ("J", 1e6): "MJ",
    ("J", HOUR): "Wh|W*h|watt-hour|watt_hour",
    ("J", 1e3 * HOUR): "kWh|KWH|kwh|kilowatt_hour",
    ("J", 1e6 * HOUR): "MWh",
    ("J", 1e9 * HOUR): "GWh",
    ("W*s", HOUR): "VAh|VARh|varh|Watt-hours",
    ("W*s", 1e3 * HOUR): "kVAh|kvarh|kVARh",
    ("J/kg/K", 1): "J/kgK|J/(kg·K)|J/kg-K",
    ("J/kg", 1e3): "kJ/kg",
    ("A*s", HOUR): "Ah|A*h|A h|A·h|Amp-hours|Amph|Ampere-hours",
    ("A*s", 3.6): "mAh",
    ("A*s", 3.6e6): "kAh",
    ("A*s", 3.6e-3): "µAh|uAh",
    ("A*s", 1): "As|A s|coulomb",
    ("A*s", 1e-12): "pC",
    ("C", HOUR): "Ah|A*h",
    ("C", 3.6): "mAh",
    ("C", 1): "As|A*s|coulomb",
    ("ohm", 1): "Ohm|ohm|Ohms|ohms|OHM|Ω|Ω",
    ("ohm", 1e3): "kOhm|kohm|kΩ|kohms",
    ("ohm", 1e-3): "mOhm|mohm|mΩ",
    ("ohm", 1e6): "MOhm|MΩ|megohm",
    ("F", 1e-6): "µF|uF",
    ("F", 1e-9): "nF",
    ("H", 1e-3): "mH",
    ("1/s", 1): "Hz|hz|HZ|hertz|Hertz|1/s|s^-1|s-1|/s",
    ("1/s", 1e3): "kHz|KHz|khz",
    ("1/s", 1e6): "MHz",
    ("N", 1): "N|Newton|newton|Newtons|newtons",
    ("N", 1e3): "kN|kilonewton",
    ("N", 10): "daN",
    ("N", 1e6): "MN",
    ("N", 1e-3): "mN",
    ("N", G): "kgf|kp",
    ("N", LBF): "lbf",
    ("N*m", 1): "Nm|N.m|N*m|N·m|N m|N-m|Newton-meter|newton_meter",
    ("N*m", 1e3): "kNm|kN*m|kN·m|kN.m",
    ("N*m", 1e-3): "mNm|N*mm|Nmm|mN*m|mN·m",
    ("N*m", 1e-2): "Ncm|N*cm",
    ("N*m", LBF * 0.3048): "ft-lb|lb-ft|ft*lbf|lbf*ft|ft-lbf|lbf-ft|lbf ft",
    ("N*m", LBF * 0.0254): "in-lb|lb-in|in*lbf",
    ("Pa", 1): "Pa|pascal|Pascal|N/m2|N/m^2|N/m²",
    ("Pa", 1e3): "kPa|kpa|KPa|kPa(g)|kN/m2|kPa(a)",
    ("Pa", 1e6): "MPa|Mpa|N/mm2|N/mm²|N/mm^2|MN/m2",
    ("Pa", 1e9): "GPa",
    ("Pa", 0.1): "µbar|ubar",
    ("Pa", 1e3 * PSI): "ksi",
    ("Pa", 1e3 * G): "mH2O|mWS|mWC",
    ("N", 1e3 * LBF): "kip|kips|klbf",
    ("N*s", 1): "Ns",
    ("N*m", G): "kgf·m|kgf-m|kgfm",
    ("N*m", G * 1e-2): "kgf.cm|kgfcm|kgf-cm",
    ("Pa", 100): "hPa|mbar|mb|millibar|mBar",
    ("Pa", 1e5): "bar|Bar|BAR|bara|barg|bar(g)|bar(a)|bar abs",
    ("Pa", PSI): "psi|PSI|psig|psia|Psi|lbf/in2|lb/in²",
    ("Pa", G * 1e4): "kg/cm2|kgf/cm2|kgf/cm²|at",
    ("Pa", 101325): "atm",
    ("Pa", 133.322387415): "mmHg|mm Hg",
    ("Pa", 249.08891): "inH2O|in H2O|inWC|inwc|in.H2O",
    ("Pa", 9.80665): "mmH2O|mmWS",
    ("Pa", 3386.388640341): "inHg|in Hg",
    ("m", 1): "m|meter|metre|meters|Meter",
    ("m", 1e-3): "mm|millimeter|millimetre",
    ("m", 1e-2): "cm|centimeter",
    ("m", 1e3): "km|kilometer",
    ("m", 1e-6): "µm|um|micron|μm|microns|micrometer",
    ("m", 1e-9): "nm|nanometer",
    ("m", 0.0254): 'in|inch|inches|"|Zoll',
    ("m", 0.3048): "ft|feet|foot",
    ("m", 2.54e-5): "mil|mils|thou",
    ("m", 1609.344): "mile|mi",
    ("m**2", 1): "m2|m^2|m²|sqm",
    ("m**2", 1e-6): "mm2|mm²",
    ("m**3", 1): "m3|m^3|m³|cbm",
    ("m**3", 1e-3): "l|L|liter|litre|dm3|dm³",
    ("m**3", 1e-6): "ml|mL|cm3|cm³|cc|ccm",
    ("kg", 1): "kg|Kg|KG|kilogram",
    ("kg", 1e3): "t|tonne",
    ("kg", 1e-6): "mg",
    ("kg", 0.45359237): "lb|lbs",
    ("s", 1): "s|sec|Sec|secs|second|seconds|Seconds|Sek",
    ("s", 1e-3): "ms|msec|millisecond|milliseconds",
    ("s", 1e-6): "µs|us|usec|microseconds",
    ("s", MINUTE): "min|minute|minutes|mins",
    ("s", HOUR): "h|hr|hour|hours|hrs",
    ("s", 86400): "d|day|days",
    ("m/s", 1): "m/s|m s-1|m*s^-1|m/sec|m s^-1|ms-1|m·s⁻¹",
    ("m/s", 0.0254): "in/s|in/sec",
    ("m/s", 1e-3): "mm/s rms|mm/s_RMS|mm/s (RMS)|mm/s|mm/sec",
    ("m/s", 1 / 3.6): "km/h|kmh|kph|km/hr|Km/h",
    ("m/s", 0.44704): "mph|MPH|mi/h",
    ("m/s", 1852 / 3600): "kt|knots|knot|kts",
    ("m/s", 0.3048): "ft/s|fps",
    ("m/s", 0.3048 / 60): "ft/min|fpm",
    ("m/s**2", 1): "m/s2|m/s^2|m/s²|m s-2|m s^-2|m/s**2|m/sec^2|m/s/s|m·s⁻²",
    ("m/s**2", 1e-3): "mm/s2|mm/s²",
    ("m/s**2", G): "grms|gRMS|g_rms|g rms|g(RMS)|G|gn|g's|g0",
    ("m/s**2", G * 1e-3): "mg_n",
    (
        "rad/s",
        TURN / 60,
    ): "rpm|RPM|Rpm|r/min|rev/min|U/min|1/min|min^-1|min-1|min⁻¹|tr/min|Upm|revs/min|r.p.m.",
    ("turn/min", 1): "trs/min|tr/mn|obr/min|giri/min",
    ("rad/s", 1e3 * TURN / 60): "krpm",
    ("rad/s", TURN): "rps|rev/s|U/s|r/s|turns/s",
    ("rad/s", TURN / 360): "deg/s|°/s|dps|deg/sec|degrees/s",
    ("rad/s", 1): "rad/s|rad/sec|rad s-1|rad·s⁻¹|radians/s",
    ("rad", TURN / 360): "°CA|° CA|degCA|°KW|deg|Deg|°|degree|degrees|DEG",
    ("rad", 1e-3): "mrad",
    ("rad", 1): "rad|Rad|radian|radians",
    ("rad", TURN): "rev|revolution|turn",
    ("rad/s**2", 1): "rad/s2|rad/s²|rad/s^2",
    ("m**3/s", 1 / 3600): "m3/h|m³/h|m^3/h|cbm/h|Nm3/h|m3/hr|Sm3/h|Nm³/h|m**3/h",
    (
        "m**3/s",
        1e-3 / 60,
    ): "l/min|L/min|lpm|LPM|liter/min|ltr/min|l min-1|slpm|Nl/min|NL/min|nlpm|slm|SLM",
    ("m**3/s", 1e-3): "l/s|L/s",
    ("m**3/s", 1e-6): "ml/s|cm3/s|cm³/s",
    ("m**3/s", 1e-6 / 60): "sccm|SCCM|Nml/min|ml/min|mL/min|cc/min|cm³/min",
    ("m**3/s", 0.003785411784 / 60): "gpm|GPM",
    ("m**3/s", 0.003785411784 / 3600): "gph|GPH",
    ("m**3/s", 0.3048**3 / 60): "cfm|CFM|ft3/min|scfm|SCFM|cuft/min",
    ("kg/s", 1 / 3600): "kg/h|kg/hr",
    ("kg/s", 1e-3): "g/s",
    ("kg/m**3", 1): "kg/m3|kg/m³|kg/m^3|g/l|g/L",
    ("kg/m**3", 1e3): "g/cm3|g/cm³|kg/l",
    ("kg*m**2", 1e-4): "kgcm2|kg·cm²|kgcm²",
    ("kg*m**2", 1e-7): "gcm²|g·cm²",
    ("W/m/K", 1): "W/mK|W/(m·K)",
    ("W/m**2/K", 1): "W/m²K|W/m2K|W/(m²·K)",
    ("kg*m**2", 1): "kgm2|kg*m2|kg·m²|kg m^2|kg.m2",
    ("S/m", 1e-4): "µS/cm|uS/cm",
    ("S/m", 0.1): "mS/cm",
    ("S/m", 100): "S/cm",
    ("W/m**2", 1): "W/m2|W/m²|W/m^2",
    ("Pa*s", 1e-3): "mPas|mPa*s|mPa·s|cP",
    ("1", 1e-2): "%|%RH|% RH|pct|percent|Percent|%rh|%r.F.",
    ("1", 1e-6): "ppm|µε|ustrain|um/m",
    ("1", 1e-9): "ppb",
    ("1", 1e-3): "‰|promille|mV/V",
    ("1", 1): "-|1|count|none",
    ("K", 1): "K|Kelvin|kelvin",
    ("T", 1e-3): "mT",
    ("T", 1e-6): "µT|uT",
    ("lx", 1): "lx|lux",
    ("mol/m**3", 1): "mmol/l|mmol/L",
}
CASES = [
    (spelling, target, factor)
    for (target, factor), all_of in SPELLINGS.items()
    for spelling in all_of.split("|")
]
TEMPERATURES = {
    "degC": "°C|degC|deg C|Deg C|C|oC|Cel|℃|º C|Celsius|° C|deg. C|degrees C|degree C|°Celsius",
    "degF": "°F|degF|deg F|℉|F°|Fahrenheit",
}
NO_LINEAR_UNITS = (
    "dB",
    "dBm",
    "dBV",
    "pH",
    "dBA",
    "dB(A)",
    "NTU",
    "FNU",
    "digit",
    "ticks",
    "pulses",
    "lsb",
    "raw%",
    "EUR",
    "OD600",
)
"""Logarithms, scales and counts of an instrument's own: no factor leads to any of the units above."""


def read(spelling, target, value=1.0):
    try:
        return float(convert(value, spelling, target))
    except BadUnit:
        return None


def test_no_spelling_is_read_as_another_quantity_and_nearly_all_are_read():
    assert len(CASES) >= 300
    found = {
        (spelling, target): (read(spelling, target), factor) for spelling, target, factor in CASES
    }
    wrong = {
        case: pair
        for case, pair in found.items()
        if pair[0] is not None and pair[0] != pytest.approx(pair[1], rel=1e-5)
    }
    assert wrong == {}
    refused = [spelling for (spelling, _), (value, _) in found.items() if value is None]
    assert len(refused) <= 0.03 * len(found), refused


@pytest.mark.parametrize("scale", TEMPERATURES)
def test_temperatures_are_shifted_or_refused(scale):
    kelvin = {"degC": 293.15, "degF": (68 - 32) / 1.8 + 273.15}[scale]
    found = {
        spelling: read(spelling, "K", 20.0 if scale == "degC" else 68.0)
        for spelling in TEMPERATURES[scale].split("|")
    }
    assert {
        s: value
        for s, value in found.items()
        if value is not None and value != pytest.approx(kelvin)
    } == {}
    assert sum(value is not None for value in found.values()) >= 0.6 * len(found), found


@pytest.mark.parametrize("spelling", NO_LINEAR_UNITS)
def test_what_has_no_factor_is_converted_into_nothing_physical(spelling):
    targets = {target for target, _ in SPELLINGS} - {"1"}
    assert {
        target: value for target in targets if (value := read(spelling, target)) is not None
    } == {}
