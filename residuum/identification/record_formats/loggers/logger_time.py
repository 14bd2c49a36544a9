"""The times of a logger's file: seconds or milliseconds since start, epoch numbers, ISO and local
stamps, Excel dates, clocks.
"""

import re
from datetime import UTC, datetime, timedelta
from fractions import Fraction

import numpy as np
import numpy.typing as npt

from residuum.identification.record_formats.loggers.logger_text import number

PER_SECOND = {
    "seconds": Fraction(1),
    "milliseconds": Fraction(1, 1000),
    "microseconds": Fraction(1, 10**6),
    "nanoseconds": Fraction(1, 10**9),
    "minutes": Fraction(60),
    "hours": Fraction(3600),
    "seconds since 1904": Fraction(1),
    "epoch s": Fraction(1),
    "epoch ms": Fraction(1, 1000),
    "epoch us": Fraction(1, 10**6),
    "epoch ns": Fraction(1, 10**9),
}
"""Seconds of one unit of a time column that holds numbers."""
STAMPS = ("iso", "day first", "month first", "clock", "hh:mm", "mm:ss")
FORMS = (*PER_SECOND, "excel", "datenum", *STAMPS)
CLOCKS = ("clock", "hh:mm", "mm:ss", "hh:mm or mm:ss")
"""Times of day or since a start, without a date."""
SINCE_START = (
    "seconds",
    "milliseconds",
    "microseconds",
    "nanoseconds",
    "minutes",
    "hours",
    "clock",
    "hh:mm",
    "mm:ss",
)
UNITS = {
    **dict.fromkeys(("s", "sec", "secs", "second", "seconds", "sek"), "seconds"),
    **dict.fromkeys(("ms", "msec", "millis", "milliseconds"), "milliseconds"),
    **dict.fromkeys(("us", "µs", "μs", "usec", "micros", "microseconds"), "microseconds"),
    **dict.fromkeys(("ns", "nsec", "nanos", "nanoseconds"), "nanoseconds"),
    **dict.fromkeys(("min", "minutes"), "minutes"),
    **dict.fromkeys(("h", "hr", "hours"), "hours"),
}
# day 0 of a spreadsheet, which counts 1900 as a leap year: right from 1900-03-01 on
_EXCEL_EPOCH = datetime(1899, 12, 30, tzinfo=UTC)
# English, and German where it differs
_MONTHS = {
    **{
        "jan": 1,
        "feb": 2,
        "mar": 3,
        "apr": 4,
        "may": 5,
        "jun": 6,
        "jul": 7,
        "aug": 8,
        "sep": 9,
        "oct": 10,
        "nov": 11,
        "dec": 12,
    },
    **{"mär": 3, "mrz": 3, "mai": 5, "okt": 10, "dez": 12},
}
_NAMED = re.compile(
    r"(?:(\d{1,2})[-. /]+([A-Za-zä]{3,9})|([A-Za-zä]{3,9})[. ]+(\d{1,2}),?)[-. ,/]+(\d{4})(?:[T"
    r" ,:]+(.*))?"
)
_MINUTES = re.compile(r"(\d+):([0-5]\d)(?:[.,](\d+))?", re.ASCII)
_CENTURY = 70  # years of two digits from here on are of the twentieth century (POSIX has 69)
_DATENUM_1970 = 719_529  # MATLAB's day number of 1970-01-01
_DAY = 86_400 * 10**9  # [ns]
_DATE = re.compile(r"(\d{1,4})[-/.](\d{1,2})[-/.](\d{1,4})(?:[T ,]+(.*))?", re.ASCII)
_CLOCK = re.compile(
    r"(\d+):(\d\d)(?::(\d\d)(?:([.,:])(\d+))?)?\s*([AaPp][Mm])?\s*(Z|UTC|[+-]\d\d:?\d\d|[+-]\d\d)?",
    re.ASCII | re.IGNORECASE,
)
_1904 = "seconds since 1904"
# seconds from 1904-01-01, where LabVIEW and old Macintoshes begin to count, to 1970-01-01 (both
# UTC)
_SINCE_1904 = 2_082_844_800
# forms of numbers that count from an epoch, and the numbers that are then of our days, 2001-09 to
# 2039-09: these ranges do not overlap
_EPOCHS = (
    ("epoch s", 1e9, 2.2e9),
    (_1904, 1e9 + _SINCE_1904, 2.2e9 + _SINCE_1904),
    ("epoch ms", 1e12, 2.2e12),
    ("epoch us", 1e15, 2.2e15),
    ("epoch ns", 1e18, 2.2e18),
)


def seconds_of(unit: str) -> float | None:
    """Seconds of one unit of a time, as it is spelled; None for what is no unit of time.

    >>> seconds_of("ms"), seconds_of("Minutes"), seconds_of("V")
    (0.001, 60.0, None)
    """
    name = UNITS.get(unit.lower())
    return None if name is None else float(PER_SECOND[name])


def number_form(name: str, unit: str, values: npt.NDArray[np.float64]) -> tuple[str, str] | None:
    """(form, reason) of a time column of numbers, or None where nothing says its unit."""
    if epoch := _epoch_form(unit, float(np.min(values)), float(np.max(values))):
        return epoch
    if unit:
        form = UNITS.get(unit.lower(), "")
        return (form, f"unit {unit!r} of column {name!r}") if form else None
    words = re.split(r"[\s_.:-]+", name.lower())
    low, high = float(np.min(values)), float(np.max(values))
    # 690 000 is in 1889, 770 000 in 2108
    if "datenum" in words and low > 690_000 and high < 770_000:
        return "datenum", f"MATLAB's days: {low:.5f} is {_date(low, 'datenum')}"
    if words[-1] in UNITS and len(words) > 1:
        return UNITS[words[-1]], f"the name {name!r} ends in {words[-1]!r}"
    return _excel_form(words, values)


def _epoch_form(unit: str, low: float, high: float) -> tuple[str, str] | None:
    """The unit in which numbers from `low` to `high` are times of our days, since 1970 or 1904."""
    for form, least, most in _EPOCHS:
        if least <= low and high <= most and (not unit or UNITS.get(unit.lower()) == _plain(form)):
            since = 1904 if form == _1904 else 1970
            return form, f"{low:.0f} is {_date(low, form)} as seconds since {since}"
    return None


def _excel_form(words: list[str], values: npt.NDArray[np.float64]) -> tuple[str, str] | None:
    """Days of a spreadsheet: close together, of our days, in a column that is called a date."""
    low, high = float(np.min(values)), float(np.max(values))
    step = float(np.median(np.abs(np.diff(values)))) if len(values) > 1 else 0.0
    is_called_date = not {"date", "datetime", "datum"}.isdisjoint(words)
    # 25 000 is in 1968, 75 000 in 2105; a step of 0.05 days is 72 minutes
    if is_called_date and low >= 25000 and high <= 75000 and 0 < step < 0.05:
        first = _EXCEL_EPOCH + timedelta(days=low)
        return "excel", f"days since 1899-12-30: {low:.5f} is {first:%Y-%m-%d %H:%M}"
    return None


def _plain(form: str) -> str:
    return "seconds" if form == _1904 else UNITS[form.split()[1]]


def _date(value: float, form: str) -> str:
    if form == "datenum":
        instant = datetime(1970, 1, 1, tzinfo=UTC) + timedelta(days=value - _DATENUM_1970)
        return f"{instant:%Y-%m-%d %H:%M}"
    since = _SINCE_1904 if form == _1904 else 0
    return f"{datetime.fromtimestamp(value * float(PER_SECOND[form]) - since, UTC):%Y-%m-%d %H:%M}"


def stamp_form(cells: list[str]) -> tuple[str, str] | None:
    """(form, reason) of a column of stamps; `day or month first` where the dates do not tell."""
    # two numbers and a colon are a time of day, too: they are looked for first
    if all(_MINUTES.fullmatch(cell) for cell in cells):
        return _two_parts(cells)
    if all(_CLOCK.fullmatch(cell) for cell in cells):
        return "clock", f"hours:minutes:seconds, {cells[0]!r}"
    if all(_numbered(cell) != cell for cell in cells):
        return "day first", f"months by name, {cells[0]!r}"
    dates = [_DATE.fullmatch(cell) for cell in cells]
    parts = [match.groups() for match in dates if match]
    if len(parts) < len(cells):
        return None
    if max(len(outer) for first, _, third, _ in parts for outer in (first, third)) <= 2:
        return _short_year(cells, parts)
    return _long_year(cells, parts)


def _long_year(cells: list[str], parts: list[tuple[str, ...]]) -> tuple[str, str]:
    """What three numbers are of which one is a year of four digits: one date with a part above 12
    tells the order of all.
    """
    if all(len(first) == 4 for first, *_ in parts):
        return "iso", f"year first, {cells[0]!r}"
    if any(int(first) > 12 for first, *_ in parts):
        return "day first", "a first part is above 12"
    if any(int(second) > 12 for _, second, *_ in parts):
        return "month first", "a second part is above 12"
    if all("." in cell[:3] for cell in cells):
        return "day first", f"dates with points, {cells[0]!r}"
    return "day or month first", f"{cells[0]!r} may be either"


def _short_year(cells: list[str], parts: list[tuple[str, ...]]) -> tuple[str, str]:
    """What three numbers of two digits are: with points the day is first, above 31 stands a year;
    the rest has to be said.
    """
    if all("." in cell[:3] for cell in cells):
        return "day first", f"dates with points and years of two digits, {cells[0]!r}"
    if any(int(first) > 31 for first, *_ in parts):
        return "iso", "a first part is above 31"
    if any(int(second) > 12 for _, second, *_ in parts):
        return "month first", "a second part is above 12, years of two digits"
    return (
        "day or month first",
        f"{cells[0]!r} may be day/month/year, month/day/year or (iso) year/month/day",
    )


def _two_parts(cells: list[str]) -> tuple[str, str]:
    """What two numbers and a colon are: a watch may show hours and minutes, or minutes and
    seconds.
    """
    parts = [match.groups() for match in map(_MINUTES.fullmatch, cells) if match]
    if any(fraction for *_, fraction in parts):
        return "mm:ss", f"minutes:seconds with decimals, {cells[0]!r}"
    if any(int(first) > 23 for first, *_ in parts):
        return "mm:ss", "minutes:seconds, a first part is above 23"
    return "hh:mm or mm:ss", f"{cells[0]!r} may be hours:minutes or minutes:seconds"


def _numbered(cell: str) -> str:
    """A stamp whose month is written by name as one with points, day first; any other cell as it
    is.
    """
    match = _NAMED.fullmatch(cell)
    month = _MONTHS.get((match[2] or match[3])[:3].lower()) if match else None
    if match is None or month is None:
        return cell
    return f"{match[1] or match[4]}.{month}.{match[5]}" + (f" {match[6]}" if match[6] else "")


def over_midnight(times: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
    """Times of day [ns] that go on after midnight: a step back that is a usual step and a day is
    that day's end.

    Any other step back is left: a clock that was set or restarted tells nothing of the time
    between.
    """
    steps = np.diff(times)
    forward = steps[steps > 0]
    if not len(forward):
        return times
    usual = float(np.median(forward))
    ended = (steps < -_DAY // 2) & (np.abs(steps + _DAY - usual) <= 0.5 * usual)
    return np.asarray(times + _DAY * np.concatenate([[0], np.cumsum(ended)]), dtype=np.int64)


def nanoseconds(cell: str, form: str, decimal: str) -> int:
    """Time of a cell [ns], since the start, midnight, or 1970 by its form; ValueError when it is
    not of that form.

    A stamp without zone is taken as UTC. Digits are kept exactly, so a 19-digit epoch loses
    nothing.
    """
    if form in PER_SECOND:
        return _of_number(cell, form, decimal)
    if form == "excel":
        # days as a double are exact to a microsecond in our days, not to a nanosecond
        microseconds = round(number(cell, decimal) * 86_400_000_000)
        since_1970 = int((_EXCEL_EPOCH - datetime(1970, 1, 1, tzinfo=UTC)).total_seconds())
        return (microseconds + since_1970 * 10**6) * 1000
    if form == "datenum":
        return round((Fraction(cell.replace(",", ".")) - _DATENUM_1970) * _DAY)
    if form in ("clock", "hh:mm"):
        return _clock(cell)
    if form == "mm:ss":
        return _minutes(cell)
    return _of_date(cell, form)


def _of_number(cell: str, form: str, decimal: str) -> int:
    """Time [ns] of a number that counts seconds or parts of them."""
    number(cell, decimal)  # raises where the cell is none
    digits = cell.replace(",", ".") if decimal == "," else cell.replace(",", "")
    # a fraction, for a double holds 15 to 17 of the 19 digits of nanoseconds since 1970
    seconds = Fraction(digits) * PER_SECOND[form]
    return round((seconds - (_SINCE_1904 if form == _1904 else 0)) * 10**9)


def _of_date(cell: str, form: str) -> int:
    """Time [ns] of a date, with or without a time of day."""
    match = _DATE.fullmatch(_numbered(cell))
    if not match:
        raise ValueError(cell)
    first, second, third, clock = match.groups()
    if not _dated(form, first, third):
        raise ValueError(cell)
    order = {
        "iso": (first, second, third),
        "day first": (third, second, first),
        "month first": (third, first, second),
    }[form]
    year, month, date = map(int, order)
    if len(order[0]) == 2:
        year += 2000 if year < _CENTURY else 1900
    day = datetime(year, month, date, tzinfo=UTC)
    return int(day.timestamp()) * 10**9 + (_clock(clock) if clock else 0)


def _dated(form: str, first: str, third: str) -> bool:
    """Whether the outer parts of a date are as long as its form has them: a year of four digits or
    of two.
    """
    year, day = (first, third) if form == "iso" else (third, first)
    return len(day) <= 2 and len(year) in (2, 4)


def _minutes(text: str) -> int:
    match = _MINUTES.fullmatch(text.strip())
    if not match:
        raise ValueError(text)
    return (int(match[1]) * 60 + int(match[2])) * 10**9 + _fraction(match[3])


def _clock(text: str) -> int:
    """Time of day [ns] in UTC; ValueError for a minute above 59."""
    match = _CLOCK.fullmatch(text.strip())
    if not match:
        raise ValueError(text)
    hours, minutes, seconds, sign, fraction, half, zone = match.groups()
    hour = int(hours) if half is None else _hour_of_half_day(int(hours), half, text)
    # a leap second is written 60
    if int(minutes) > 59 or int(seconds or 0) > 60:
        raise ValueError(text)
    if sign == ":":  # milliseconds as a number, which some write without leading noughts
        if len(fraction) > 3:
            raise ValueError(text)
        fraction = fraction.zfill(3)
    whole = hour * 3600 + int(minutes) * 60 + int(seconds or 0) - _offset(zone)
    return whole * 10**9 + _fraction(fraction)


def _hour_of_half_day(hour: int, half: str, text: str) -> int:
    """The hour from midnight of one from 1 to 12 that counts half a day."""
    if not 1 <= hour <= 12:
        raise ValueError(text)
    # 12 am is midnight, 12 pm noon
    return hour % 12 + (12 if half.lower() == "pm" else 0)


def _fraction(digits: str | None) -> int:
    """Nanoseconds that decimals of a second are; digits beyond the ninth are cut."""
    return int((digits or "0")[:9].ljust(9, "0"))


def _offset(zone: str | None) -> int:
    if not zone or zone.upper() in ("Z", "UTC"):
        return 0
    digits = zone[1:].replace(":", "").ljust(4, "0")
    return (-1 if zone[0] == "-" else 1) * (int(digits[:2]) * 3600 + int(digits[2:]) * 60)
