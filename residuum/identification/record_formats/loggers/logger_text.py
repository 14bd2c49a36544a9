"""The text of a logger's file: encoding, delimiter, decimal sign, cells. Every guess comes with its
reason.
"""

import csv
import re
from collections import Counter
from collections.abc import Collection

from residuum.identification.errors import BadRecord

DELIMITERS = ("\t", ";", "|", ",", " ")
MISSING = (
    *(
        "",
        "nan",
        "null",
        "none",
        "n/a",
        "na",
        "#n/a",
        "#nv",
        "-",
        "--",
        "---",
        "*",
        "?",
        "no data",
        "bad",
        "invalid",
    ),
    *("unavailable", "unknown", "offline", "not available", "no value"),  # of home automation
    *("#div/0!", "#value!", "#ref!", "#num!", "#name?"),  # of spreadsheets
)
"""Cells that loggers write for a value that is not there, in lower case."""
_SIGN = ("decimal", "SIGN")
# whatever sign and grouping: which of them holds is found, or said
_NUMBER = re.compile(r"[+-]?(\d[\d.,]*|[.,]\d+)([eE][+-]?\d+)?")
# a date with the year first or last, a time of day, or a month by name
_STAMP = re.compile(
    r"(\d{4}[-/.]\d\d?[-/.]\d\d?|\d\d?[-/.]\d\d?[-/.](\d{4}|\d\d)|\d+:\d\d|\d\d?[-."
    r" /]+[A-Za-zä]{3,9}[-. ,/]+\d{4}"
    r"|[A-Za-zä]{3,9}[. ]+\d\d?,? +\d{4})([T :,.][^|;\t]*)?"
)
# by the decimal sign, numbers with the other sign between their thousands
_GROUPED = {
    ",": re.compile(r"[+-]?[1-9]\d{0,2}(\.\d{3})+(,\d*)?"),
    ".": re.compile(r"[+-]?[1-9]\d{0,2}(,\d{3})+(\.\d*)?"),
}
# numbers that can be read with this decimal sign only; `1,234` and `1.234` are not among them
_SURE = {
    sign: re.compile(
        rf"[+-]?((0|\d{{4,}})?{at}\d+|\d*{at}(\d{{1,2}}|\d{{4,}})|\d+{at}|[1-9]\d{{0,2}}({by}\d{{3}})+{at}\d*"
        rf"|[1-9]\d{{0,2}}({by}\d{{3}}){{2,}})([eE].*)?|[^{by}]*{at}[^{by}]*[eE].*"
    )
    for sign, at, by in ((",", ",", r"\."), (".", r"\.", ","))
}
# a number and a word of at most twelve letters behind it
_WITH_UNIT = re.compile(r"([+-]?[\d.,]+(?:[eE][+-]?\d+)?)\s*([A-Za-zµΩ°%][^\s\d:;,]{0,11})")
_SCANNED = 2000  # lines by which the delimiter is found
_BLANK_BETTER = 0.1  # of a row that is cut into values, by which the blank must be better
# what stands between thousands beside point and comma: blanks that do not break, Swiss
# apostrophes
_BLANKS = "\u00a0\u202f\u2009 '’"
_BY_BLANKS = re.compile(rf"[+-]?[1-9]\d{{0,2}}([{_BLANKS}]\d{{3}})+([.,]\d*)?")


def plain(start: bytes) -> bytes:
    """The begin of a text file of any encoding, in one that spells ASCII as itself, to look for
    what a format begins with.
    """
    encoding = _encoding(start)[0]
    return (
        start.decode(encoding, "ignore").removeprefix("\ufeff").encode()
        if encoding != "latin-1"
        else start
    )


def decoded(content: bytes, source: str, encoding: str | None = None) -> tuple[str, str, str]:
    """(text, encoding, reason) of a file's bytes; BadRecord when it is no text."""
    name, reason = (encoding, "said by the mapping") if encoding else _encoding(content)
    try:
        text = content.decode(name)
    except (UnicodeDecodeError, LookupError) as error:
        raise BadRecord(
            f"{source}: is not text in encoding {name!r} ({' '.join(str(error).split())[:80]})"
        ) from None
    if "\x00" in text:
        raise BadRecord(
            f"{source}: holds the character NUL; it is not a logger's text file, or in an unknown"
            " encoding: save as UTF-8"
        )
    if not text.strip():
        raise BadRecord(f"{source}: is empty; column names and at least two rows are needed")
    return text.removeprefix("\ufeff"), name, reason


def _encoding(content: bytes) -> tuple[str, str]:
    if content.startswith(b"\xef\xbb\xbf"):
        return "utf-8-sig", "byte-order mark of UTF-8"
    if content.startswith((b"\xff\xfe\0\0", b"\0\0\xfe\xff")):
        return "utf-32", "byte-order mark of UTF-32"
    if content.startswith((b"\xff\xfe", b"\xfe\xff")):
        return "utf-16", "byte-order mark of UTF-16"
    # without a mark: letters of ASCII have a zero byte beside them in UTF-16
    head = content[:4000]
    if len(head) > 3 and head[1::2].count(0) > 0.4 * len(head[1::2]):
        return "utf-16-le", "every second byte is zero"
    if len(head) > 3 and head[::2].count(0) > 0.4 * len(head[::2]):
        return "utf-16-be", "every first byte of two is zero"
    try:
        content.decode("utf-8")
        return "utf-8", "all bytes are valid UTF-8"
    except UnicodeDecodeError as error:
        # which has a character for every byte
        return "latin-1", f"byte {error.start} is not valid UTF-8; one byte a character"


def cells_of(text: str, delimiter: str) -> list[list[str]]:
    """The cells of every line (quotes removed, blanks stripped); runs of blanks separate where the
    delimiter is a blank.
    """
    lines = text.splitlines()
    if delimiter == " ":
        return [[cell for cell in re.split(r"[ \t]+", line) if cell] for line in lines]
    rows = []
    for line in lines:
        row = (
            next(csv.reader([line], delimiter=delimiter), [])
            if '"' in line
            else line.split(delimiter)
        )
        rows.append([cell.strip() for cell in row])
    return rows


def without_footer(rows: list[list[str]]) -> tuple[list[list[str]], str]:
    """The rows to the last that holds a value, and what is written below it ("" for nothing): a
    logger may close its file with a line of words.
    """
    last = next((row for row in reversed(range(len(rows))) if any(map(is_value, rows[row]))), -1)
    if last < 0:
        return rows, ""
    below = (cell for row in rows[last + 1 :] for cell in row if cell)
    return rows[: last + 1], " ".join(below)


def is_value(cell: str) -> bool:
    """Whether a cell could be a number or a time stamp."""
    return bool(_NUMBER.fullmatch(ungrouped(cell)) or _STAMP.fullmatch(cell))


def ungrouped(cell: str) -> str:
    """A number without the blanks between its thousands; any other cell as it is."""
    return re.sub(f"[{_BLANKS}]", "", cell) if _BY_BLANKS.fullmatch(cell) else cell


def with_unit(cell: str) -> tuple[str, str] | None:
    """(number, unit) of a cell that holds both, such as `20,00 °C`."""
    match = _WITH_UNIT.fullmatch(cell)
    return (match[1], match[2]) if match and _NUMBER.fullmatch(ungrouped(match[1])) else None


def is_stamp(cell: str) -> bool:
    """Whether a cell could be a time stamp."""
    return bool(_STAMP.fullmatch(cell))


def find_delimiter(text: str, source: str, missing: Collection[str] = ()) -> tuple[str, str]:
    """(delimiter, reason): the one that cuts the rows into equally many cells that are values.

    Cells of `missing`, in lower case, are left out. The blank between date and time of day has to
    be better by a tenth: a few words that mean no value must not make it the delimiter.
    """
    lines = [line for line in text.splitlines()[:_SCANNED] if line.strip()]
    # the later half: the head's lines are cut otherwise than the samples
    sample = "\n".join(lines[len(lines) // 2 :])
    best = (0.0, "", "")
    for delimiter in DELIMITERS:
        rows = cells_of(sample, delimiter)
        width, count = Counter(map(len, rows)).most_common(1)[0]
        share = _share_of_values([cell for row in rows for cell in row], {*MISSING, *missing})
        score = share * count / len(rows)
        if width >= 2 and score > best[0] + (_BLANK_BETTER if delimiter == " " else 1e-9):
            best = (
                score,
                delimiter,
                (
                    f"cuts {count} of {len(rows)} rows into {width} cells, {100 * share:.0f} % of"
                    " them values"
                ),
            )
    if best[0] < 0.3:
        raise BadRecord(
            f"{source}: no delimiter (tab ; | , blank) cuts its rows into columns of numbers"
        )
    return best[1], best[2]


def _share_of_values(cells: list[str], missing: Collection[str]) -> float:
    """Part of the cells that hold something which are values, with a unit behind them or none."""
    filled = [cell for cell in cells if cell.lower() not in missing]
    n_values = sum(is_value(cell) or with_unit(cell) is not None for cell in filled)
    return n_values / max(1, len(filled))


def find_decimal(rows: list[list[str]], source: str, first_row: int) -> tuple[str, str]:
    """(decimal sign, reason); BadRecord where `1,234` may be either, or where both signs are
    used.
    """
    by_sign: dict[str, tuple[int, str]] = {}
    unsure: tuple[int, str] | None = None
    for row, cells in enumerate(rows, start=first_row):
        for cell in map(ungrouped, cells):
            signs = _signs_of(cell)
            if len(signs) == 1:
                by_sign.setdefault(signs[0], (row, cell))
            elif signs and "," in cell:
                # a point that may be either is one: only a comma has to be asked for
                unsure = unsure or (row, cell)
    if len(by_sign) == 2:  # both signs are sure somewhere
        says = " and ".join(f"{cell!r} in row {row}" for row, cell in by_sign.values())
        raise BadRecord(f"{source}: both decimal signs are used, {says}", way_on=[_SIGN])
    if by_sign:
        sign, (row, cell) = next(iter(by_sign.items()))
        return sign, f"{cell!r} in row {row} reads only so"
    if unsure:
        row, cell = unsure
        raise BadRecord(
            f"{source}, row {row}: {cell!r} may hold a decimal comma or a thousands sign",
            way_on=[_SIGN],
        )
    return ".", "no cell says otherwise"


def _signs_of(cell: str) -> list[str]:
    """The decimal signs with which a number that holds a sign can be read; none for other cells."""
    if not _NUMBER.fullmatch(cell) or not ("," in cell or "." in cell):
        return []
    sure = [sign for sign, pattern in _SURE.items() if pattern.fullmatch(cell)]
    return sure if len(sure) == 1 else [*_SURE]


def number(cell: str, decimal: str) -> float:
    """The number of a cell; ValueError when it is none."""
    cell = ungrouped(cell)
    if not _NUMBER.fullmatch(cell):
        raise ValueError(cell)
    if _GROUPED[decimal].fullmatch(cell):
        cell = cell.replace("." if decimal == "," else ",", "")
    return float(cell.replace(",", ".") if decimal == "," and "." not in cell else cell)
