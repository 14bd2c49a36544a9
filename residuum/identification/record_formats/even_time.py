"""Sample time of a time column: even to 1 % of the step, or resampled on request."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from scipy.optimize import minimize_scalar

from residuum.identification.errors import BadRecord

FloatArray = npt.NDArray[np.float64]
JITTER = 0.01  # of the step
HOLE = 3.0
"""Of a channel's own median step: over a longer stretch without a value nothing is interpolated."""
# part of the step by which stamps may lie beside even instants that their samples were taken at:
# what writes them is late
_NEAR = 0.2
RESAMPLED = "resampled to"
"""How a note tells of it."""
_MOST = 1e8  # samples on even instants
_MOST_DECIMALS = 7  # of seconds, that stamps are looked at for having been rounded to
# samples for each value of a stepped signal (a gear, a state), at least
_FEW = 4


def even_columns(
    columns: FloatArray,
    source: str,
    *,
    resample: bool,
    first_row: int = 0,
    told: list[str] | None = None,
    names: Sequence[str] = (),
) -> tuple[float, FloatArray]:
    """Check that `columns[0]` is an even time base; return (step [s], columns on it).

    `columns` has shape (1 + channels, n). A step that differs from the median by more than 1 % is
    refused with its row (counted from `first_row`), unless even stamps were only rounded to the
    digits they are written with, or `resample` asks for linear interpolation; longer holes stay
    missing, and what was done is put into `told`, under `names` if given.
    """
    time = columns[0]
    if time.shape[0] < 2:
        raise BadRecord(f"{source}: has {time.shape[0]} samples; at least 2 are needed")
    steps = np.diff(time)
    if np.isnan(time).any():
        raise BadRecord(
            f"{source}, row {first_row + int(np.argmax(np.isnan(time)))}: time is missing; every"
            " row needs it"
        )
    if (backward := steps <= 0).any():
        row = first_row + 1 + int(np.argmax(backward))
        raise BadRecord(
            f"{source}, row {row}: time does not increase; rows must be in order of time"
        )
    median = float(np.median(steps))
    # beside the jitter that is allowed, what doubles of this size are rounded by
    uneven = np.abs(steps - median) > JITTER * median + 4 * float(np.spacing(np.abs(time).max()))
    if not uneven.any() or _only_rounded(time):
        # of the whole span, in which the jitter of single stamps cancels
        step = float((time[-1] - time[0]) / (len(time) - 1))
        if resample:
            signals, filled = _between_slower(columns[1:], step)
            columns = np.stack([time, *signals])
            _tell(told, names, step, filled, columns)
        return step, columns
    if resample:
        step, signals, done = made_even(time - time[0], columns[1:], source)
        _tell(told, names, step, done, columns)
        return step, np.stack([time[0] + step * np.arange(signals.shape[1]), *signals])
    row, bad_step = first_row + 1 + int(np.argmax(uneven)), float(steps[np.argmax(uneven)])
    raise BadRecord(
        f"{source}, row {row}: time step {bad_step:.6g} s differs from {median:.6g} s by more than"
        f" 1 %{', as at the beginning of summer time' if an_hour_ahead(bad_step, median) else ''}",
        way_on=[("resample", True, "to accept it: holes of more than three steps stay missing")],
    )


def an_hour_ahead(steps: FloatArray | float, usual: float) -> npt.NDArray[np.bool_]:
    """Of steps [s]: whether an hour is left out beside the usual step, as the beginning of summer
    time leaves one out.

    >>> an_hour_ahead(np.array([60.0, 3660.0, 3540.0]), 60.0)
    array([False,  True, False])
    """
    return np.asarray(np.abs(steps - 3600.0 - usual) < max(0.5 * usual, 1.0))


def _tell(
    notes: list[str] | None,
    names: Sequence[str],
    step: float,
    done: Sequence[tuple[str, int] | None],
    columns: FloatArray,
) -> None:
    """Put what became of channels into `notes`; None is nothing."""
    if notes is not None:
        heads = names or [f"column {k}" for k in range(2, len(columns) + 1)]
        notes += [
            f"{head} {resampling(step, *change)}"
            for head, change in zip(heads, done, strict=True)
            if change is not None
        ]


def _between_slower(
    values: FloatArray, step: float
) -> tuple[FloatArray, list[tuple[str, int] | None]]:
    """Channels (c, n) on even instants, those that have a value every few instants only with what
    lies between, and how.
    """
    even = step * np.arange(values.shape[1], dtype=np.float64)
    done = [_between(values[k], even, step) for k in range(len(values))]
    return np.stack([signal for signal, _ in done]), [how for _, how in done]


def _between(
    column: FloatArray, even: FloatArray, step: float
) -> tuple[FloatArray, tuple[str, int] | None]:
    held = np.flatnonzero(~np.isnan(column))
    if len(held) < 2 or float(np.median(np.diff(held))) < 2:
        return column, None
    return on_instants(even[held], column[held], even, step)


def usual_step(time: FloatArray) -> tuple[float, bool]:
    """(step [s], whether all are alike) of rising instants, shape (n,), as reading them gives it;
    the median of uneven ones.
    """
    try:
        return even_columns(time[None], "", resample=False)[0], True
    except BadRecord:
        grid = on_grid(time)
        return float(np.median(np.diff(time))) if grid is None else grid[0], False


def _only_rounded(time: FloatArray) -> bool:
    """Whether even stamps were only rounded to so many decimals: a logger's 0.00325 s written as
    0.003, 0.007, 0.010.

    Then a straight line passes within half a unit of the last decimal of all of them, and a step is
    no multiple of that unit: multiples need no rounding. Stamps of so many significant digits have
    fewer decimals late than early: the last tenth tells.
    """
    apart, _ = _beside_a_line(time)
    return apart <= 1.0


def some_rounded_alike(time: FloatArray) -> bool:
    """Whether even stamps were only rounded, some neighbours to the same: a lost row then moves
    others by less than a step.

    With several rows to each stamp a lost one would pass for rounding.
    """
    apart, step = _beside_a_line(time)
    return apart <= 1.0 and step > 0.5


def _beside_a_line(time: FloatArray) -> tuple[float, float]:
    """(how far the stamps lie apart beside a straight line, step), in units of their last decimal;
    infinite where none is seen.

    Where they lie at most one apart, rounding alone explains it.
    """
    last, exact = len(time) - 1, 4.0 * float(np.spacing(np.abs(time).max()))
    unit = _last_decimal(time, exact)
    span = time[-1] - time[0]
    # a step that is a multiple of the unit needs no rounding: then the stamps are uneven
    if unit is None or abs(span - last * unit * np.rint(span / (last * unit))) < 1.5 * unit:
        return np.inf, 0.0
    # the line of least range: between the ends, turned by at most two units over the whole
    beside = time - time[0] - span / last * np.arange(len(time))
    turn = unit / last * np.arange(len(time))
    line = minimize_scalar(
        lambda by: float(np.ptp(beside - by * turn)), bounds=(-2.0, 2.0), method="bounded"
    )
    return float((line.fun - exact) / (unit * (1.0 + 1e-3))), float(span / last / unit)


def _last_decimal(time: FloatArray, exact: float) -> float | None:
    """The unit of the last decimal that stamps are written with; None beyond `_MOST_DECIMALS`."""
    late = time[-max(2, len(time) // 10) :]
    for decimals in range(_MOST_DECIMALS):
        unit = 10.0**-decimals
        if np.all(np.abs(late - unit * np.rint(late / unit)) <= 1e-4 * unit + exact):
            return unit
    return None


def on_grid(time: FloatArray) -> tuple[float, npt.NDArray[np.int64]] | None:
    """(step [s], place of each instant) of even instants of which some are absent; None for any
    others.
    """
    # the median step, for a mean would count the gaps in
    median = float(np.median(np.diff(time)))
    if not median > 0 or (time[-1] - time[0]) / median > _MOST:
        return None
    last = np.rint((time[-1] - time[0]) / median)
    step = float((time[-1] - time[0]) / last)
    place = np.rint((time - time[0]) / step).astype(np.int64)
    slack = JITTER * step + 4 * float(np.spacing(np.abs(time).max()))
    fits = bool((np.abs(time - time[0] - step * place) <= slack).all()) and bool(
        (np.diff(place) > 0).all()
    )
    return (step, place) if fits else None


def _near_grid(time: FloatArray) -> tuple[float, npt.NDArray[np.int64], FloatArray] | None:
    """(step [s], place, how far beside it [s]) of stamps near even instants, of which some are
    absent; None for others.
    """
    steps = np.diff(time)
    usual = float(np.median(steps))
    if not usual > 0 or (time[-1] - time[0]) / usual > _MOST:
        return None
    # jitter cancels in a mean of neighbours, not in a median
    step = float(np.mean(steps[steps < 1.5 * usual]))
    place = np.rint((time - time[0]) / step).astype(np.int64)
    step, begin = np.polyfit(place, time, 1)
    beside = time - begin - step * place
    fits = bool((np.abs(beside) <= _NEAR * step).all()) and bool((np.diff(place) > 0).all())
    return (float(step), place, beside) if fits else None


def resampling(step: float, how: str, holes: int) -> str:
    """What became of a channel, in words."""
    return f"{RESAMPLED} {step:.6g} s: {how}, {holes} samples left missing"


def made_even(
    time: FloatArray, values: FloatArray, source: str
) -> tuple[float, FloatArray, list[tuple[str, int]]]:
    """As `resampled`, but even instants of which some are absent need no interpolation: each sample
    keeps its instant.
    """
    grid = on_grid(time)
    if grid is None:
        return resampled(time, values, source)
    step, place = grid
    signals = np.full((len(values), int(place[-1]) + 1), np.nan)
    signals[:, place] = values
    unchanged = ("error about 0, each sample kept at its instant", signals.shape[1] - len(place))
    signals, filled = _between_slower(signals, step)
    return step, signals, [unchanged if how is None else how for how in filled]


def resampled(
    time: FloatArray, values: FloatArray, source: str
) -> tuple[float, FloatArray, list[tuple[str, int]]]:
    """(step [s], channels on even instants, the error of that in words and the number of samples
    left missing of each).

    Values (channels, n) at times (n,) that begin at 0 become linear between a channel's own
    samples, or are held where the signal is stepped; longer holes stay missing. The error is the
    RMS of linear interpolation, told by leaving out each sample: over the double distance that of a
    smooth signal is four times as large; noise is counted in. Where all stamps lie near even
    instants, and the signals run as smoothly over these, the stamps alone were late: each sample
    keeps its even instant. A line between two of them would part what happened at once, an input's
    step and what answers it. Where samples were late, too, a stepped channel keeps its samples, and
    so does one that interpolation would change more than the jitter can.
    """
    near = _near_grid(time)
    step = near[0] if near else float(np.median(np.diff(time)))
    if (time[-1] - time[0]) / step > _MOST:
        raise BadRecord(
            f"{source}: {time[-1] - time[0]:.6g} s at {step:.6g} s are more than 1e8 samples; cut"
            " the file at its gaps"
        )
    count = int(near[1][-1]) if near else int(np.floor(time[-1] / step + 1e-6))
    even: FloatArray = step * np.arange(count + 1, dtype=np.float64)
    if near:  # the first stamp is late or early like any other
        even = np.clip(even + time[0] - near[2][0], time[0], time[-1])
    resampled_channels = []
    for column in values:
        held = ~np.isnan(column)
        resampled_channels.append(on_instants(time[held], column[held], even, step))
    if near:
        alone = _stamps_alone_late(time, near[1], values)
        resampled_channels = [
            _at_its_places(channel, column, *near, alone)
            for channel, column in zip(resampled_channels, values, strict=True)
        ]
    signals = np.array([signal for signal, _ in resampled_channels])
    outcomes = [outcome for _, outcome in resampled_channels]
    # of no channel at all the shape is still (0, n)
    return step, signals.reshape(len(values), len(even)), outcomes


def _stamps_alone_late(time: FloatArray, place: npt.NDArray[np.int64], values: FloatArray) -> bool:
    """Whether signals run as smoothly over even instants as over their stamps: then the stamps were
    late, and no sample.
    """
    smoother = 0.0
    for column in values:
        held = ~np.isnan(column)
        if held.sum() > 2 and not is_stepped(column[held]):
            over_places = _linear_error(place[held].astype(float), column[held])
            over_stamps = _linear_error(time[held], column[held])
            # summed as logarithms, so that each signal counts alike, whatever its unit
            smoother += float(np.log(max(over_places, 1e-300) / max(over_stamps, 1e-300)))
    return smoother <= 0.0


def _at_its_places(
    pair: tuple[FloatArray, tuple[str, int]],
    column: FloatArray,
    step: float,
    place: npt.NDArray[np.int64],
    beside: FloatArray,
    alone: bool,
) -> tuple[FloatArray, tuple[str, int]]:
    """A channel with its samples at their own places, where the stamps alone were late or that
    changes it less.
    """
    held = ~np.isnan(column)
    if held.sum() <= 2 or not (alone or _kept(column[held], place[held], beside, step)):
        return pair
    signal = pair[0].copy()
    signal[place[held]] = column[held]
    late = (
        f"each sample kept at its even instant, at most {np.abs(beside).max():.2g} s beside its"
        " stamp"
    )
    return signal, (late, int(np.isnan(signal).sum()))


def _kept(taken: FloatArray, place: npt.NDArray[np.int64], beside: FloatArray, step: float) -> bool:
    """Whether a channel changes less where its samples, taken `beside` even instants, stay at the
    places of these.
    """
    moved = float(np.sqrt(np.mean(beside**2) * np.mean(np.diff(taken) ** 2))) / step
    return is_stepped(taken) or moved <= _linear_error(place.astype(float), taken)


def on_instants(
    at: FloatArray, taken: FloatArray, even: FloatArray, step: float
) -> tuple[FloatArray, tuple[str, int]]:
    """One channel on the instants `even`, what error that makes, and how many of them stay missing.

    Nothing is said before its first sample, after its last one, or between two that are more than
    three of its own steps apart.
    """
    held = ~np.isnan(taken)
    at, taken = at[held], taken[held]
    if len(at) < 2:
        return np.full_like(even, np.nan), ("too few samples", len(even))
    # an instant that rounding puts beside the first or last sample is that sample's
    ends: FloatArray = np.clip(even, at[0], at[-1])
    even = np.where(np.abs(ends - even) <= 1e-6 * step, ends, even)
    after = np.clip(np.searchsorted(at, even - 1e-9 * step), 1, len(at) - 1)
    own = float(np.median(np.diff(at)))
    # an instant at either end of a hole is a sample's own and is not missing
    hole = (at[after] - at[after - 1] > HOLE * own) & (np.abs(even - at[after]) > 1e-6 * step)
    hole &= np.abs(even - at[after - 1]) > 1e-6 * step
    hole |= (even < at[0]) | (even > at[-1])
    if is_stepped(taken):
        signal = taken[np.clip(np.searchsorted(at, even + 1e-6 * step, side="right") - 1, 0, None)]
        how = f"held between its samples, changes up to {own:.3g} s late"
    else:
        signal = np.interp(even, at, taken)
        how = f"error about {_linear_error(at, taken):.3g} rms"
    return np.where(hole, np.nan, signal), (how, int(hole.sum()))


def is_stepped(taken: FloatArray) -> bool:
    """Whether a signal jumps between values and has none between them (a gear, a switch, a set
    point).

    It stands still most of the time, or has few values, all whole. A line between two samples would
    be a value that never was.
    """
    values = np.unique(taken)
    few = len(values) * _FEW <= len(taken) and bool((values == np.rint(values)).all())
    return few or float(np.mean(np.diff(taken) == 0)) >= 0.5


def _linear_error(at: FloatArray, taken: FloatArray) -> float:
    if len(at) < 3:
        return float("nan")
    # each sample as the line between its neighbours has it; the error of a line grows with the
    # square of the distance, which here is twice as long: a quarter
    weight = (at[1:-1] - at[:-2]) / (at[2:] - at[:-2])
    left_out = taken[1:-1] - ((1 - weight) * taken[:-2] + weight * taken[2:])
    return float(np.sqrt(np.mean(left_out**2)) / 4)
