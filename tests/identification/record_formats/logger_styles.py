"""Sixty files in the styles of twelve loggers and spreadsheets, with what they truly hold.

Each style is written here from the habits that its files show (heads, units, stamps, signs); five habits a style.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta, timezone

import numpy as np

N, STEP = 40, 0.5
START = datetime(2024, 3, 27, 22, 59, 50, tzinfo=UTC)
"""Shortly before a midnight in central Europe, on a day that tells day from month."""
SPEED = np.round(120.0 + 35.5 * np.sin(0.4 * np.arange(N)), 3)
CURRENT = np.round(-1.25 + 0.0625 * (np.arange(N) % 9), 4)


@dataclass(frozen=True)
class Written:
    """A file: `content`; `channels` it truly holds by name, `units`; `step` and `t0` [s]; `notes` that tell
    what was left out; or why it must be refused.
    """

    name: str
    content: bytes
    channels: dict[str, np.ndarray] = field(default_factory=dict)
    units: dict[str, str] = field(default_factory=dict)
    step: float = STEP
    t0: float = START.timestamp()
    refused: str = ""
    notes: str = ""
    resample: bool = False
    ending: str = ".csv"


def comma(value: float, digits: int) -> str:
    return f"{value:.{digits}f}".replace(".", ",")


def times(zone: timezone | None = None) -> list[datetime]:
    return [(START + timedelta(seconds=STEP * k)).astimezone(zone or UTC) for k in range(N)]


def lines(heads: Iterable[str], rows: Iterable[Iterable[str]], by: str, end: str = "\n") -> str:
    return end.join([*heads, *(by.join(row) for row in rows)]) + end


BOTH = {"speed": SPEED, "current": CURRENT}
UNITS = {"speed": "rpm", "current": "A"}
CET = timezone(timedelta(hours=1))
EXCEL_DAY = (START - datetime(1899, 12, 30, tzinfo=UTC)).total_seconds() / 86400


def german_spreadsheet() -> list[Written]:
    """A spreadsheet of a German Windows: semicolons, decimal commas, day first."""
    head = "Zeit;speed [rpm];current [A]"
    stamps = [f"{t:%d.%m.%Y %H:%M:%S},{t.microsecond // 1000:03d}" for t in times()]
    plain = [(s, comma(a, 3), comma(b, 4)) for s, a, b in zip(stamps, SPEED, CURRENT, strict=True)]
    days = [
        (comma(EXCEL_DAY + STEP * k / 86400, 10), comma(a, 3), comma(b, 4))
        for k, (a, b) in enumerate(_pairs())
    ]
    seconds = [(comma(STEP * k, 1), comma(a, 3), comma(b, 4)) for k, (a, b) in enumerate(_pairs())]
    text = lines([head], plain, ";", "\r\n")
    return [
        Written("stamps", text.encode("utf-8-sig"), BOTH, UNITS),
        Written(
            "latin-1",
            lines([head.replace("speed [rpm]", "speed [°C]")], plain, ";").encode("cp1252"),
            BOTH,
            UNITS | {"speed": "°C"},
        ),
        Written("days", lines([head.replace("Zeit", "Datum")], days, ";").encode(), BOTH, UNITS),
        Written(
            "seconds",
            lines([head.replace("Zeit", "Zeit [s]")], seconds, ";").encode(),
            BOTH,
            UNITS,
            t0=0.0,
        ),
        Written(
            "three digits",
            lines(
                ["Zeit [s];speed [rpm]"], [(str(k), f"1,{100 + k}") for k in range(N)], ";"
            ).encode(),
            refused="decimal",
        ),
    ]


def american_spreadsheet() -> list[Written]:
    """A spreadsheet of an American Windows: commas, points, month first, halves of a day."""
    head = "Time,speed (rpm),current (A)"
    stamps = [f"{t:%m/%d/%Y %I:%M:%S}.{t.microsecond // 1000:03d} {t:%p}" for t in times()]
    plain = [(s, f"{a:.3f}", f"{b:.4f}") for s, (a, b) in zip(stamps, _pairs(), strict=True)]
    quoted = [tuple(f'"{cell}"' for cell in row) for row in plain]
    thousands = [
        (s, f'"{1000 * a:,.1f}"', f"{b:.4f}") for s, (a, b) in zip(stamps, _pairs(), strict=True)
    ]
    early = [
        (f"03/0{1 + k // 20}/2024 10:00:{k % 20:02d}", f"{a:.3f}")
        for k, (a, _) in enumerate(_pairs())
    ]
    split = [
        (f"{t:%m/%d/%Y}", f"{t:%H:%M:%S}.{t.microsecond // 1000:03d}", row[1], row[2])
        for t, row in zip(times(), plain, strict=True)
    ]
    return [
        Written("stamps", lines([head], plain, ",", "\r\n").encode(), BOTH, UNITS),
        Written(
            "quoted",
            lines(['"Time","speed (rpm)","current (A)"'], quoted, ",").encode(),
            BOTH,
            UNITS,
        ),
        Written(
            "thousands",
            lines([head], thousands, ",").encode(),
            {"speed": np.round(1000 * SPEED, 1), "current": CURRENT},
            UNITS,
        ),
        Written(
            "day or month", lines(["Time,speed (rpm)"], early, ",").encode(), refused="day first"
        ),
        Written("date and time", lines(["Date," + head], split, ",").encode(), BOTH, UNITS),
    ]


def measurement_file() -> list[Written]:
    """A laboratory program's measurement file: tabs, blocks of key and value, a line that ends the head."""
    head = [
        "LabVIEW Measurement",
        "Writer_Version\t2",
        "Separator\tTab",
        "Date\t2024/03/27",
        "***End_of_Header***",
        "",
    ]
    names = "X_Value\tspeed\tcurrent\tComment"
    rows = [(f"{STEP * k:.6f}", f"{a:.6f}", f"{b:.6f}", "") for k, (a, b) in enumerate(_pairs())]
    timed = [*head, "time (s)\tspeed (rpm)\tcurrent (A)\tComment"]
    lost = [row if k not in (7, 8) else (row[0], "NaN", row[2], "") for k, row in enumerate(rows)]
    holes = {"speed": np.where(np.isin(np.arange(N), (7, 8)), np.nan, SPEED), "current": CURRENT}
    german = [tuple(cell.replace(".", ",") for cell in row) for row in rows]
    return [
        Written(
            "no unit of time",
            lines([*head, names], rows, "\t").encode(),
            refused="time",
            ending=".lvm",
        ),
        Written(
            "time", lines(timed, rows, "\t", "\r\n").encode(), BOTH, UNITS, t0=0.0, ending=".lvm"
        ),
        Written("lost", lines(timed, lost, "\t").encode(), holes, UNITS, t0=0.0, ending=".txt"),
        Written(
            "decimal commas",
            lines(timed, german, "\t").encode(),
            BOTH,
            UNITS,
            t0=0.0,
            ending=".lvm",
        ),
        Written(
            "UTF-16", lines(timed, rows, "\t").encode("utf-16"), BOTH, UNITS, t0=0.0, ending=".txt"
        ),
    ]


def scope() -> list[Written]:
    """An oscilloscope's export: names, units in parentheses on a line of their own, an empty line."""
    rows = [
        (f"{1e3 * STEP * k - 500:.8f}", f"{a:.8f}", f"{b:.8f}") for k, (a, b) in enumerate(_pairs())
    ]
    head = ["Time,speed,current", "(ms),(V),(V)", ""]
    volts = {"speed": "V", "current": "V"}
    cut = [row if k != 5 else (row[0], "∞", row[2]) for k, row in enumerate(rows)]
    exponent = [tuple(f"{float(cell):.9E}" for cell in row) for row in rows]
    two = ["x-axis,1,2", "second,Volt,Volt"]
    return [
        Written("milliseconds", lines(head, rows, ",").encode(), BOTH, volts, t0=-0.5),
        Written(
            "decimal commas",
            lines(
                [h.replace(",", ";") for h in head],
                [tuple(c.replace(".", ",") for c in r) for r in rows],
                ";",
            ).encode(),
            BOTH,
            volts,
            t0=-0.5,
        ),
        Written("over range", lines(head, cut, ",").encode(), refused="row 9"),
        Written("exponents", lines(head, exponent, ",").encode(), BOTH, volts, t0=-0.5),
        Written(
            "words for units",
            lines(two, [(f"{STEP * k:.3E}", r[1], r[2]) for k, r in enumerate(rows)], ",").encode(),
            {"1": SPEED, "2": CURRENT},
            {"1": "V", "2": "V"},
            t0=0.0,
        ),
    ]


def supervisory_archive() -> list[Written]:
    """A supervisory system's archive: one signal under the other, or a column a signal."""
    stamps = [f"{t:%Y-%m-%d %H:%M:%S}.{t.microsecond // 1000:03d}" for t in times()]
    long = [
        (f'"{n}"', f'"{s}"', f"{v:.4f}", "1")
        for s, a, b in zip(stamps, SPEED, CURRENT, strict=True)
        for n, v in (("speed", a), ("current", b))
    ]
    wide = [
        (f'"{s}"', comma(a, 3), comma(b, 4), "192")
        for s, a, b in zip(stamps, SPEED, CURRENT, strict=True)
    ]
    head = '"TimeString";"speed [rpm]";"current [A]";"Validity"'
    validity = {**BOTH, "Validity": np.full(N, 192.0)}
    late = [*wide[:10], wide[11], wide[10], *wide[12:]]
    again = [*wide[:20], wide[19], *wide[20:]]
    unlike = [*wide[:20], (wide[19][0], "7,000", "0,5000", "0"), *wide[20:]]
    return [
        Written(
            "one under the other",
            lines(['"VarName";"TimeString";"VarValue";"Validity"'], long, ";").encode(),
            refused="one column a signal",
        ),
        Written("wide", lines([head], wide, ";", "\r\n").encode(), validity, UNITS),
        Written("reordered", lines([head], late, ";").encode(), validity, UNITS),
        Written("repeated", lines([head], again, ";").encode(), validity, UNITS),
        Written("unlike twins", lines([head], unlike, ";").encode(), refused="stands twice"),
    ]


def station_logger() -> list[Written]:
    """A field station's table: what the file is, names, units, and how each column was made, four lines."""
    head = [
        '"TOA5","station","CR1000","12345","CR1000.Std.32","CPU:prog.CR1","4711","fast"',
        '"TIMESTAMP","RECORD","speed","current"',
        '"TS","RN","rpm","A"',
        '"","","Smp","Avg"',
    ]
    rows = [
        (f'"{_short(t)}"', str(k), f"{a:.3f}", f"{b:.4f}")
        for k, (t, (a, b)) in enumerate(zip(times(), _pairs(), strict=True))
    ]
    full = {"RECORD": np.arange(N, dtype=float), **BOTH}
    units = {**UNITS, "RECORD": "RN"}
    lost = [row if k != 3 else (row[0], row[1], '"NAN"', row[3]) for k, row in enumerate(rows)]
    holes = {**full, "speed": np.where(np.arange(N) == 3, np.nan, SPEED)}
    gap = [*rows[:20], *rows[30:]]
    kept = {k: np.concatenate([v[:20], np.full(10, np.nan), v[30:]]) for k, v in full.items()}
    return [
        Written("four lines", lines(head, rows, ",", "\r\n").encode(), full, units, ending=".dat"),
        Written("lost", lines(head, lost, ",").encode(), holes, units, ending=".dat"),
        Written("gap", lines(head, gap, ",").encode(), refused="resample", ending=".dat"),
        Written(
            "gap resampled",
            lines(head, gap, ",").encode(),
            kept,
            units,
            resample=True,
            ending=".dat",
        ),
        Written(
            "short row",
            lines(head, [*rows[:5], rows[5][:3], *rows[6:]], ",").encode(),
            refused="row 10",
            ending=".dat",
        ),
    ]


def dashboard() -> list[Written]:
    """A dashboard's download: numbers since 1970 or stamps of ISO 8601, every cell quoted."""
    epoch = [
        (f"{int(1000 * t.timestamp())}", f"{a}", f"{b}")
        for t, (a, b) in zip(times(), _pairs(), strict=True)
    ]
    iso = [
        (f'"{t.isoformat(timespec="milliseconds").replace("+00:00", "Z")}"', f'"{a}"', f'"{b}"')
        for t, (a, b) in zip(times(), _pairs(), strict=True)
    ]
    zoned = [
        (t.isoformat(timespec="microseconds"), f"{a}", f"{b}")
        for t, (a, b) in zip(times(CET), _pairs(), strict=True)
    ]
    events = [row if k % 2 == 0 else (row[0], "", row[2]) for k, row in enumerate(epoch)]
    half = {"speed": np.where(np.arange(N) % 2 == 0, SPEED, np.nan), "current": CURRENT}
    nanos = [
        (f"{int(1000 * t.timestamp())}000000", row[1], row[2])
        for t, row in zip(times(), epoch, strict=True)
    ]
    head = '"Time","speed (rpm)","current (A)"'
    return [
        Written("epoch", lines([head], epoch, ",").encode(), BOTH, UNITS),
        Written("ISO", lines([head], iso, ",").encode("utf-8-sig"), BOTH, UNITS),
        Written("zones", lines([head], zoned, ",").encode(), BOTH, UNITS),
        Written("two rates", lines([head], events, ",").encode(), half, UNITS),
        Written("nanoseconds", lines([head], nanos, ",").encode(), BOTH, UNITS),
    ]


def microcontroller() -> list[Written]:
    """What a microcontroller's serial port gave: milliseconds since it began, blanks or tabs, sometimes no heads."""
    rows = [
        (str(int(1000 * STEP * k) + 12), f"{a:.3f}", f"{b:.4f}")
        for k, (a, b) in enumerate(_pairs())
    ]
    jitter = [(str(int(row[0]) + (4, -3, 11, 0)[k % 4]), *row[1:]) for k, row in enumerate(rows)]
    restart = [*rows[:20], *rows[:20]]
    return [
        Written(
            "milliseconds",
            lines(["millis_ms speed[rpm] current[A]"], rows, " ").encode(),
            BOTH,
            UNITS,
            t0=0.012,
            ending=".txt",
        ),
        Written(
            "tabs",
            lines(["t_ms\tspeed (rpm)\tcurrent (A)"], rows, "\t", "\r\n").encode(),
            BOTH,
            UNITS,
            t0=0.012,
            ending=".txt",
        ),
        Written("no heads", lines([], rows, ",").encode(), refused="names", ending=".txt"),
        Written(
            "uneven",
            lines(["t_ms,speed (rpm),current (A)"], jitter, ",").encode(),
            refused="resample",
            ending=".txt",
        ),
        Written(
            "restart",
            lines(["t_ms,speed (rpm),current (A)"], restart, ",").encode(),
            refused="goes back",
            ending=".txt",
        ),
    ]


def controller_trace() -> list[Written]:
    """A controller's trace: keys and values, then names, then rows; its own units."""
    head = [
        "Name;TraceProject",
        "File;trace.csv",
        f"Starttime;{START:%Y-%m-%d}",
        "",
        "Time [ms];speed [ticks];current [%]",
    ]
    rows = [
        (comma(1e3 * STEP * k, 2), comma(a, 3), comma(b, 4)) for k, (a, b) in enumerate(_pairs())
    ]
    own = {"speed": "ticks", "current": "%"}
    several = [(row[0], row[1], row[0], row[2]) for row in rows]
    trailing = [(*row, "") for row in rows]
    return [
        Written("own units", lines(head, rows, ";").encode(), BOTH, own, t0=0.0),
        Written(
            "tabs",
            lines([h.replace(";", "\t") for h in head], rows, "\t").encode(),
            BOTH,
            own,
            t0=0.0,
            ending=".txt",
        ),
        Written(
            "a time a channel",
            lines(["Time 1 [ms];speed;Time 2 [ms];current"], several, ";").encode(),
            refused="several time columns",
        ),
        Written(
            "trailing sign",
            lines([h + ";" if h.startswith("Time") else h for h in head], trailing, ";").encode(),
            BOTH,
            own,
            t0=0.0,
        ),
        Written(
            "footer",
            lines(head, [*rows, ("End", "of", "trace")], ";").encode(),
            BOTH,
            own,
            t0=0.0,
            notes="'End of trace'; it is no sample",
        ),
    ]


def strain_program() -> list[Written]:
    """A strain gauge program's text: heads over several lines, a line of units, tabs."""
    head = [
        "Catman file",
        f"Started {START:%H:%M:%S}",
        "Channels\t3",
        "",
        "Zeit\tspeed\tcurrent",
        "s\tU/min\tA",
    ]
    rows = [(comma(STEP * k, 3), comma(a, 3), comma(b, 4)) for k, (a, b) in enumerate(_pairs())]
    brackets = [*head[:4], "Zeit\tspeed\tcurrent", "[s]\t[Nm]\t[A]"]
    minus = [row if k != 4 else (row[0], "--", row[2]) for k, row in enumerate(rows)]
    holes = {"speed": np.where(np.arange(N) == 4, np.nan, SPEED), "current": CURRENT}
    twice = [*head[:4], "Zeit\tspeed\tspeed", "s\trpm\tA"]
    return [
        Written(
            "units' line",
            lines(head, rows, "\t").encode(),
            BOTH,
            {"speed": "U/min", "current": "A"},
            t0=0.0,
            ending=".txt",
        ),
        Written(
            "bracketed units",
            lines(brackets, rows, "\t").encode("utf-8-sig"),
            BOTH,
            {"speed": "Nm", "current": "A"},
            t0=0.0,
            ending=".txt",
        ),
        Written(
            "no value",
            lines(brackets, minus, "\t").encode(),
            holes,
            {"speed": "Nm", "current": "A"},
            t0=0.0,
            ending=".txt",
        ),
        Written(
            "one name twice",
            lines(twice, rows, "\t").encode(),
            refused="stands twice",
            ending=".txt",
        ),
        Written(
            "UTF-16 big",
            b"\xfe\xff" + lines(brackets, rows, "\t").encode("utf-16-be"),
            BOTH,
            {"speed": "Nm", "current": "A"},
            t0=0.0,
            ending=".txt",
        ),
    ]


def time_series_database() -> list[Written]:
    """A time series database's dump: marked lines, one field under the other, or pivoted."""
    iso = [t.isoformat(timespec="milliseconds").replace("+00:00", "Z") for t in times()]
    pivoted = [
        ("", "_result", "0", s, f"{a}", f"{b}") for s, (a, b) in zip(iso, _pairs(), strict=True)
    ]
    fields = [
        ("", "_result", "0", s, f"{v}", n)
        for n, values in BOTH.items()
        for s, v in zip(iso, values, strict=True)
    ]
    plain = [(s, f"{a}", f"{b}") for s, (a, b) in zip(iso, _pairs(), strict=True)]
    marks = [
        "#datatype,string,long,dateTime:RFC3339,double,double",
        "#group,false,false,false,false,false",
        "#default,_result,,,,",
    ]
    table = {"table": np.zeros(N), **BOTH}
    mixed = [*plain[:10], (plain[10][0].replace("Z", "+02:00"), *plain[10][1:]), *plain[11:]]
    return [
        Written(
            "pivoted",
            lines([*marks, ",result,table,_time,speed,current"], pivoted, ",").encode(),
            table,
            {},
        ),
        Written(
            "fields",
            lines([",result,table,_time,_value,_field"], fields, ",").encode(),
            refused="one column a signal",
        ),
        Written("plain", lines(["time,speed,current"], plain, ",").encode(), BOTH, {}),
        Written(
            "sentinel",
            lines(
                ["time,speed,current"],
                [r if k != 2 else (r[0], "null", r[2]) for k, r in enumerate(plain)],
                ",",
            ).encode(),
            {"speed": np.where(np.arange(N) == 2, np.nan, SPEED), "current": CURRENT},
            {},
        ),
        Written(
            "one row of another zone",
            lines(["time,speed,current"], mixed, ",").encode(),
            refused="goes back",
        ),
    ]


def hand_made() -> list[Written]:
    """What an engineer writes by a script of their own."""
    rows = [(f"{STEP * k:.2f}", f"{a:.3f}", f"{b:.4f}") for k, (a, b) in enumerate(_pairs())]
    return [
        Written(
            "ours",
            lines(["time [s],speed [rpm],current [A]"], rows, ",").encode(),
            BOTH,
            UNITS,
            t0=0.0,
        ),
        Written(
            "ours, units in parentheses",
            lines(["time [s],speed (rpm),current (A)"], rows, ",").encode(),
            BOTH,
            UNITS,
            t0=0.0,
        ),
        Written(
            "seconds in the name",
            lines(["time_s|speed|current"], rows, "|").encode(),
            BOTH,
            {},
            t0=0.0,
        ),
        Written(
            "no unit", lines(["time,speed,current"], rows, ",").encode(), refused="time='excel'"
        ),
        Written(
            "notes first",
            lines(
                ["# bench 3", "# new belt", "time [min];speed [rpm];current [A]"], rows, ";"
            ).encode(),
            BOTH,
            UNITS,
            step=30.0,
            t0=0.0,
        ),
    ]


def _pairs() -> list[tuple[float, float]]:
    return list(zip(SPEED.tolist(), CURRENT.tolist(), strict=True))


def _short(t: datetime) -> str:
    """A stamp without a fraction where it is nought, as such loggers write it."""
    return f"{t:%Y-%m-%d %H:%M:%S}" + (f".{t.microsecond // 100000}" if t.microsecond else "")


STYLES: tuple[Callable[[], list[Written]], ...] = (
    german_spreadsheet,
    american_spreadsheet,
    measurement_file,
    scope,
    supervisory_archive,
    station_logger,
    dashboard,
    microcontroller,
    controller_trace,
    strain_program,
    time_series_database,
    hand_made,
)
