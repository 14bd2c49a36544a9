"""Which checks agreed before, so that a change of the code that loses one is seen."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

from reproduction.item import Item

_FILES = {
    True: Path(__file__).parent / "agreed_short.json",
    False: Path(__file__).parent / "agreed.json",
}
Agreed = Mapping[str, Mapping[str, Sequence[str]]]


def recorded(short: bool) -> Agreed:
    """Part → place → names of the checks that agreed when they were last recorded."""
    path = _FILES[short]
    found: Agreed = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    return found


def with_parts(before: Agreed, by_part: Mapping[str, Sequence[Item]]) -> Agreed:
    """The record with the parts that were run replaced."""
    return {
        **before,
        **{part: {item.where: _holding(item) for item in items} for part, items in by_part.items()},
    }


def write_recorded(agreed: Agreed, short: bool) -> None:
    """Keep a record."""
    _FILES[short].write_text(
        json.dumps(agreed, indent=1, ensure_ascii=False, sort_keys=True) + "\n", encoding="utf-8"
    )


def lost(before: Agreed, by_part: Mapping[str, Sequence[Item]]) -> list[tuple[str, str, str]]:
    """(part, place, check) of what agreed before and does not now, or is gone, among the parts that were run."""
    now = with_parts({}, by_part)
    return [
        (part, where, name)
        for part in by_part
        for where, names in before.get(part, {}).items()
        for name in names
        if name not in now[part].get(where, ())
    ]


def _holding(item: Item) -> list[str]:
    return [check.name for check in item.checks if check.holds]
