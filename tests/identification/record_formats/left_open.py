"""Files that leave something open, and the way on that is told: a keyword of `rs.read` (a pattern), a key over HTTP."""

from collections.abc import Callable

_DATES = ["date;n [rpm]", "01/02/2024;1", "02/02/2024;1", "01/02/2024;5"]
_SET = ["date;n [rpm]", *(f"2024-01-01 00:00:{k - 20 * (k > 29):02d};{k}" for k in range(50))]


def _rows(head: str, row: Callable[[int], str]) -> list[str]:
    return [head, *map(row, range(40))]


LEFT_OPEN = {
    "heads": (
        _rows("0,0", lambda k: f"{k + 1},{k}"),
        r"names=\['time \[s\]', 'name2'\]",
        "?names=time%20[s],name2",
    ),
    "date": (_DATES, "time='day first'", "?time_form=day%20first"),
    "clock": (
        _rows("time;n [rpm]", lambda k: f"00:{k:02d};{k}"),
        "time='mm:ss'",
        "?time_form=mm:ss",
    ),
    "spreadsheet": (
        _rows("time;n [rpm]", lambda k: f"{45000 + k / 86400:.8f};{k}"),
        "time='excel'",
        "?time_form=excel",
    ),
    "unit of times": (
        _rows("Zeit;n [rpm]", lambda k: f"{k};{k}"),
        r"units=\{'Zeit': 's'\}",
        "?unit=Zeit=s",
    ),
    "cell": (
        _rows("Zeit [s];n [rpm]", lambda k: f"{k};{'worn out' if k == 3 else k}"),
        r"missing=\['worn out'\]",
        "?missing=worn%20out",
    ),
    "cell of ours": (
        _rows("time [s],n [rpm]", lambda k: f"{k},{'OLx' if k == 3 else k}"),
        r"missing=\['OLx'\]",
        "?missing=OLx",
    ),
    "stamps": (
        _rows("Zeit [s];n [rpm]", lambda k: f"{k // 2};{k}"),
        "duplicates='spread'",
        "?duplicates=spread",
    ),
    "stamps of ours": (
        _rows("time [s],n [rpm]", lambda k: f"{k // 2},{k}"),
        "duplicates='spread'",
        "?duplicates=spread",
    ),
    "set clock": (_SET, "reordered='bridge'", "?reordered=bridge"),
    "uneven": (
        _rows("time [s],n [rpm]", lambda k: f"{k + 0.3 * (k % 2)},{k}"),
        "resample=True",
        "?resample=true",
    ),
    "unit": (
        _rows("time [s],CHANNEL [V(]", lambda k: f"{k},{k}"),
        r"units=\{'CHANNEL': 'UNIT'\}",
        "?unit=CHANNEL=UNIT",
    ),
    "decimal": (
        _rows("Zeit [s];n [rpm]", lambda k: f"{k};{k % 9 + 1},234"),
        "decimal=SIGN",
        "?decimal=SIGN",
    ),
    "times": (
        _rows("t [s];date;n [rpm]", lambda k: f"{k};2024-01-01 00:00:{k:02d};{k}"),
        r"map=\{'time': 'COLUMN'\}",
        "?time=COLUMN",
    ),
}
