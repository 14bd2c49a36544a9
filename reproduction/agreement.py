"""Which items agreed before, so that a change of the code that loses one is seen."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

from reproduction.item import Item

_FILE = Path(__file__).parent / "agreed.json"
Agreed = Mapping[str, Sequence[str]]


def recorded() -> Agreed:
    """Part → places that agreed when they were last recorded."""
    found: Agreed = json.loads(_FILE.read_text(encoding="utf-8")) if _FILE.exists() else {}
    return found


def with_parts(before: Agreed, by_part: Mapping[str, Sequence[Item]]) -> Agreed:
    """The record with the parts that were run replaced."""
    return {**before, **{part: [item.where for item in items if item.agrees] for part, items in by_part.items()}}


def write_recorded(agreed: Agreed) -> None:
    """Keep a record."""
    _FILE.write_text(json.dumps(agreed, indent=1, ensure_ascii=False, sort_keys=True) + "\n", encoding="utf-8")


def lost(before: Agreed, by_part: Mapping[str, Sequence[Item]]) -> list[tuple[str, str]]:
    """(part, place) of what agreed before and does not now, or is gone, among the parts that were run."""
    now = with_parts({}, by_part)
    return [(part, where) for part in by_part for where in before.get(part, ()) if where not in now[part]]
