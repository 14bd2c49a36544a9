"""Result: what every answer of the library can do."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np

from residuum.library.answers.plain import to_plain
from residuum.library.optional_package import need
from residuum.library.picture import Picture
from residuum.library.plotly_figure import figure
from residuum.library.svg import svg

if TYPE_CHECKING:
    import pandas
    import plotly.graph_objects

Row = Mapping[str, Any]

# Of a table in a notebook; the rest is counted.
_ROWS = 12


class Result(ABC):
    """An answer as a value: text, table, picture and JSON of one and the same thing.

    `str(result)` is what the command line prints, `result.to_dict()` what it prints with `--json`;
    in a notebook it is shown as a compact table and a picture.
    """

    def to_dict(self) -> dict[str, Any]:
        """The JSON object of the contract, in plain Python values.

        Returns
        -------
        dict

        Examples
        --------
        >>> import residuum as rs
        >>> record = rs.simulate("linear-axis", duration=2.0, seed=1)
        >>> comparison = rs.model("linear-axis").compare(record)
        >>> "structured_error" in comparison.to_dict()
        True
        """
        # Arrays and NaN of an answer are made plain in one place, as the contract has JSON values
        # alone.
        plain: dict[str, Any] = to_plain(self._answer())
        return plain

    def to_pandas(self) -> pandas.DataFrame:
        """The table of the answer.

        Returns
        -------
        pandas.DataFrame

        Raises
        ------
        MissingPackage
            pandas is not installed.

        Examples
        --------
        >>> import residuum as rs
        >>> record = rs.simulate("linear-axis", duration=2.0, seed=1)
        >>> comparison = rs.model("linear-axis").compare(record)
        >>> "output" in comparison.to_pandas().columns
        True
        """
        return data_frame(self._rows())

    def plot(self) -> plotly.graph_objects.Figure:
        """The picture of the answer as a Plotly figure that can be changed.

        Returns
        -------
        plotly.graph_objects.Figure

        Raises
        ------
        MissingPackage
            Plotly is not installed.

        Examples
        --------
        >>> import residuum as rs
        >>> record = rs.simulate("linear-axis", duration=2.0, seed=1)
        >>> comparison = rs.model("linear-axis").compare(record)
        >>> len(comparison.plot().data) > 0
        True
        """
        return figure(self._picture())

    def picture(self) -> Picture:
        """The picture of the answer as a value, for whoever draws it otherwise.

        Returns
        -------
        Picture

        Examples
        --------
        >>> import residuum as rs
        >>> record = rs.simulate("linear-axis", duration=2.0, seed=1)
        >>> len(rs.model("linear-axis").compare(record).picture().panels)
        4
        """
        return self._picture()

    @abstractmethod
    def _answer(self) -> dict[str, Any]:
        """The contract's object."""

    @abstractmethod
    def _rows(self) -> Sequence[Row]:
        """The table, a mapping of column to value a row."""

    @abstractmethod
    def _picture(self) -> Picture:
        """What is drawn."""

    def __repr__(self) -> str:
        first = str(self).splitlines()[0] if str(self) else ""
        return f"<residuum {type(self).__name__}: {first}>"

    def _repr_html_(self) -> str:
        # SVG, so that a notebook shows a picture without Plotly and its script.
        return html(type(self).__name__, self._shown_rows(), self._picture())

    def _shown_rows(self) -> Sequence[Row]:
        """The table as a notebook shows it, where that is another one."""
        return self._rows()


def html(title: str, rows: Sequence[Row], picture: Picture) -> str:
    """A compact table and a picture."""
    return f"<div><strong>{escape(title)}</strong>{html_table(rows)}{svg(picture)}</div>"


def html_table(rows: Sequence[Row]) -> str:
    """Rows of equal columns as a table; numbers to four digits.

    >>> html_table([{"name": "a", "value": 1.23456}])
    '<table><tr><th>name</th><th>value</th></tr><tr><td>a</td><td>1.235</td></tr></table>'
    """
    if not rows:
        return "<p>nothing</p>"
    heads = "".join(f"<th>{escape(str(name))}</th>" for name in rows[0])
    body = "".join(
        "<tr>" + "".join(f"<td>{escape(_cell(v))}</td>" for v in row.values()) + "</tr>"
        for row in rows[:_ROWS]
    )
    more = f"<p>and {len(rows) - _ROWS} more</p>" if len(rows) > _ROWS else ""
    return f"<table><tr>{heads}</tr>{body}</table>{more}"


def data_frame(rows: Sequence[Row]) -> pandas.DataFrame:
    """Rows as a pandas DataFrame; MissingPackage when pandas is not installed."""
    return need("pandas", "a DataFrame").DataFrame([dict(row) for row in rows])


def _cell(value: Any) -> str:
    if value is None:
        return ""
    if isinstance(value, bool | np.bool_):
        return "yes" if value else "no"
    if isinstance(value, float | np.floating):
        return f"{value:.4g}"
    if isinstance(value, list | tuple):
        return ", ".join(_cell(item) for item in value)
    return str(value)
