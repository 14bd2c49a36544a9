"""Where does a model fail? Ranked regions of speed, position, time, … in which its error is
large.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt

from residuum.array_types import FloatArray
from residuum.identification.physics import Experiment, PhysicalModel, Simulator
from residuum.identification.physics.simulate.kalman import Smoothed
from residuum.identification.record import Record
from residuum.identification.residual_analysis.noise import stretches
from residuum.identification.residual_analysis.policy import (
    FEWEST_IN_A_BIN,
    LOCATION_BINS,
    LOCATION_SCORE,
    MOST_REGIONS,
    ONE_WAY,
    STANDSTILL_REGION,
    STANDSTILL_SPEED,
    WIDEST_REGION,
)
from residuum.identification.residual_analysis.structured_error import StructuredError
from residuum.identification.units import compatible


@dataclass(frozen=True, eq=False)
class Axis:
    """A signal against which an error is shown.

    `kind` is one of velocity, position, current, temperature, level, input, time, frequency, other;
    it only chooses the words.
    """

    name: str
    unit: str
    kind: str
    values: FloatArray

    @cached_property
    def known(self) -> npt.NDArray[np.bool_]:
        """Where the signal is there."""
        return np.isfinite(self.values)

    @cached_property
    def bins(self) -> tuple[FloatArray, npt.NDArray[np.intp]]:
        """Edges of bins of the values that are there, and the bin of each: the same for every error
        that has no gaps.
        """
        return _binned(self.values[self.known])


@dataclass(frozen=True)
class Region:
    """A stretch of one axis on which the error is larger than elsewhere.

    `times_noise` = RMS of the error there ÷ noise floor; `share` = part of the error's power that
    lies there; `time_share` = part of the samples that lie there; `direction` is "forward" or
    "backward" when the region is seen in one direction of movement only; `of` names the output or
    balance whose error it is.
    """

    axis: str
    start: float
    stop: float
    unit: str
    times_noise: float
    share: float
    time_share: float
    direction: str | None
    of: str
    says: str
    score: float


def locate(
    error: FloatArray,
    axes: Sequence[Axis],
    *,
    noise_rms: float,
    of: str,
    direction: FloatArray | None = None,
    correlation_samples: float = 1.0,
) -> list[Region]:
    """Rank the regions that hold more of an error's power than their share of time.

    Along each axis every interval of 24 quantile bins is scored by the likelihood ratio of "one
    variance inside, another outside" against "one variance everywhere" (Kulldorff's scan statistic
    for variances), with the number of independent samples n / `correlation_samples`. A region whose
    error has four times the power in one direction of movement is given for that direction only.

    Parameters
    ----------
    error : array, shape (n,)
        Output error or missing term, NaN where unknown.
    axes : sequence of Axis, values of shape (n,)
        Signals to look along.
    noise_rms : float
        The noise floor, in the unit of the error.
    of : str
        The output or balance the error belongs to.
    direction : array, shape (n,), optional
        Sign of the movement.
    correlation_samples : float
        Correlation length of the noise in samples (≥ 1).

    Returns
    -------
    Regions, the most telling first, at most one an axis, none whose error is within the noise;
    empty when no axis beats chance.

    References
    ----------
    M. Kulldorff, *A spatial scan statistic*, Commun. Stat. 26 (1997).
    """
    located = _Located(error, of, noise_rms, direction)
    candidates = []
    for axis in axes:
        interval = _scan(error, axis, correlation_samples)
        if interval is not None:
            candidates.append(_region(located, axis, interval))
    # an error that is plainly uneven may still be too small for a word
    above_noise = [region for region in candidates if region.times_noise > 1.0]
    return sorted(above_noise, key=lambda region: -region.score)


@dataclass(frozen=True, eq=False)
class _Located:
    """The error (n,) of an output or a balance, its noise, and the direction of movement (n,)."""

    error: FloatArray
    of: str
    noise_rms: float
    direction: FloatArray | None


@dataclass(frozen=True)
class _Interval:
    start: float
    stop: float
    lowest: float
    highest: float
    score: float


def _scan(error: FloatArray, axis: Axis, correlation: float) -> _Interval | None:
    known = np.isfinite(error) & axis.known
    if known.sum() < 4 * FEWEST_IN_A_BIN:
        return None
    squares = error[known] ** 2
    edges, index = axis.bins if np.array_equal(known, axis.known) else _binned(axis.values[known])
    if len(edges) < 3:
        return None
    count = np.asarray(np.bincount(index, minlength=len(edges) - 1), dtype=np.float64)
    power = np.asarray(
        np.bincount(index, weights=squares, minlength=len(edges) - 1), dtype=np.float64
    )
    first, last, score = _best_interval(count, power, correlation)
    # beside twice the logarithm of the number of bins, the price of having looked at all of them
    if score < LOCATION_SCORE + 2.0 * np.log(len(count)):
        return None
    return _Interval(
        float(edges[first]), float(edges[last + 1]), float(edges[0]), float(edges[-1]), score
    )


def _region(located: _Located, axis: Axis, interval: _Interval) -> Region:
    """The interval in words and figures, in one direction of movement where the error is that's."""
    error, direction = located.error, located.direction
    total = float(np.nansum(error**2))
    inside = np.isfinite(error) & (axis.values >= interval.start) & (axis.values <= interval.stop)
    way = _one_way(error, inside, direction)
    if way is not None and direction is not None:
        inside &= (direction > 0) == (way == "forward")
    power = float(np.sum(error[inside] ** 2))
    times_noise = float("inf")
    if located.noise_rms > 0:
        times_noise = float(np.sqrt(power / max(inside.sum(), 1)) / located.noise_rms)
    return Region(
        axis=axis.name,
        start=interval.start,
        stop=interval.stop,
        unit=axis.unit,
        times_noise=times_noise,
        share=power / total if total > 0 else 0.0,
        time_share=float(inside.mean()),
        direction=way,
        of=located.of,
        says=_words(axis, interval, way, times_noise),
        score=interval.score,
    )


def _one_way(
    error: FloatArray, inside: npt.NDArray[np.bool_], direction: FloatArray | None
) -> str | None:
    """The direction of movement that holds nearly all of the error inside a region, if one does."""
    if direction is None:
        return None
    ways = {"forward": inside & (direction > 0), "backward": inside & (direction < 0)}
    if min(mask.sum() for mask in ways.values()) < FEWEST_IN_A_BIN:
        return None
    means = {name: float(np.mean(error[mask] ** 2)) for name, mask in ways.items()}
    larger = max(means, key=lambda name: means[name])
    return larger if means[larger] > ONE_WAY * min(means.values()) else None


def _binned(values: FloatArray) -> tuple[FloatArray, npt.NDArray[np.intp]]:
    """Edges of bins, and the bin of each value."""
    edges = _bin_edges(np.sort(values))
    return edges, np.clip(np.searchsorted(edges, values, side="right") - 1, 0, len(edges) - 2)


def _bin_edges(values: FloatArray) -> FloatArray:
    """Half quantile, half even edges of sorted values: quantiles alone blur rare places, even bins
    alone starve the busy ones.
    """
    low, high = float(values[0]), float(values[-1])
    if not high > low:
        return np.array([low])
    quantiles = np.quantile(values, np.linspace(0, 1, LOCATION_BINS // 2 + 1))
    edges = np.unique(np.concatenate([quantiles, np.linspace(low, high, LOCATION_BINS // 2 + 1)]))
    # an edge stays where enough samples lie on either side of it
    merged = [edges[0]]
    position = np.searchsorted(values, edges)
    start = 0
    for edge, place in zip(edges[1:-1], position[1:-1], strict=True):
        if place - start >= FEWEST_IN_A_BIN and len(values) - place >= FEWEST_IN_A_BIN:
            merged.append(edge)
            start = place
    return np.array([*merged, edges[-1]])


def _best_interval(
    count: FloatArray, power: FloatArray, correlation: float
) -> tuple[int, int, float]:
    """(first bin, last bin, twice the log-likelihood ratio) of the interval with the largest
    variance contrast.
    """
    # −2 log of the likelihood ratio: n_in log(s²_in/s²) + n_out log(s²_out/s²), of all intervals at
    # once by differences of cumulative sums
    n, total = count.sum(), power.sum()
    cumulative_n, cumulative_p = np.r_[0.0, np.cumsum(count)], np.r_[0.0, np.cumsum(power)]
    inside_n = cumulative_n[None, 1:] - cumulative_n[:-1, None]
    inside_p = cumulative_p[None, 1:] - cumulative_p[:-1, None]
    outside_n, outside_p = n - inside_n, total - inside_p
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = inside_n * np.log(inside_p / inside_n / (total / n)) + outside_n * np.log(
            outside_p / outside_n / (total / n)
        )
        higher = inside_p / inside_n > outside_p / outside_n
    # intervals with their ends in order that hold more than the rest does, and not nearly
    # everything
    allowed = (
        (np.triu(np.ones_like(inside_n)) > 0)
        & (inside_n > 0)
        & (outside_n > 0)
        & higher
        & (inside_n <= WIDEST_REGION * n)
    )
    # samples that noise ties together count as one
    score = np.where(allowed, -ratio, -np.inf) / max(correlation, 1.0)
    first, last = np.unravel_index(int(np.argmax(score)), score.shape)
    return int(first), int(last), float(score[first, last])


_STANDSTILL: Mapping[str, str] = {
    "velocity": "near standstill",
    "current": "near zero current",
    "input": "near zero input",
}


def _words(axis: Axis, interval: _Interval, direction: str | None, times_noise: float) -> str:
    start, stop, lowest, highest = interval.start, interval.stop, interval.lowest, interval.highest
    near_zero = start <= 0 <= stop and max(abs(start), abs(stop)) < STANDSTILL_REGION * max(
        abs(lowest), abs(highest)
    )
    edge = 1e-9 * (highest - lowest)
    unit = f" {axis.unit}" if axis.unit else ""
    if near_zero and axis.kind in _STANDSTILL:
        place = _STANDSTILL[axis.kind]
    elif axis.kind == "time":
        place = f"between {start:.3g} s and {stop:.3g} s"
    elif start <= lowest + edge:
        place = f"at {axis.name} below {stop:.3g}{unit}"
    elif stop >= highest - edge:
        place = f"at {axis.name} above {start:.3g}{unit}"
    else:
        place = f"at {axis.name} between {start:.3g} and {stop:.3g}{unit}"
    only = {"forward": ", moving forward only", "backward": ", moving backward only"}.get(
        direction or "", ""
    )
    if not np.isfinite(times_noise):
        return f"the model fails {place}{only}: the error has no noise beside it"
    return (
        f"the model fails {place}{only}: the error is {float(f'{times_noise:.2g}'):g} times the"
        " noise"
    )


# The signals of a model along which its error is looked at.


def signal_axes(
    model: PhysicalModel, experiment: Experiment, X: FloatArray, record: Record | None = None
) -> list[Axis]:
    """Inputs, states, variables that balances define, recorded temperatures and time, as axes of
    one record.

    `X` are the states along which to look, shape (n, states), from a simulation or a smoother. A
    state or variable that is measured carries the name of its output.
    """
    roles = _roles(model)
    shown = {output.value.text.strip(): name for name, output in model.outputs.items()}
    axes = [
        Axis(name, signal.unit, roles.get(name, "input"), experiment.U[:, k])
        for k, (name, signal) in enumerate(model.inputs.items())
        if not signal.absent
    ]
    simulator = Simulator(model)
    for k, name in enumerate(simulator.states):
        unit = model.states[name].unit if name in model.states else ""
        axes.append(Axis(shown.get(name, name), unit, roles.get(name, "other"), X[:, k]))
    look = simulator.look(experiment, X)
    for balance in model.balances.values():
        if balance.defines is not None and balance.defines in look:
            name = balance.defines
            axes.append(
                Axis(
                    shown.get(name, name),
                    _unit_of_output(model, name),
                    roles.get(name, "other"),
                    look[name],
                )
            )
    if record is not None:
        axes += _recorded_temperatures(record, {axis.name for axis in axes})
    seconds = experiment.sample_time * np.arange(experiment.n, dtype=np.float64)
    axes.append(Axis("time", "s", "time", seconds))
    return axes


def direction_of_movement(axes: Sequence[Axis]) -> FloatArray | None:
    """Sign of the first velocity among the axes, zero near standstill; None without one."""
    velocity = next((axis.values for axis in axes if axis.kind == "velocity"), None)
    if velocity is None or not np.any(np.isfinite(velocity)):
        return None
    # near standstill noise alone turns the sign
    moves = np.abs(velocity) > STANDSTILL_SPEED * np.nanmax(np.abs(velocity))
    return np.asarray(np.where(moves, np.sign(velocity), 0.0))


def _roles(model: PhysicalModel) -> Mapping[str, str]:
    kinds = {"ambient": "temperature"}
    return {
        name: kinds.get(role, role)
        for balance in model.balances.values()
        for role, name in balance.variables.items()
    }


def _unit_of_output(model: PhysicalModel, variable: str) -> str:
    units = [
        output.unit for output in model.outputs.values() if output.value.text.strip() == variable
    ]
    return units[0] if units else {"current": "A"}.get(_roles(model).get(variable, ""), "")


def _recorded_temperatures(record: Record, known: set[str]) -> list[Axis]:
    columns = [
        name
        for name in record.names
        if name not in known and record.units[name] and compatible(record.units[name], "K")
    ]
    return [
        Axis(name, record.units[name], "temperature", np.asarray(record[name], dtype=float))
        for name in columns
    ]


# Where structured outputs and their balances' missing terms are large.


def regions(
    model: PhysicalModel,
    experiments: Sequence[Experiment],
    residuals: Sequence[FloatArray],
    smoothed: Sequence[Smoothed],
    axes: Sequence[Sequence[Axis]],
    floors: Mapping[str, float],
    structured: Mapping[str, StructuredError],
) -> tuple[Region, ...]:
    """Regions of every axis and of frequency, the most telling first; none when no output's error
    is structured.

    `floors` is the noise floor of each output; a missing term is compared with the width of its own
    band.
    """
    present = [name for name, test in structured.items() if test.present]
    if not present:
        return ()
    joined = [
        replace(axis, values=np.concatenate([a[k].values for a in axes]))
        for k, axis in enumerate(axes[0])
    ]
    direction = direction_of_movement(joined)
    located: list[Region] = []
    for name in present:
        errors = [residual[:, list(model.outputs).index(name)] for residual in residuals]
        located += locate(
            np.concatenate(errors),
            joined,
            noise_rms=floors[name],
            of=name,
            direction=direction,
            correlation_samples=max(structured[name].noise.time_constant, 1.0),
        )
        amplitude, frequency = _spectrum(errors, experiments)
        located += locate(amplitude, [frequency], noise_rms=floors[name], of=name)
    for balance in smoothed[0].missing:
        # no test says what of a missing term is noise: its own band and memory stand for it
        term = np.concatenate([s.missing[balance].value for s in smoothed])
        band = float(np.median(np.concatenate([s.missing[balance].std for s in smoothed])))
        located += locate(
            term,
            joined,
            noise_rms=band,
            of=balance,
            direction=direction,
            correlation_samples=_correlation_samples(term),
        )
    return tuple(sorted(located, key=lambda region: -region.score)[:MOST_REGIONS])


def _spectrum(
    errors: Sequence[FloatArray], experiments: Sequence[Experiment]
) -> tuple[FloatArray, Axis]:
    """Amplitudes |E(f)|/√n of the longest stretch (white noise of RMS σ gives RMS σ), and their
    frequencies [Hz].
    """
    parts = [
        (error[part], e.sample_time)
        for error, e in zip(errors, experiments, strict=True)
        for part in stretches(np.isfinite(error))
    ]
    longest, sample_time = max(parts, key=lambda part: len(part[0]))
    amplitude = np.abs(np.fft.rfft(longest)) / np.sqrt(len(longest))
    frequency = np.arange(1, amplitude.shape[0], dtype=np.float64) / (len(longest) * sample_time)
    return amplitude[1:], Axis("frequency", "Hz", "frequency", frequency)


def _correlation_samples(x: FloatArray) -> float:
    """Lag at which the autocorrelation of x has fallen below 1/e, at least 1."""
    centred = x - x.mean()
    size = 1 << (2 * len(x) - 1).bit_length()
    spectrum = np.fft.rfft(centred, size)
    correlation = np.fft.irfft(np.abs(spectrum) ** 2, size)[: len(x)]
    below = np.flatnonzero(correlation < correlation[0] / np.e)
    return float(max(1, below[0] if below.size else len(x)))
