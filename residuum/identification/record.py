"""Record: one stretch of evenly sampled, measured signals; the one type that carries data
everywhere.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np
import numpy.typing as npt

from residuum.identification.errors import BadRecord, BadUnit
from residuum.identification.units import convert, parse_unit
from residuum.nearest_names import known_names

Signal = npt.NDArray[np.floating]

MOST_UNITS = 100
"""Different units of a record: each that is not common is looked up, which takes up to .7 ms."""


@dataclass(frozen=True, eq=False)
class Record:
    """Signals on one even time base.

    A record is one experiment: sample k of every channel was taken at `t0 + k * sample_time`.
    A sample that is missing is NaN in its channel (never filled); infinite values are refused.

    Parameters
    ----------
    channels : mapping of name to array, shape (n,)
        Float64 or float32; other number types become float64. The arrays are kept read-only.
    units : mapping of name to unit
        One unit a channel (`""` = none is said: no conversion takes it for one).
    sample_time : float
        Seconds between samples, > 0.
    t0 : float
        Time of the first sample [s], on the recorder's own clock.
    notes : tuple of str
        Free lines kept with the data (`split: 0.7` is understood by `split`).
    source : str
        Where the data came from (file name, bus address).

    Raises
    ------
    BadRecord
        No channel, unequal lengths, infinite value, non-positive sample time, unit missing, NUL in
        a text.
    BadUnit
        A unit that is not known.

    Examples
    --------
    >>> record = Record({"u": [0.0, 1.0, 1.0]}, {"u": "V"}, sample_time=0.1)
    >>> record.n, round(record.duration, 3)
    (3, 0.3)
    """

    channels: Mapping[str, Signal]
    units: Mapping[str, str]
    sample_time: float
    t0: float = 0.0
    notes: tuple[str, ...] = ()
    source: str = ""

    def __post_init__(self) -> None:
        where = f"record {self.source!r}" if self.source else "record"
        if not self.channels:
            raise BadRecord(f"{where}: has no channel; at least one is needed")
        if not (np.isfinite(self.sample_time) and self.sample_time > 0):
            raise BadRecord(
                f"{where}: sample_time is {self.sample_time!r}; must be a positive number of"
                " seconds"
            )
        if not np.isfinite(self.t0):
            raise BadRecord(f"{where}: t0 is {self.t0!r}; must be finite")
        signals = self._checked_signals(where)
        # PostgreSQL takes no NUL in a text, and answered a stored record with an internal error.
        if nul := [
            text for text in (*self.channels, *self.units.values(), *self.notes) if "\x00" in text
        ]:
            raise BadRecord(
                f"{where}: {nul[0][:60]!r} holds the character NUL, which no database keeps"
            )
        units = self._checked_units(where)
        # The mappings as well: a frozen dataclass holds only its own names fast.
        object.__setattr__(self, "channels", MappingProxyType(signals))
        object.__setattr__(self, "units", MappingProxyType(units))
        object.__setattr__(self, "notes", tuple(self.notes))

    def _checked_signals(self, where: str) -> dict[str, Signal]:
        signals = {
            name: _signal(values, f"{where}, channel {name!r}")
            for name, values in self.channels.items()
        }
        lengths = {name: signal.shape[0] for name, signal in signals.items()}
        if len(set(lengths.values())) != 1:
            raise BadRecord(f"{where}: channels differ in length {lengths}; all must be equal")
        return signals

    def _checked_units(self, where: str) -> dict[str, str]:
        if unitless := [name for name in self.channels if name not in self.units]:
            raise BadRecord(
                f"{where}: channel {unitless[0]!r} has no unit; every channel needs one"
            )
        units = {name: self.units[name] for name in self.channels}
        if (different := len(set(units.values()))) > MOST_UNITS:
            raise BadUnit(
                f"{where}: its channels have {different} different units; at most {MOST_UNITS} are"
                " read"
            )
        for name, unit in units.items():
            try:
                parse_unit(unit)
            except BadUnit as error:
                way = ("units", {name: "UNIT"}, "in a spelling that is known")
                raise BadUnit(f"{where}, channel {name!r}: {error}", way_on=[way]) from error
        return units

    @property
    def names(self) -> tuple[str, ...]:
        """Channel names in their order."""
        return tuple(self.channels)

    @property
    def n(self) -> int:
        """Number of samples."""
        return int(next(iter(self.channels.values())).shape[0])

    @property
    def sampling_rate(self) -> float:
        """Samples a second [Hz]."""
        return 1.0 / self.sample_time

    @property
    def duration(self) -> float:
        """n sample times [s]."""
        return self.n * self.sample_time

    @property
    def time(self) -> npt.NDArray[np.float64]:
        """Sample instants [s], shape (n,)."""
        return self.t0 + self.sample_time * np.arange(self.n, dtype=np.float64)

    @property
    def split(self) -> float | None:
        """Fraction of the record meant for estimation, from a note `split: 0.7`; None when not
        noted.
        """
        for note in self.notes:
            key, _, value = note.partition(":")
            if key.strip().lower() == "split":
                return _fraction(value)
        return None

    def __getitem__(self, name: str) -> Signal:
        """The read-only signal of channel `name`; BadRecord names the channels there are."""
        try:
            return self.channels[name]
        except KeyError:
            raise BadRecord(
                f"record {self.source!r}: no channel {name!r};"
                f" {known_names(name, self.names, 'there are')}"
            ) from None

    def in_unit(self, name: str, unit: str) -> npt.NDArray[np.float64]:
        """Channel `name` converted to `unit`, shape (n,).

        BadUnit where the channel has none and one is wanted: not to say a unit is not to say that
        there is none.

        Parameters
        ----------
        name, unit : str

        Returns
        -------
        array, shape (n,)

        Raises
        ------
        BadRecord
            No such channel.
        BadUnit
            A unit of another quantity, or none at the channel.

        Examples
        --------
        >>> import residuum as rs
        >>> record = rs.from_arrays({"u": [0.0, 1.0, 1.0]}, units={"u": "V"}, sample_time=0.1)
        >>> record.in_unit("u", "mV").tolist()
        [0.0, 1000.0, 1000.0]
        """
        where = f"record {self.source!r}, " if self.source else ""
        if name in self.channels and not self.units[name] and parse_unit(unit).factors:
            way = ("units", {name: unit}, "if it is in that")
            raise BadUnit(
                f"{where}channel {name!r}: has no unit, and {unit!r} is needed", way_on=[way]
            )
        return convert(
            self[name], self.units[name], unit, what=f"{where}channel {name!r}", column=name
        )

    def missing(self, name: str) -> npt.NDArray[np.bool_]:
        """Mask of the missing samples of channel `name`, shape (n,).

        Parameters
        ----------
        name : str

        Returns
        -------
        array of bool, shape (n,)

        Examples
        --------
        >>> import residuum as rs
        >>> record = rs.from_arrays({"u": [0.0, float("nan")]}, units={"u": "V"}, sample_time=0.1)
        >>> record.missing("u").tolist()
        [False, True]
        """
        return np.isnan(self[name])

    def select(self, names: Iterable[str]) -> Record:
        """The record with these channels only, in this order.

        Parameters
        ----------
        names : iterable of str

        Returns
        -------
        Record

        Examples
        --------
        >>> import residuum as rs
        >>> record = rs.simulate("gate-drive", duration=1.0)
        >>> record.select(["speed", "voltage"]).names
        ('speed', 'voltage')
        """
        chosen = list(names)
        return replace(
            self,
            channels={name: self[name] for name in chosen},
            units={name: self.units[name] for name in chosen},
        )

    def rename(self, names: Mapping[str, str]) -> Record:
        """The record with channels renamed old → new; BadRecord when two would share a name.

        Parameters
        ----------
        names : mapping of old name to new name

        Returns
        -------
        Record

        Raises
        ------
        BadRecord
            No such channel, or two of one name.

        Examples
        --------
        >>> import residuum as rs
        >>> record = rs.from_arrays({"u": [0.0, 1.0, 1.0]}, units={"u": "V"}, sample_time=0.1)
        >>> record.rename({"u": "voltage"}).names
        ('voltage',)
        """
        new = [names.get(name, name) for name in self.names]
        if len(set(new)) != len(new):
            raise BadRecord(
                f"record {self.source!r}: renaming {dict(names)} makes two channels of one name"
            )
        # Refuses, by its name, a channel that there is not.
        for name in names:
            self[name]
        channels = dict(zip(new, self.channels.values(), strict=True))
        return replace(
            self, channels=channels, units=dict(zip(new, self.units.values(), strict=True))
        )

    def window(self, start: int, stop: int) -> Record:
        """Samples start … stop−1 (views, no copy), on the same clock.

        Parameters
        ----------
        start, stop : int
            Sample numbers.

        Returns
        -------
        Record

        Raises
        ------
        BadRecord
            Not within the record.

        Examples
        --------
        >>> import residuum as rs
        >>> record = rs.from_arrays({"u": [0.0, 1.0, 1.0]}, units={"u": "V"}, sample_time=0.1)
        >>> record.window(1, 3).time.tolist()
        [0.1, 0.2]
        """
        if not 0 <= start < stop <= self.n:
            raise BadRecord(
                f"record {self.source!r}: window {start}:{stop} is not inside 0:{self.n}"
            )
        channels = {name: signal[start:stop] for name, signal in self.channels.items()}
        return replace(self, channels=channels, t0=self.t0 + start * self.sample_time)


def _signal(values: npt.ArrayLike, where: str) -> Signal:
    try:
        array = np.asarray(values)
        if array.dtype not in (np.float32, np.float64):
            array = array.astype(np.float64)
    except (TypeError, ValueError):
        raise BadRecord(f"{where}: is not an array of numbers") from None
    if array.ndim != 1 or array.shape[0] == 0:
        raise BadRecord(f"{where}: has shape {array.shape}; must be one-dimensional and not empty")
    infinite = np.isinf(array)
    if infinite.any():
        raise BadRecord(
            f"{where}, sample {int(np.argmax(infinite))}: is infinite; must be finite or missing"
            " (nan)"
        )
    # a view, so that the caller's own array stays writable
    array = array.view()
    array.flags.writeable = False
    return array


def _fraction(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        # Lies between no numbers, and so is refused below in the same words.
        value = float("nan")
    if not 0 < value < 1:
        raise BadRecord(f"note 'split: {text.strip()}': must be a number between 0 and 1")
    return value
