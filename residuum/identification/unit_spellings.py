"""How loggers, instruments and data sheets spell units, and the spelling that stands for each.

A text is put into the form of products (`m/s2` → `m/s**2`), then looked up as a whole, then word by
word. What stands in no table is left as it is: the registry says whether anybody knows it.
"""

from __future__ import annotations

import re

# Signs that look alike and are several characters: the ohm and the omega, the micro and the mu, the
# minus and the hyphen.
_SAME = str.maketrans(
    {
        **{
            "℃": "°C",
            "℉": "°F",
            "º": "°",
            "˚": "°",
            "Ω": "Ω",
            "μ": "µ",
            "−": "-",
            "·": "*",
            "⋅": "*",
            "×": "*",
        },
        **dict(zip("⁰¹²³⁴⁵⁶⁷⁸⁹⁻", "0123456789-", strict=True)),
    }
)
# a short word with its exponent right behind it: `m3`, `s-2`, `min^-1`, `cm**2`
_POWER = re.compile(
    r"(?<![A-Za-z_\d.])([A-Za-zµ]{1,4})\s?(?:\^|\*\*)?(?:\((-?[1-9])\)|(-?[1-9]))(?![\dA-Za-z.*])"
)
# `N.m`: a point between letters multiplies
_DOT = re.compile(r"(?<=[A-Za-z])\.(?=[A-Za-z])")
# a force and a length that are written as one word: `Nm`, `kNm`, `Ncm`
_JOINED = re.compile(r"(?<![A-Za-zµ])((?:da|[kMmµ])?N)(m{1,2}|cm)(?![A-Za-z0-9])")
# behind a stroke both factors divide: `V/Nm`
_BELOW = re.compile(r"/" + _JOINED.pattern)
# what says behind a unit that a value is an effective one: the unit is the same
_EFFECTIVE = re.compile(r"(?<=[A-Za-zµ²)\d])(?:[_ ](?:rms|RMS)|[_ ]?\((?:rms|RMS)\))$")
_WORD = re.compile(r"[A-Za-zµ°Ω%\"_][A-Za-zµ°Ω%_]*")
_BLANK = re.compile(r"\s+")


def _each(words: str, meant: str) -> dict[str, str]:
    return dict.fromkeys(words.split(), meant)


# texts that mean something as a whole only; a blank is written `_` here
_WHOLE = {
    **_each("1 - -- none unitless dimensionless raw bool boolean count", "dimensionless"),
    **_each(
        # A `C` alone is a temperature, but where it is held against a charge (`units.compatible`).
        "C °C degC DegC °Celsius oC Cel celsius Celsius deg_C deg.C Deg_C deg._C degree_C degrees_C"
        " degree_Celsius",
        "degC",
    ),
    **_each("°_C degrees_Celsius deg_Celsius grad_C Grad_C", "degC"),
    **_each("°F degF DegF oF deg_F deg._F °_F Fahrenheit fahrenheit degrees_F", "degF"),
    **_each("°K degK deg_K Kelvin kelvin", "kelvin"),
    **_each("° Deg DEG degrees", "degree"),
    **_each('" in. inches Zoll zoll', "inch"),
    **_each("g gn G g_n g0 g's gs G's grms gRMS Grms GRMS", "standard_gravity"),
    **_each(
        # A logger's `1/min` is a speed of rotation; the registry reads a frequency.
        "RPM Rpm r.p.m. rev/min revs/min r/min U/min Upm UPM upm tr/min 1/min /min min**-1"
        " rev*min**-1",
        "revolution/minute",
    ),
    **_each(
        "rev_per_min rpm turns/min turn/min revolutions/min 1/minute minute**-1",
        "revolution/minute",
    ),
    **_each("trs/min tr/mn obr/min ot/min giri/min", "revolution/minute"),
    **_each("krpm kRPM", "kiloturn/minute"),
    **_each("V/krpm V/kRPM V/1000rpm V/1000_rpm V/1000min**-1", "V*minute/kiloturn"),
    **_each("rps RPS rev/s rev/sec revs/s U/s r/s turns/s turn/s", "revolution/second"),
    **_each("dps deg/sec °/s °/sec", "degree/second"),
    **_each("°CA °_CA degCA deg_CA CAD °KW °_KW", "degree"),
    **_each(
        "%RH %rh %rH %_RH RH% %r.F. %rF %_r.F. % percent Percent pct PCT Prozent %age vol% %vol"
        " Vol% Vol.-%",
        "percent",
    ),
    **_each("ppm PPM ppmv µε µstrain ustrain um/m µm/m", "ppm"),
    **_each("ppb PPB ppbv", "ppm*permille"),
    **_each("‰ promille Promille permille", "permille"),
    # Gauge and absolute pressures have one unit. Nothing is added from one to the other: no unit
    # says the pressure of the air.
    **_each("bar(g) bar(a) bar_g bar_a barg bara BAR Bar bar_(g) bar_(a) bar_abs bar_rel", "bar"),
    **_each("kg/cm**2 kgf/cm**2 kp/cm**2 at", "technical_atmosphere"),
    **_each("mb mbar hPa mBar millibar", "mbar"),
    **_each("psi PSI Psi psig psia PSIG PSIA psi(g) psi(a) psid lbf/in**2 lb/in**2", "psi"),
    **_each("kPa(g) kPa(a) kPag kPaa kpa KPa KPA", "kPa"),
    **_each("Mpa MPA", "MPa"),
    **_each("inH2O inH20 inWC inwc inH2O(g) in_H2O in.H2O in*H2O in_WC", "inch_H2O"),
    # 1000 kg/m³ · g of a column of water, for each metre
    **_each("mH2O mWS mWC mCE", "t*g_0/m**2"),
    **_each("ubar µbar microbar", "dPa"),
    **_each("ksi KSI", "ksi"),
    **_each("kip kips klbf kipf", "kip"),
    **_each("inHg inHG in_Hg", "inch_Hg"),
    **_each("mmHg mmHG mm_Hg", "mmHg"),
    **_each("Torr torr", "torr"),
    **_each("mmH2O mm_H2O mmWS mmWC", "mmH2O"),
    **_each(
        # Standard and norm litres count as litres: which norm is meant no unit says.
        "lpm LPM slpm l/mn Nl/min NL/min Nlpm nlpm NLPM Sl/min SLM slm SLPM ln/min l_n/min",
        "liter/minute",
    ),
    **_each("Nml/min sccm SCCM smlpm", "cm**3/minute"),
    **_each("gpm GPM", "gallon/minute"),
    **_each("gph GPH", "gallon/hour"),
    **_each("cfm CFM ft**3/min scfm SCFM acfm ACFM cuft/min cu.ft/min", "foot**3/minute"),
    **_each("in/sec", "inch/second"),
    **_each("fpm FPM", "foot/minute"),
    **_each("fps", "foot/second"),
    **_each("cbm/h m**3/hr m**3/hour Nm**3/h Nm3/h Sm**3/h cmh CMH", "meter**3/hour"),
    **_each("kmh km/hr Km/h KMH kph KPH km/hour", "kilometer_per_hour"),
    **_each("mph MPH mi/h", "mile_per_hour"),
    **_each("kt kts knots Knots knot", "knot"),
    **_each(
        "ft-lb ft-lbf ft*lb ft*lbf ftlb ftlbf lb-ft lbf-ft lb*ft lbft ft_lb ft_lbf lb_ft lbf_ft"
        " ft-lbs",
        "lbf*foot",
    ),
    **_each(
        "in-lb in-lbf in*lb in*lbf inlb lb-in lbf-in lb*in lbin in_lb in_lbf lb_in in-lbs",
        "lbf*inch",
    ),
    **_each("N-m Newton-meter newton-meter N_m Newton_meter Nm newton_meter", "N*m"),
    **_each("oz-in ozf-in in-oz oz*in ozin ozfin", "ozf*inch"),
    **_each("kgf-m kgfm kgf_m kp-m kpm", "kgf*m"),
    **_each("kgf-cm kgfcm kgf_cm kp-cm kpcm", "kgf*cm"),
    **_each("mil mils thou", "thou"),
    **_each("V_rms V_DC V_AC V_dc V_ac V_RMS", "V"),
    **_each("A_rms A_DC A_AC A_dc A_ac A_RMS", "A"),
    **_each("kgm**2 kgm2", "kg*m**2"),
    **_each("kgcm**2 kgcm2", "kg*cm**2"),
    **_each("gcm**2 gcm2", "gram*cm**2"),
    **_each("watt-hour watt-hours Watt-hour Watt-hours", "Wh"),
    **_each(
        "Amp-hour Amp-hours amp-hour amp-hours Ampere-hour Ampere-hours ampere-hours Amph amp_hours"
        " Amp_hours",
        "Ah",
    ),
    **_each("VAh VARh varh VArh", "VA*h"),
    **_each("kVAh kvarh kVARh kVArh", "kVA*h"),
    **_each("W/mK W/m-K", "W/m/K"),
    **_each("W/m2K W/m**2K W/m2-K W/m**2-K", "W/m**2/K"),
    **_each("J/kgK J/kg-K", "J/kg/K"),
    **_each("kJ/kgK kJ/kg-K", "kJ/kg/K"),
    **_each("sqm", "m**2"),
    **_each("hp HP Hp bhp", "horsepower"),
    **_each("PS", "metric_horsepower"),
}
_WORDS = {
    **_each("volt Volt VOLT volts Volts VDC Vdc VAC Vac Vrms", "V"),
    **_each("mVolt millivolt millivolts mVDC", "mV"),
    **_each("ampere Ampere amperes Amperes amp Amp amps Amps AMPS ADC Adc AAC Arms", "A"),
    **_each("ohms Ohm Ohms OHM Ω", "ohm"),
    **{f"{k}{w}": f"{k}ohm" for k in "mkM" for w in ("Ohm", "Ohms", "ohms", "Ω")},
    **_each("watt Watt watts Watts", "W"),
    **_each("KW Kw kw", "kW"),
    **_each("KV", "kV"),
    **_each("KWh KWH kwh kWH", "kWh"),
    **_each("var VAr VAR", "VA"),
    **_each("kvar kVAr kVAR kvAr", "kVA"),
    **_each("Mvar MVAr MVAR", "MVA"),
    **_each("hertz Hertz HZ hz", "Hz"),
    **_each("khz KHz KHZ", "kHz"),
    **_each("Newton newton Newtons newtons NEWTON", "N"),
    **_each("kp kilopond Kilopond", "kgf"),
    **_each("pascal Pascal pascals PA", "Pa"),
    **_each("sec secs Sec Secs SEC Sek sek second seconds Second Seconds sekunde Sekunden", "s"),
    **_each("msec msecs mSec millisecond milliseconds Milliseconds", "ms"),
    **_each("usec µsec us µs microseconds microsecond", "us"),
    **_each("days Day Days", "day"),
    **_each("mins minutes Minutes minute Minute Min MIN", "min"),
    **_each("hr hrs Hr hour hours Hours Std", "h"),
    **_each("metre metres meter meters Meter Meters", "m"),
    **_each("um µm micron microns", "um"),
    **_each("Kg KG kgs", "kg"),
    **_each("gram grams Gram gr", "gram"),
    **_each("liter litre liters litres Liter ltr", "l"),
    **_each("cbm", "m**3"),
    **_each("cc ccm", "cm**3"),
    **_each("uA µA", "uA"),
    **_each("deg Deg °", "degree"),
    **_each("rev revs", "revolution"),
    **_each("radians radian Rad rads", "rad"),
    **_each("kgf", "kgf"),
    **_each("lbs Lbs", "lb"),
    **_each("Joule joule Joules joules", "J"),
    **_each("Ws", "W*s"),
    **_each("As", "A*s"),
    **_each("Ns", "N*s"),
    **_each("Nms", "N*m*s"),
    **_each("mPas", "mPa*s"),
    **_each("mAmp mAmps milliamp milliamps", "mA"),
    **_each("millimetre millimetres", "mm"),
    **_each("centimetre centimetres", "cm"),
    **_each("kilometre kilometres", "km"),
    **_each("lux Lux", "lx"),
    **_each("klux kLux", "klx"),
    "%": "percent",
}
_SI = {
    **dict.fromkeys(
        ["A", "V", "W", "J", "F", "H", "s", "S", "T", "Hz", "VA", "Wh", "ohm", "Pa", "N", "rad"],
        "n u µ m k M G",
    ),
    **{
        "m": "n u µ m c d k",
        "l": "u µ m c d h",
        "L": "u µ m c d h",
        "g": "u µ m k",
        "bar": "m k",
        "Ah": "u µ m k",
        "mol": "m k u µ",
    },
    **{
        "F": "p n u µ m",
        "eV": "k M",
        "cal": "k",
        "lx": "k",
        "K": "m",
        "t": "k",
        "C": "p n u µ m k",
        "lm": "",
        "cd": "",
        "dPa": "",
    },
}
_OTHERS = (
    "daN hPa min h d ha ft in yd mi lb oz lbf kgf gf ozf psi atm torr mmHg mmH2O cmH2O inHg degC"
    " degF delta_degC delta_degF deg rpm kip ksi permille mph kph knot ppm arcmin arcsec cP cSt gon"
    " gal hp BTU Btu count bit byte g_0 turn % mile inch foot yard kg revolution tonne feet"
    " inches day"
)
KNOWN_SYMBOLS = frozenset(
    (*(p + u for u, prefixes in _SI.items() for p in ("", *prefixes.split())), *_OTHERS.split())
)
"""Symbols that mean what the registry reads; it would read many more words as a prefix and a unit
(`pct`: pico-centitonne).
"""
LOOKALIKES = frozenset(
    _each(
        "point points pixel pixels cycle cycles scaled grain grains chain chains stone decibel"
        " decibels neper link links particle particles number_meter hand hands barrel dots"
        " pixel_per_inch value values",
        "",
    )
)
"""Long words that loggers use for something else than the unit that has this name."""


def canonical(text: str) -> str:
    """The text in the registry's spelling.

    >>> canonical("m/s²"), canonical("Nm"), canonical("min⁻¹"), canonical("kOhm"), canonical("oil level")
    ('m/s**2', 'N*m', 'revolution/minute', 'kohm', 'oil level')
    """
    plain = _EFFECTIVE.sub("", _BLANK.sub(" ", text.translate(_SAME)).strip())
    # Whole texts before words are parted: `Nm3/h` is a flow of gas, not newtons times metres.
    for spelled in (plain, _powers(plain)):
        if (whole := _WHOLE.get(spelled.replace(" ", "_"))) is not None:
            return whole
    # A temperature that is still here is part of a product, and there a difference.
    plain = _JOINED.sub(r"\1*\2", _BELOW.sub(r"/\1/\2", _powers(plain))).replace("°C", "delta_degC")
    if whole := _WHOLE.get(plain.replace(" ", "_")):
        return whole
    return _WORD.sub(lambda match: _WORDS.get(match[0], match[0]), plain)


def is_spelled(text: str) -> bool:
    """Whether a text is listed as a spelling of a unit, in any form of it, or is a symbol of two
    letters or more.

    >>> is_spelled("bar(g)"), is_spelled("ml"), is_spelled("left"), is_spelled("A")
    (True, True, False, False)
    """
    plain = _BLANK.sub("_", _EFFECTIVE.sub("", text.translate(_SAME).strip()))
    return len(plain) > 1 and (plain in _WHOLE or plain in _WORDS or plain in KNOWN_SYMBOLS)


def _powers(text: str) -> str:
    return _POWER.sub(
        lambda match: f"{match[1]}**{match[2] or match[3]}", _DOT.sub("*", text)
    ).replace("^", "**")
