"""The columns of a DataFrame as channels: names, units and numbers, each refused with what a
DataFrame has for it.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from residuum.identification.errors import BadRecord
from residuum.identification.record_formats.loggers.logger_head import (
    is_unit,
    unit_of_head,
    unit_word,
)
from residuum.nearest_names import known_names

if TYPE_CHECKING:
    import pandas


def as_frame(table: Any, where: str) -> pandas.DataFrame:
    """The DataFrame of a DataFrame, or of a Series with a name; BadRecord for anything else and for
    columns of one name.
    """
    if hasattr(table, "to_frame") and not hasattr(table, "columns"):
        if table.name is None:
            raise BadRecord(
                f"{where}: is a Series without a name; give it one: series.rename('speed')"
            )
        table = table.to_frame()
    if not hasattr(table, "columns"):
        raise BadRecord(
            f"{where}: is {type(table).__name__}; must be a DataFrame, or make a record with"
            " rs.from_arrays({…})"
        )
    if len(twice := table.columns[table.columns.duplicated()]):
        raise BadRecord(
            f"{where}: column {twice[0]!r} stands twice; rename one, or keep the first:"
            " frame.loc[:, ~frame.columns.duplicated()]"
        )
    return table


def heads(
    frame: pandas.DataFrame, where: str, *, without: Any = None
) -> dict[Any, tuple[str, str]]:
    """Column → (name, unit) of every column but the one of time; several rows of heads are joined,
    a row of units is one.
    """
    columns = [column for column in frame.columns if without is None or column != without]
    if getattr(frame.columns, "nlevels", 1) > 1:
        by_column = _of_levels(columns)
    else:
        by_column = {column: unit_of_head(str(column)) for column in columns}
    names = [name for name, _ in by_column.values()]
    if twice := [name for name in names if names.count(name) > 1]:
        raise BadRecord(f"{where}: columns share the name {twice[0]!r}; rename one")
    return by_column


def _of_levels(columns: list[Any]) -> dict[Any, tuple[str, str]]:
    rows = {column: [str(part).strip() for part in column] for column in columns}
    last = [parts[-1].strip("[]()") for parts in rows.values()]
    filled = [unit for unit in last if unit and not unit.startswith("Unnamed")]
    if filled and all(is_unit(unit_word(unit)) for unit in filled):
        return {
            column: (".".join(_named(parts[:-1])), unit_word(unit) if unit in filled else "")
            for (column, parts), unit in zip(rows.items(), last, strict=True)
        }
    return {column: unit_of_head(".".join(_named(parts))) for column, parts in rows.items()}


def _named(parts: list[str]) -> list[str]:
    return [part for part in parts if part and not part.startswith("Unnamed")]


def units_of(
    by_column: Mapping[Any, tuple[str, str]],
    attributes: Mapping[Any, str],
    given: Mapping[Any, str],
) -> dict[str, str]:
    """Name → unit: what the caller tells goes over what the frame's attributes say, and that over
    the heads.
    """
    units = dict(by_column.values())
    for source in (attributes, given):
        for key, unit in source.items():
            name = by_column[key][0] if key in by_column else key
            if name in units:
                units[name] = unit
            elif source is given:
                raise BadRecord(
                    f"units: there is no channel {key!r}; {known_names(key, units, 'there are')}"
                )
    return units


def numbers(values: Any, where: str) -> npt.NDArray[np.float64]:
    """The numbers of a column, NaN where it has none; BadRecord for instants, complex numbers and
    text.
    """
    kind = getattr(getattr(values, "dtype", None), "kind", "")
    if kind in "mM" and kind:
        raise BadRecord(
            f"{where}: holds instants, not numbers; take the time from it with time=…, or leave it"
            " out with frame.drop(…)"
        )
    if kind == "c":
        raise BadRecord(
            f"{where}: holds complex numbers; keep one part of them, or leave it out with"
            " frame.drop(…)"
        )
    try:
        return np.asarray(values, dtype=float)
    except (TypeError, ValueError):
        raise BadRecord(
            f"{where}: does not hold numbers; make numbers of it, or leave it out with"
            " frame.drop(columns=…)"
        ) from None
