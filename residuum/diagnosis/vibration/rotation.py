"""What turns with the shaft: speed, angle, rounds, and clocks brought together."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicSpline

from residuum.array_types import AnyArray, FloatArray
from residuum.diagnosis.thresholds.tails import HealthyBand
from residuum.diagnosis.vibration.bearing_lines import SLIP
from residuum.identification.errors import BadInput, BadRecord, Way
from residuum.identification.record import Record
from residuum.identification.units import convert, parse_unit

# Two recorders with clocks of their own, brought onto one time base by the synchronisation pulses
# that both see.

LARGEST_DRIFT = (
    1e-3  # crystal clocks differ by 1e-4 at most; more means that the pulses were paired wrongly
)
_SHORTEST_BASE = 20.0  # spacings: over fewer the reading error of one edge would pass for drift


@dataclass(frozen=True)
class ClockAlignment:
    """t_reference = t_middle + offset + (1 + drift) (t_other − t_middle).

    Attributes
    ----------
    offset : float
        Reading of the reference clock less that of the other, at `middle` [s].
    drift : float
        Relative rate difference [-]; 5e-5 is 50 ppm.
    middle : float
        Reading of the other clock about which the line was fitted [s].
    std : float
        Standard deviation of one pulse about the line [s].
    pulses : int
        Pairs that the fit rests on.
    """

    offset: float
    drift: float
    middle: float
    std: float
    pulses: int

    def to_reference(self, time: npt.ArrayLike) -> AnyArray:
        """Readings of the other clock [s] as readings of the reference clock [s]."""
        t = np.asarray(time, dtype=float)
        return self.middle + self.offset + (1 + self.drift) * (t - self.middle)

    def to_other(self, time: npt.ArrayLike) -> AnyArray:
        """Readings of the reference clock [s] as readings of the other clock [s]."""
        return self.middle + (np.asarray(time, dtype=float) - self.middle - self.offset) / (
            1 + self.drift
        )


def align_clocks(
    reference: npt.ArrayLike, aligned: npt.ArrayLike, expected_offset: float = 0.0
) -> ClockAlignment:
    """Least-squares line through the paired pulse times of two clocks.

    Each pulse is paired with the nearest one of the other clock after shifting by
    `expected_offset`, which must therefore be known to less than half the pulse spacing. Pairs more
    than a fifth of the spacing off the median are left out (a pulse that only one recorder saw).
    The drift is estimated only over at least 20 spacings, otherwise taken as 0.

    Parameters
    ----------
    reference, aligned : arrays of pulse times [s]
    expected_offset : float
        First guess of the offset [s].

    Raises
    ------
    BadRecord
        No pulse can be paired, or the drift comes out above 0.1 %.

    Examples
    --------
    >>> true = np.arange(100.0)
    >>> alignment = align_clocks(true, 0.13 + true * (1 - 40e-6))
    >>> round(1e6 * alignment.drift), round(float(alignment.to_reference(50.13 - 0.002)), 6)
    (40, 50.0)
    """
    reference, aligned = np.asarray(reference, dtype=float), np.asarray(aligned, dtype=float)
    if reference.size == 0 or aligned.size == 0:
        raise BadRecord("clock alignment: one recorder saw no synchronisation pulse")
    nearest = np.abs(reference[None, :] - expected_offset - aligned[:, None]).argmin(axis=1)
    difference = reference[nearest] - aligned
    spacing = float(np.median(np.diff(aligned))) if aligned.size > 1 else np.inf
    paired = np.abs(difference - np.median(difference)) <= 0.2 * spacing
    t, d = aligned[paired], difference[paired]
    middle = float(t.mean())
    long_enough = t.size >= 3 and np.ptp(t) >= _SHORTEST_BASE * spacing
    drift = (
        float(np.polynomial.Polynomial.fit(t - middle, d, 1).convert().coef[1])
        if long_enough
        else 0.0
    )
    if abs(drift) > LARGEST_DRIFT:
        raise BadRecord(
            f"clock alignment: the clocks drift by {1e6 * drift:.0f} ppm; at most"
            f" {1e6 * LARGEST_DRIFT:.0f} is plausible"
        )
    residuals = d - d.mean() - drift * (t - middle)
    return ClockAlignment(float(d.mean()), drift, middle, float(residuals.std()), int(t.size))


def on_clock_of(
    reference: Record, added: Record, alignment: ClockAlignment, names: Iterable[str] | None = None
) -> Record:
    """`reference` with channels of `added` added, each held from its last sample before; NaN where
    `added` has none.

    Holding (not interpolating) keeps two-valued signals two-valued; the error is less than one of
    other's sample times. A channel name that `reference` has already is left as it is.
    """
    at = (alignment.to_other(reference.time) - added.t0) / added.sample_time
    index = np.floor(at + 1e-9).astype(int)
    covered = (index >= 0) & (index < added.n)
    index = np.clip(index, 0, added.n - 1)
    channels, units = dict(reference.channels), dict(reference.units)
    for name in added.names if names is None else names:
        if name not in channels:
            channels[name] = np.where(covered, added[name][index], np.nan)
            units[name] = added.units[name]
    return replace(reference, channels=channels, units=units)


# Order tracking: signals at even steps of shaft angle instead of time, so that speed changes
# smear no line.


def angle_from_speed(speed_rpm: npt.ArrayLike, sampling_rate: float) -> AnyArray:
    """Turned revolutions ψ(t)/2π at every sample, shape (n,): the trapezoidal integral of a speed
    signal [rpm].

    Raises BadInput when the speed has gaps or is not positive throughout (the angle would not be a
    time axis).
    """
    speed = np.asarray(speed_rpm, dtype=float)
    if not (np.isfinite(speed).all() and (speed > 0).all()):
        raise BadInput("order tracking: the speed has gaps or is not positive throughout")
    steps = (speed[1:] + speed[:-1]) / (2 * 60 * sampling_rate)
    return np.concatenate([[0.0], np.cumsum(steps)])


def at_even_angle(x: npt.ArrayLike, angle: AnyArray, samples_per_revolution: float) -> AnyArray:
    """The signal resampled at even steps of angle by cubic splines.

    With `samples_per_revolution` the mean number that the record has, a line at k times shaft
    speed, whatever the speed does, becomes a sharp line at k orders; a resonance, fixed in hertz,
    is smeared by the share the speed varies. Components above a fifth of the sampling rate lose
    amplitude (cubic interpolation).

    Examples
    --------
    >>> angle = np.cumsum(np.linspace(0.01, 0.02, 2000))
    >>> x = np.cos(2 * np.pi * 3 * angle)
    >>> y = at_even_angle(x, angle, 60)
    >>> int(np.argmax(np.abs(np.fft.rfft(y[: 60 * 28])))) / 28
    3.0
    """
    x = np.asarray(x)
    if x.shape != angle.shape:
        raise BadInput(f"order tracking: signal {x.shape} and angle {angle.shape} differ in length")
    if not (np.diff(angle) > 0).all():
        raise BadInput("order tracking: the angle does not rise throughout")
    even = np.arange(angle[0], angle[-1], 1.0 / samples_per_revolution)
    at = np.interp(even, angle, np.arange(x.shape[0]))
    return np.asarray(CubicSpline(np.arange(x.shape[0]), x)(at), dtype=x.dtype)


# Rounds overlapped with the healthy band: where in the round does a machine differ from its
# healthy self?

PLACES_OF_A_ROUND = (
    200  # along a round: 10 ms of a round of 2 s, long against a ring, short against a quadrant
)


@dataclass(frozen=True, eq=False)
class RoundComparison:
    """Envelope RMS along the round, now and in health (the overlap of Fig. 76; `quadrant_rms` gives
    the boxes of Fig. 77).

    Attributes
    ----------
    place : array, shape (places,)
        Middle of each place, in quadrants: 2.5 is the middle of the third.
    middle, upper : arrays, shape (places,)
        Healthy median and the limit that a healthy place passes with the chosen probability, shared
        over the places.
    rounds : array, shape (rounds, places)
        Of the record compared.
    quadrant_rms : array, shape (rounds, quadrants)
    """

    place: AnyArray
    middle: AnyArray
    upper: AnyArray
    rounds: AnyArray
    quadrant_rms: AnyArray

    @property
    def exceeding(self) -> AnyArray:
        """Share of the rounds that pass the limit at each place, shape (places,)."""
        return np.asarray((self.rounds > self.upper).mean(axis=0))


def round_profile(segments: Sequence[AnyArray]) -> AnyArray:
    """RMS in equal places of a round, from its segments in quadrant order, shape
    (PLACES_OF_A_ROUND,).
    """
    places = PLACES_OF_A_ROUND // len(segments)
    return np.array(
        [
            np.sqrt(np.mean(part * part))
            for segment in segments
            for part in np.array_split(segment, places)
        ]
    )


def compare_rounds(
    healthy: HealthyBand, profiles: AnyArray, false_alarm: float, quadrants: int
) -> RoundComparison:
    """Profiles of a record's rounds, shape (rounds, PLACES_OF_A_ROUND), beside the healthy ones."""
    place = (np.arange(PLACES_OF_A_ROUND) + 0.5) * quadrants / PLACES_OF_A_ROUND
    square = profiles.reshape(profiles.shape[0], quadrants, -1) ** 2
    upper = healthy.upper(false_alarm / PLACES_OF_A_ROUND, 1.3)
    return RoundComparison(
        place, np.exp(healthy.mean), upper, profiles, np.sqrt(square.mean(axis=2))
    )


# Rounds and quadrants of a rotating machine, cut by the pulses of its indicator signal.

_END_TOLERANCE = 0.1  # of a quadrant: a window cut at pulses ends where the next one would stand
_LONGER = 1.4  # times the median width: the pulse that marks the first plier


@dataclass(frozen=True, eq=False)
class Rounds:
    """Complete rounds in a record.

    Attributes
    ----------
    edges : array of int, shape (rounds, quadrants + 1)
        Segment s of round r is samples edges[r, s] … edges[r, s+1] − 1; the first starts at the
        record's first pulse.
    phase : int or None
        Quadrant (0 …) that the first segment is, counted from the longer pulse; None when no pulse
        is longer.
    """

    edges: AnyArray
    phase: int | None

    def quadrant(self, segment: int) -> int:
        """Quadrant (0 …) that a segment is; with an unknown phase the segment itself."""
        return (segment + (self.phase or 0)) % (self.edges.shape[1] - 1)

    @property
    def count(self) -> int:
        """Number of complete rounds."""
        return int(self.edges.shape[0])


def cut_rounds(indicator: npt.ArrayLike, quadrants: int = 4) -> Rounds:
    """Cut a record into rounds of `quadrants` segments, each from one rising edge of i(t) to the
    next.

    A record that starts inside a pulse starts with its edge; a record that ends where the next edge
    is due (within a tenth of a quadrant) ends with it, so that a window cut from pulse to pulse is
    one round. When one pulse in every round is longer than the others (Remark 6.2), it opens the
    first quadrant.

    Parameters
    ----------
    indicator : array, shape (n,)
        Binary signal at any two levels (the middle between its least and greatest value is the
        threshold).

    Raises
    ------
    BadInput
        Missing samples, no pulse, or uneven spacing (a pulse lost or extra): the message says
        which.

    Examples
    --------
    >>> pulse = np.zeros(100)
    >>> pulse[:10] = 1
    >>> cut_rounds(np.tile(pulse, 8)).edges.tolist()
    [[0, 100, 200, 300, 400], [400, 500, 600, 700, 800]]
    """
    i = np.asarray(indicator, dtype=float)
    rising, width = pulses(i)
    spacing = np.diff(rising)
    if spacing.size == 0:
        raise BadInput("indicator: shows fewer than two pulses; a round cannot be cut")
    quadrant = float(np.median(spacing))
    uneven = np.abs(spacing / quadrant - 1) > 0.35
    if uneven.any():
        at = int(np.argmax(uneven))
        raise BadInput(
            f"indicator: pulses at samples {rising[at]} and {rising[at + 1]} are"
            f" {spacing[at] / quadrant:.2f} usual spacings apart; a pulse is lost or extra"
        )
    if abs(i.shape[0] - rising[-1] - spacing[-1]) <= _END_TOLERANCE * quadrant:
        rising = np.append(rising, i.shape[0])
    count = (rising.shape[0] - 1) // quadrants
    if count < 1:
        raise BadInput(
            f"indicator: shows {rising.shape[0] - 1} complete quadrants; a round needs {quadrants}"
        )
    starts = quadrants * np.arange(count)
    return Rounds(rising[starts[:, None] + np.arange(quadrants + 1)], _phase(width, quadrants))


def pulses(indicator: AnyArray) -> tuple[AnyArray, AnyArray]:
    """First sample and width [samples] of each pulse; a pulse that the record's end cuts has width
    −1.

    Raises BadInput when samples are missing or the signal never changes.
    """
    if np.isnan(indicator).any():
        raise BadInput("indicator: has missing samples")
    low, high = indicator.min(), indicator.max()
    if not high > low:
        raise BadInput("indicator: never changes; no pulse was seen")
    up = indicator > (low + high) / 2
    rising = np.flatnonzero(up & ~np.concatenate([[False], up[:-1]]))
    falling = np.flatnonzero(~up & np.concatenate([[False], up[:-1]]))
    if falling.shape[0] < rising.shape[0]:
        return rising, np.append(falling - rising[: falling.shape[0]], -1)
    return rising, falling - rising


def _phase(width: AnyArray, quadrants: int) -> int | None:
    whole = width[width > 0]
    if whole.shape[0] < quadrants:
        return None
    longer = np.flatnonzero(width > _LONGER * np.median(whole))
    if longer.shape[0] == 0 or not np.all(np.diff(longer) == quadrants):
        return None
    return int(-longer[0]) % quadrants


# What a signal does once a turn of the shaft, and what it does at one place only.

Signal = npt.NDArray[np.float64]
POINTS_OF_A_TURN = 256  # a turn; orders up to 128


@dataclass(frozen=True, eq=False)
class ShaftPattern:
    """A signal cut into whole turns of the shaft.

    Parameters
    ----------
    turns : array, shape (n_turns, POINTS_OF_A_TURN)
        The signal on an even grid of shaft angle: order tracking, so a speed that is not constant
        does not smear orders.
    """

    turns: Signal

    @property
    def typical(self) -> Signal:
        """Median over the turns, shape (POINTS_OF_A_TURN,): an average in which an event in one
        turn alone leaves no trace.
        """
        return np.asarray(np.median(self.turns, axis=0))

    @property
    def single(self) -> Signal:
        """What the turns do not share: each minus the typical turn, shape (n_turns,
        POINTS_OF_A_TURN).
        """
        return np.asarray(self.turns - self.typical)

    def orders(self) -> Signal:
        """Amplitude of each order of the typical turn [unit of the signal], shape
        (POINTS_OF_A_TURN/2 + 1,).
        """
        return np.asarray(np.abs(np.fft.rfft(self.typical)) * 2.0 / POINTS_OF_A_TURN)

    def band(self, low: int, high: int) -> npt.NDArray[np.complex128]:
        """Analytic signal of the typical turn with the orders low … high alone, shape
        (POINTS_OF_A_TURN,), complex.

        Its real part is the band-limited turn, its magnitude the envelope (McFadden 1986).
        """
        coefficients = np.fft.fft(self.typical)[: POINTS_OF_A_TURN // 2 + 1]
        order = np.arange(coefficients.shape[0])
        in_band = np.where((order >= low) & (order <= high), coefficients, 0.0)
        return np.asarray(2.0 * np.fft.ifft(in_band, POINTS_OF_A_TURN))


def shaft_pattern(x: Signal, shaft_turns: Signal) -> ShaftPattern:
    """Cut x into whole turns.

    Parameters
    ----------
    x : array, shape (n,)
    shaft_turns : array, shape (n,)
        Turns of the shaft since any moment, increasing, at each sample.

    >>> angle = np.linspace(0, 5.2, 4000) ** 1.02
    >>> pattern = shaft_pattern(3.0 * np.cos(2 * np.pi * 4 * angle), angle)
    >>> pattern.turns.shape, np.round(pattern.orders()[[3, 4, 5]], 2).tolist()
    ((5, 256), [0.0, 3.0, 0.0])
    """
    start = float(shaft_turns[0])
    whole = int(np.floor(shaft_turns[-1] - start))
    grid = start + np.arange(whole * POINTS_OF_A_TURN) / POINTS_OF_A_TURN
    return ShaftPattern(np.interp(grid, shaft_turns, x).reshape(whole, POINTS_OF_A_TURN))


# How fast a shaft turns, as a record's speed channel says, in whatever unit that was written.

_WORDS = ("speed", "rpm", "drehzahl")
_SAME = 0.005  # of the speed: two channels that differ by less tell of one shaft


def turns_per_minute(values: npt.ArrayLike, unit: str, *, subject: str = "speed") -> FloatArray:
    """Values of a channel that is said to be a speed of rotation [rpm].

    A unit that names an angle (rad/s, °/s, rpm) is converted; one that only counts in time (Hz,
    1/s, min^-1) counts turns, for a shaft that goes round 30 times a second is written as 30 Hz.

    Raises BadInput for a unit that is neither.

    >>> [round(float(turns_per_minute(30.0, unit)), 1) for unit in ("Hz", "min^-1", "rpm", "°/s")]
    [1800.0, 30.0, 30.0, 5.0]
    """
    if not is_turning(unit):
        raise BadInput(
            f"{subject}: {unit!r} is no unit of a speed of rotation; known are rpm, 1/min, Hz, 1/s,"
            " rad/s, °/s"
        )
    if "radian" in parse_unit(unit).base:
        return convert(values, unit, "rpm", what=subject)
    return np.asarray(values, dtype=float) * (60.0 * parse_unit(unit).scale)


def is_turning(unit: str) -> bool:
    """Whether a speed of rotation may be in this unit: an angle, or turns, in time.

    >>> [is_turning(unit) for unit in ("Hz", "rad/s", "min^-1", "%/s", "rad/s**2", "m/s", "")]
    [True, True, True, False, False, False, False]
    """
    parsed = parse_unit(unit)
    return (
        parsed.base in ({"second": -1.0}, {"second": -1.0, "radian": 1.0})
        and "%" not in parsed.symbols
    )


def speed_channel(record: Record) -> str | None:
    """The channel that tells the speed of the shaft: its name says so, and its unit is one of
    rotation; None without one.

    Raises BadInput when several tell different speeds, for then nobody knows which of them is the
    bearing's shaft.
    """
    turning = [name for name in _named_so(record) if is_turning(record.units[name])]
    if "speed" in turning:
        return "speed"
    speeds = {name: speed for name in turning if (speed := _usual(record, name))}
    if len(speeds) > 1 and max(speeds.values()) > (1 + _SAME) * min(speeds.values()):
        listing = ", ".join(f"{name!r} {speed:.4g} rpm" for name, speed in speeds.items())
        raise BadInput(
            f"bearing: record {record.source!r} has several speeds ({listing})",
            way_on=[("map", {"speed": "CHANNEL"}, "of the shaft")],
        )
    return next(iter(speeds), turning[0] if turning else None)


def speed_in_rpm(record: Record, name: str) -> FloatArray:
    """The magnitude of the shaft's speed at every sample [rpm], shape (n,); missing samples stay
    missing.
    """
    return np.abs(turns_per_minute(record[name], record.units[name], subject=f"channel {name!r}"))


def only_speed_channel(record: Record) -> str | None:
    """The speed channel; none of several, which are no reason to refuse a record whose speed was
    said apart.
    """
    try:
        return speed_channel(record)
    except BadInput:
        return None


def usual_speed(record: Record, name: str | None) -> float | None:
    """Median of a speed channel [rpm]; None without a channel, or where it stands still."""
    return None if name is None else _usual(record, name)


def unusable_speeds(record: Record) -> tuple[str, list[Way]]:
    """What is wrong with channels whose name tells of a speed (no unit, or none of rotation), and
    what may be said of them.
    """
    units = {
        name: record.units[name] for name in _named_so(record) if not is_turning(record.units[name])
    }
    reasons = [
        f"channel {name!r} " + (f"is in {unit!r}" if unit else "has no unit")
        for name, unit in units.items()
    ]
    return "; ".join(reasons), [
        ("units", {name: "rpm"}) for name, unit in units.items() if not unit
    ]


def _named_so(record: Record) -> list[str]:
    return [name for name in record.names if any(word in name.lower() for word in _WORDS)]


def _usual(record: Record, name: str) -> float | None:
    speed = speed_in_rpm(record, name)
    known = speed[np.isfinite(speed)]
    return (float(np.median(known)) or None) if known.size else None


# A vibration as if its shaft had turned evenly, where the record's speed channel says that it did
# not.

_STEADY = 0.005  # speed range [-] below which lines are looked for in time, above in angle
# s without a reading: the speed of a shaft does little in between that its two neighbours do not
# tell
_LONGEST_GAP = 1.0


def at_steady_speed(
    x: AnyArray,
    record: Record,
    name: str | None,
    said_rpm: float | None = None,
    *,
    in_hertz: bool = False,
) -> AnyArray:
    """The signal at even steps of shaft angle, as many a turn as it has on average; as it is when
    the speed is steady.

    Parameters
    ----------
    x : array, shape (n,)
        A channel of `record`, worked on.
    record : Record
        Holds the speed channel.
    name : str or None
        Of the speed channel, if there is one.
    said_rpm : float or None
        The speed that was said apart from the record [rpm].
    in_hertz : bool
        Whether the lines that are looked for are in hertz, and so hold for one speed.

    Raises
    ------
    BadInput
        What was said cannot hold for a shaft that changes its speed, or the speed has gaps of more
        than a second.
    """
    if name is None:
        return x
    speed = speed_in_rpm(record, name)
    known = speed[np.isfinite(speed)]
    if not known.size or np.ptp(known) <= _STEADY * float(np.median(known)):
        return x
    middle, change = (
        float(np.median(known)),
        f"channel {name!r} goes from {known.min():.4g} to {known.max():.4g} rpm",
    )
    if in_hertz:
        if np.ptp(known) <= 2 * SLIP * middle:
            return x
        raise BadInput(f"bearing: {change}, but lines in hertz hold for one speed; give orders")
    if said_rpm is not None and abs(said_rpm / middle - 1) > SLIP:
        raise BadInput(
            f"bearing: speed_rpm is {said_rpm:g}, but {change}; leave speed_rpm out, or that"
            " channel"
        )
    turned = angle_from_speed(_bridged(speed, record.sampling_rate), record.sampling_rate)
    return at_even_angle(x, turned, 60 * record.sampling_rate / middle)


def _bridged(speed: AnyArray, rate: float) -> AnyArray:
    """Missing readings on the straight line between their neighbours; those of longer gaps stay
    missing.
    """
    known = np.flatnonzero(np.isfinite(speed))
    lengths = np.diff(np.concatenate([[-1], known, [speed.shape[0]]]))
    if lengths.max() > _LONGEST_GAP * rate + 1:
        return speed
    return np.interp(np.arange(speed.shape[0]), known, speed[known])
