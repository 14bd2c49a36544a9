"""Record: measured signals with the faces of a notebook."""

from __future__ import annotations

from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from residuum.identification.record import Record as MeasuredRecord
from residuum.identification.record_formats import write_record
from residuum.library.optional_package import need
from residuum.library.picture import Curve, Panel, Picture, axis
from residuum.library.plotly_figure import figure
from residuum.library.result import html

if TYPE_CHECKING:
    import pandas
    import plotly.graph_objects


class Record(MeasuredRecord):
    """Measured signals on one even time base, shape (n,) each, with a unit a channel; a missing
    sample is NaN.

    Made by `rs.read`, `rs.from_arrays`, `rs.from_pandas`, `rs.from_xarray` and `rs.simulate`.
    `record["speed"]` is a signal, `record.units["speed"]` its unit, `record.time` the sample
    instants [s]; `record.window(start, stop)` are the samples start … stop − 1,
    `record.select(names)` some channels, `record.rename({old: new})` others names.

    Parameters
    ----------
    channels : mapping of name to array, shape (n,)
    units : mapping of name to unit
    sample_time : float
        [s]
    t0 : float
        Time of the first sample [s].
    notes : tuple of str
    source : str
        A name for reports.

    Raises
    ------
    BadRecord
        No channel, unequal lengths, an infinite value, a sample time that is not positive, a
        channel without a unit.
    BadUnit
        A text that is no unit.

    Examples
    --------
    >>> import residuum as rs
    >>> record = rs.from_arrays({"u": [0.0, 1.0, 1.0]}, units={"u": "V"}, sample_time=0.1)
    >>> print(record)
    record: 3 samples of 0.1 s, 0.3 s; u [V]
    """

    def save(self, path: str | PathLike[str]) -> None:
        """Write the record file `path`; its ending says the format (`.csv`, `.npz`, …). A failed
        write leaves no file behind.

        Parameters
        ----------
        path : str or path

        Raises
        ------
        BadRecord
            An ending that is not known, or a folder that does not exist.

        Examples
        --------
        >>> import residuum as rs
        >>> record = rs.from_arrays({"u": [0.0, 1.0]}, units={"u": "V"}, sample_time=0.1)
        >>> record.save("drive.dat")  # doctest: +ELLIPSIS
        Traceback (most recent call last):
            ...
        residuum.identification.errors.BadRecord: ...
        """
        write_record(self, Path(path))

    def to_pandas(self) -> pandas.DataFrame:
        """A DataFrame, a column a channel and the time [s] as index; units are in
        `frame.attrs["units"]`.

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
        >>> record = rs.from_arrays({"u": [0.0, 1.0, 1.0]}, units={"u": "V"}, sample_time=0.1)
        >>> record.to_pandas()["u"].tolist()
        [0.0, 1.0, 1.0]
        """
        pandas = need("pandas", "a DataFrame")
        frame = pandas.DataFrame(dict(self.channels), index=pandas.Index(self.time, name="time"))
        # Where `rs.from_pandas` looks for them.
        frame.attrs["units"] = dict(self.units)
        return frame

    def plot(self) -> plotly.graph_objects.Figure:
        """A Plotly figure with a panel a channel; MissingPackage when Plotly is not installed.

        Returns
        -------
        plotly.graph_objects.Figure

        Examples
        --------
        >>> import residuum as rs
        >>> record = rs.from_arrays({"u": [0.0, 1.0, 1.0]}, units={"u": "V"}, sample_time=0.1)
        >>> len(record.plot().data)
        1
        """
        return figure(self.picture())

    def picture(self) -> Picture:
        """A panel a channel, as a value for whoever draws it otherwise.

        Returns
        -------
        Picture

        Examples
        --------
        >>> import residuum as rs
        >>> record = rs.from_arrays({"u": [0.0, 1.0, 1.0]}, units={"u": "V"}, sample_time=0.1)
        >>> len(record.picture().panels)
        1
        """
        time = self.time
        panels = [
            Panel(n, "time [s]", axis(n, self.units[n]), [Curve(n, time, s)])
            for n, s in self.channels.items()
        ]
        return Picture(panels)

    def __str__(self) -> str:
        channels = ", ".join(axis(name, unit) for name, unit in self.units.items())
        return (
            f"{self.source or 'record'}: {self.n} samples of {self.sample_time:.6g} s,"
            f" {self.duration:.6g} s; {channels}"
        )

    def __repr__(self) -> str:
        return f"<residuum Record {self}>"

    def _repr_html_(self) -> str:
        rows = [
            {
                "channel": name,
                "unit": self.units[name],
                # Of a channel that is missing throughout NumPy would warn, and tell NaN.
                "least": float(np.nanmin(signal)) if not np.isnan(signal).all() else None,
                "largest": float(np.nanmax(signal)) if not np.isnan(signal).all() else None,
                "missing": int(np.isnan(signal).sum()),
            }
            for name, signal in self.channels.items()
        ]
        title = f"{self.source or 'Record'}: {self.n} samples of {self.sample_time:.6g} s"
        return html(title, rows, self.picture())


def shown(record: MeasuredRecord) -> Record:
    """A record with the faces of the library."""
    if isinstance(record, Record):
        return record
    return Record(
        record.channels, record.units, record.sample_time, record.t0, record.notes, record.source
    )
