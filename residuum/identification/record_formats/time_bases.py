"""Channels that were sampled at times of their own, brought onto one even time base; what was not
measured stays missing.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from residuum.identification.errors import BadRecord
from residuum.identification.record import Record
from residuum.identification.record_formats.even_time import (
    JITTER,
    FloatArray,
    even_columns,
    on_grid,
    on_instants,
    resampling,
)
from residuum.identification.record_formats.options import ReadOptions

# samples of all channels on the base, and base samples for each one that was measured: a file of
# few samples in far-apart places would fill the memory with missing ones
_MOST, _THINNEST = 2e7, 8
_LISTED = 8  # channels that a refusal lists
IndexArray = npt.NDArray[np.int64]
NOT_READ = "not read: "
"""How a note begins that lists what a reader leaves out."""
MEASURED_AT = "measured at"
"""How a note tells of a channel that has samples at some instants only."""


@dataclass(frozen=True)
class TimedChannel:
    """One channel: its name and unit, its instants [s] and values, both of shape (n,)."""

    name: str
    unit: str
    time: FloatArray
    values: FloatArray

    @property
    def says(self) -> str:
        """Name, number of samples, span and step, as a message lists them."""
        step = float(np.median(np.diff(self.time)))
        return (
            f"{self.name}: {len(self.time)} samples of {step:.6g} s from {self.time[0]:.6g} s to"
            f" {self.time[-1]:.6g} s"
        )


def on_one_base(
    channels: Sequence[TimedChannel], source: str, options: ReadOptions, notes: tuple[str, ...] = ()
) -> Record:
    """The record of channels with time bases of their own.

    The base is that of the channel with the shortest step, over the time that any channel covers. A
    channel whose instants all lie on it (a slower one, one that begins late, ends early or has a
    hole) keeps its samples there and is missing elsewhere. Others are brought onto it where
    `options.resample` allows it.

    Raises BadRecord that lists the channels where they do not lie on one base, and that of
    `even_columns` for an uneven one.
    """
    # channels of one table share one array of instants
    bases: dict[int, TimedChannel] = {}
    for channel in channels:
        bases.setdefault(id(channel.time), channel)
    for channel in bases.values():
        _check(channel, source)
    finest = min(bases.values(), key=_fineness)
    step = _step(finest, source, options)
    begin, n = _span(channels, finest, step, source)
    even: FloatArray = begin + step * np.arange(n, dtype=np.float64)
    by_base = {base: _places(channel.time, begin, step) for base, channel in bases.items()}
    if not options.resample and any(place is None for place in by_base.values()):
        listed = "; ".join(channel.says for channel in channels[:_LISTED])
        how = "to bring them onto the finest: what was not measured stays missing"
        raise BadRecord(
            f"{source}: channels have several time bases ({listed})",
            way_on=[("resample", True, how)],
        )
    signals, log = {}, list(notes)
    for channel in channels:
        signals[channel.name], remark = _on_base(channel, by_base[id(channel.time)], even, step)
        log += remark
    units = {channel.name: options.unit_of(channel.name, channel.unit) for channel in channels}
    return Record(
        signals,
        units,
        options.settle_sample_time(step, source),
        t0=begin,
        notes=tuple(log),
        source=source,
    )


def _fineness(channel: TimedChannel) -> tuple[float, int]:
    """What the finest channel has least of: step [s]; of several, the longest one is taken."""
    return float(np.median(np.diff(channel.time))), -len(channel.time)


def _on_base(
    channel: TimedChannel, place: IndexArray | None, even: FloatArray, step: float
) -> tuple[FloatArray, list[str]]:
    """A channel on the instants of the base, and what is to say of it: interpolated where its own
    do not lie on it.
    """
    if place is None:
        signal, (how, holes) = on_instants(channel.time, channel.values, even, step)
        return signal, [f"{channel.name} {resampling(step, how, holes)}"]
    n = len(even)
    signal = np.full(n, np.nan)
    signal[place] = channel.values
    if len(place) == n:
        return signal, []
    return signal, [
        f"{channel.name}: {MEASURED_AT} {len(place)} of {n} instants, missing at the others"
        f" ({channel.says})"
    ]


def _check(channel: TimedChannel, source: str) -> None:
    if not np.isfinite(channel.time).all():
        at = int(np.argmin(np.isfinite(channel.time)))
        raise BadRecord(
            f"{source}, channel {channel.name!r}, sample {at}: time is missing; every sample"
            " needs it"
        )
    if (backward := np.diff(channel.time) <= 0).any():
        at = int(np.argmax(backward)) + 1
        raise BadRecord(
            f"{source}, channel {channel.name!r}, sample {at}: time does not increase; samples must"
            " be in order of time"
        )


def _step(finest: TimedChannel, source: str, options: ReadOptions) -> float:
    """The step of the base; a channel with absent samples has one, uneven instants have one only
    where they may be resampled.
    """
    if grid := on_grid(finest.time):
        return grid[0]
    if options.resample:
        return float(np.median(np.diff(finest.time)))
    return even_columns(finest.time[None, :], f"{source}, channel {finest.name!r}", resample=False)[
        0
    ]


def _span(
    channels: Sequence[TimedChannel], finest: TimedChannel, step: float, source: str
) -> tuple[float, int]:
    """(first instant, number of instants) of the finest channel's base over the time of all
    channels.
    """
    anchor = float(finest.time[0])
    before = int(np.floor((anchor - min(channel.time[0] for channel in channels)) / step + JITTER))
    begin = anchor - before * step
    n = int(np.floor((max(channel.time[-1] for channel in channels) - begin) / step + JITTER)) + 1
    if n * len(channels) > max(_MOST, _THINNEST * sum(len(channel.time) for channel in channels)):
        raise BadRecord(
            f"{source}: {n * step:.6g} s at {step:.6g} s are too many samples, mostly missing; cut"
            " the file at its gaps"
        )
    return begin, n


def _places(time: FloatArray, begin: float, step: float) -> IndexArray | None:
    """The place of each instant on the base, or None where one lies between two places."""
    exact = (time - begin) / step
    place = np.rint(exact).astype(np.int64)
    # times since 1970 are rounded to 2e-7 s, which of a short step is more than the jitter
    slack = JITTER + 4 * float(np.spacing(np.abs(time).max())) / step
    fits = bool((np.abs(exact - place) <= slack).all()) and bool((np.diff(place) > 0).all())
    return place if fits else None


def among(left_out: Sequence[str]) -> str:
    """The end of a refusal that lists the channels which are none to read."""
    return f"; there are {', '.join(left_out[:_LISTED])}" if left_out else ""
