"""Is the accelerometer itself sound? A judgement of its own, never a machine fault."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy import fft

from residuum.array_types import AnyArray
from residuum.kept_loops import njit

_LEAST_SPAN = 1e-30  # of values; its square still is a number
_AT_RAIL = 8  # samples: fewer at the extreme value are no sign of clipping
_FLAT_SHARE = 0.05  # of the record in one run of equal values
_DRIFT = 3.0  # travel of the mean, in RMS about it
_ONE_WAY = 0.9  # correlation of the mean with time
_SKI_SLOPE = 0.8  # share of the power below 10 Hz
_SLOW = 10.0
_HUM = 0.6  # share of the power at 50 or 60 Hz and their odd harmonics
_MAINS = (50.0, 60.0)  # Hz
_DROPPED_RUN = 16  # equal samples in a row, all of one value: a link that hands on nothing
_DROPPED_SHARE = 0.02  # of the record
_HELD_SHARE = 0.9  # of the runs of equal samples have one length
_STEPS = 0.9  # RMS, in steps of the converter: noise rounded to its own RMS has 1.04
_SILENCE = 0.01  # of the median block's RMS: 40 dB below
_BLOCK = 0.02  # s
_FEWEST_IN_BLOCK = 32
_OF_SCALE = 1 << 16  # samples that tell a scale well enough
_LOOKED_AT = 1 << 18  # samples in which a line that fills a signal is seen
_SPIKE = 12.0  # robust standard deviations of a sample about the mean of its neighbours
_ALONE = 0.25  # of a spike's height: what may be seen two and three samples beside it
_SPIKES = 1e-3  # of the samples: more are no accident that may be left out
# scatter of the intervals over their mean: so even, spikes are the machine's own or a drive's
_EVEN = 0.1
_QUIET = 0.05  # of the healthy level
_MUFFLED = 0.1
_GRAVITY = 9.80665  # m/s²
_LINE = 0.5  # share of the power in one line
_SAME_GAIN = 0.12  # scatter of ln(gain) over bands: above, something more than a gain changed


def unusable(x: npt.ArrayLike, shortest: int = 128) -> str | None:
    """Why a stretch of acceleration cannot be judged at all, in one sentence; None when it can.

    Too short, a missing sample, silence (all equal), a frozen stretch (one value over 5 % of the
    time), a link that drops out again and again, samples that are only repeated, a converter whose
    step hides the vibration, clipped, or spikes of single samples by the hundred.

    >>> unusable(np.zeros(1000))
    'the accelerometer is dead: all 1000 samples are equal to 0'
    """
    x = np.asarray(x)
    # each question presumes that those before it found nothing, no missing sample above all
    return (
        _holds_no_signal(x, shortest)
        or _frozen(x)
        or _repeated(x)
        or _coarse(x)
        or _clipped(x)
        or _stuck_value(x)
        or _interfered(x)
    )


def _holds_no_signal(x: AnyArray, shortest: int) -> str | None:
    """Too short, with a gap, dead, or of values that no accelerometer gives."""
    n = x.shape[0]
    if n < shortest:
        return f"the window is too short: {n} samples; at least {shortest} are needed"
    if missing := int(np.isnan(x).sum()):
        return f"the window has a gap: {missing} of {n} samples are missing"
    low, high = float(x.min()), float(x.max())
    if low == high:
        return f"the accelerometer is dead: all {n} samples are equal to {low:g}"
    if not _LEAST_SPAN < high - low < 1 / _LEAST_SPAN:
        return f"no accelerometer reads this: all samples lie between {low:g} and {high:g}"
    return None


def _frozen(x: AnyArray) -> str | None:
    run = _longest_run(x)
    if run > max(_FLAT_SHARE * x.shape[0], 64):
        return f"the accelerometer froze: {run} samples in a row are equal"
    return None


def _clipped(x: AnyArray) -> str | None:
    share = clipped_share(x)
    if share > 0:
        low, high = float(x.min()), float(x.max())
        return (
            f"the signal is clipped: {100 * share:.2g} % of the samples stand at the range's end"
            f" {low:g} … {high:g}"
        )
    return None


def _interfered(x: AnyArray) -> str | None:
    """More spikes of single samples than may be left out as an accident."""
    spikes = spike_places(x).size
    if spikes > _SPIKES * x.shape[0]:
        return (
            f"{spikes} single samples stand far beside their neighbours: a loose contact or"
            " interference, no vibration"
        )
    return None


def suspect(x: npt.ArrayLike, sampling_rate: float, shaft: float | None = None) -> str | None:
    """What points to the sensor, its mounting or its cable rather than the machine; None when
    nothing does.

    * drift: the mean moves one way by more than 3 RMS of what lies about it (warming sensor,
      unsettled charge amplifier);
    * silence: stretches 40 dB below the usual level (a dropped line; or the machine stood, and the
      rest is too short a story);
    * loose or overloaded ("ski slope"): more than 80 % of the power below 10 Hz;
    * mains hum: more than 60 % of the power in the lines at 50 or 60 Hz and their odd harmonics (a
      motor hums at the even ones; when the shaft itself turns within 4 % of the mains frequency
      this is not judged).

    >>> t = np.arange(12000) / 12000
    >>> noise = np.random.default_rng(0).standard_normal(12000)
    >>> suspect(noise + 3 * np.cos(2 * np.pi * 50 * t), 12000)
    'mains hum: 82 % of the power lies at 50 Hz and its odd harmonics'
    """
    signal: AnyArray = np.asarray(x, dtype=float)
    return (
        _drift(signal)
        or _silent(signal, sampling_rate)
        or _too_slow(sampling_rate)
        or _power_elsewhere(signal, sampling_rate, shaft)
    )


def _drift(signal: AnyArray) -> str | None:
    blocks = np.array([block.mean() for block in np.array_split(signal, 16)])
    about = signal - np.repeat(blocks, [block.shape[0] for block in np.array_split(signal, 16)])
    one_way = np.ptp(blocks) > 0 and abs(np.corrcoef(blocks, np.arange(16))[0, 1]) > _ONE_WAY
    if one_way and np.ptp(blocks) > _DRIFT * about.std():
        return (
            f"the sensor drifts: its mean moves by {np.ptp(blocks):.3g} within the window, against"
            f" {about.std():.3g} of vibration"
        )
    return None


def _silent(signal: AnyArray, sampling_rate: float) -> str | None:
    """Stretches in which next to nothing is heard, beside others that are loud."""
    length = max(_FEWEST_IN_BLOCK, round(_BLOCK * sampling_rate))
    count = signal.shape[0] // length
    if count < 4:
        return None
    rms = signal[: count * length].reshape(count, length).std(axis=1)
    silent = int((rms < _SILENCE * max(float(np.median(rms)), float(np.quantile(rms, 0.75)))).sum())
    if not silent:
        return None
    seconds, whole = silent * length / sampling_rate, signal.shape[0] / sampling_rate
    below = "40 dB below the rest: its line drops out, or the machine stood"
    return f"the sensor is silent for {seconds:.3g} s of {whole:.3g} s, {below}"


def _too_slow(sampling_rate: float) -> str | None:
    """A record of so few samples a second that all it can hold lies below 10 Hz."""
    if sampling_rate * _SKI_SLOPE > 2 * _SLOW:
        return None
    return (
        f"{sampling_rate:.6g} samples a second hold no vibration above {sampling_rate / 2:.6g} Hz;"
        f" if the rate was meant in kHz, say {1000 * sampling_rate:.6g} Hz"
    )


def _power_elsewhere(signal: AnyArray, sampling_rate: float, shaft: float | None) -> str | None:
    """Most of the power below 10 Hz, or in the lines of the mains."""
    n = signal.shape[0]
    power = np.abs(fft.rfft((signal - signal.mean()) * np.hanning(n))) ** 2
    total, df = float(power.sum()), sampling_rate / n
    # of windows under 0.2 s the first lines reach 10 Hz by their own width
    if df < 5.0 and power[: int(_SLOW / df) + 1].sum() > _SKI_SLOPE * total:
        return "the sensor is loose or overloaded: over 80 % of the power lies below 10 Hz"
    for mains in _MAINS:
        turns_at_mains = shaft and abs(shaft / mains - 1) < 0.04
        if df > mains / 10 or turns_at_mains:
            continue
        share = _power_of_hum(power, df, mains, sampling_rate / 2) / total
        if share > _HUM:
            return (
                f"mains hum: {100 * share:.0f} % of the power lies at {mains:.0f} Hz and its odd"
                " harmonics"
            )
    return None


def _power_of_hum(power: AnyArray, df: float, mains: float, nyquist: float) -> float:
    """Power in the mains' odd harmonics, each two lines wide either side: a Hann window spreads a
    line so far.
    """
    lines = [round(k * mains / df) for k in (1, 3, 5, 7) if k * mains < nyquist]
    return sum(float(power[max(0, line - 2) : line + 3].sum()) for line in lines)


def changed_gain(healthy: npt.ArrayLike, current: npt.ArrayLike) -> float | None:
    """The factor by which a sensor's sensitivity changed, when all bands changed by it and nothing
    else did; else None.

    `healthy` and `current` are RMS values of the same bands, shape (bands,), at least four. No
    machine fault raises every band by one factor. Below a factor of 1.4 nothing is said.

    >>> changed_gain([1, 2, 3, 4], [10, 20, 30, 40])
    10.0
    >>> changed_gain([1, 2, 3, 4], [1, 2, 3, 40])
    """
    ratio = np.asarray(current, dtype=float) / np.asarray(healthy, dtype=float)
    if not (ratio > 0).all():
        return None
    logs = np.log(ratio)
    middle = float(np.median(logs))
    if (
        logs.shape[0] < 4
        or abs(middle) < np.log(1.4)
        or float(np.abs(logs - middle).max()) > 2 * _SAME_GAIN
    ):
        return None
    return float(round(np.exp(middle), 3))


def hears_otherwise(
    healthy: npt.ArrayLike, current: npt.ArrayLike, edges: npt.ArrayLike | None = None
) -> str | None:
    """Why a sensor does not hear what it heard at training: by `changed_gain` or `not_heard`; None
    where it does.
    """
    if gain := changed_gain(healthy, current):
        return f"every band is {gain:g} times the baseline's: another sensitivity, not a fault"
    return not_heard(healthy, current, edges)


def not_heard(
    healthy: npt.ArrayLike, current: npt.ArrayLike, edges: npt.ArrayLike | None = None
) -> str | None:
    """Why a sensor that measures less than it did may not call a machine healthy; None when it
    hears as it did.

    All bands below a twentieth of their healthy level: the machine stands, or nothing reaches the
    sensor. The upper ones, two at least, below a tenth and the lower ones not: a loose or padded
    mounting, or a filter, keeps away what damage makes ring.

    Parameters
    ----------
    healthy, current : arrays, shape (bands,)
        RMS values of the same bands.
    edges : array, shape (bands + 1,), or None
        Of the bands [Hz], where each begins as the last one ends; None: only whether nothing at all
        is heard.

    Examples
    --------
    >>> why = not_heard([1, 1, 1, 1], [1, 1, 0.01, 0.01], [10, 100, 500, 1000, 2000])
    >>> why.partition(":")[0]
    'above 500 Hz less than a tenth of the healthy level is heard'
    """
    ratio = np.asarray(current, dtype=float) / np.asarray(healthy, dtype=float)
    if (ratio < _QUIET).all():
        most = f"at most {100 * ratio.max():.2g} %"
        return (
            f"every band is below a twentieth of its healthy level ({most}): the machine stands, or"
            " the sensor is dead"
        )
    if edges is None:
        return None
    lost = ratio < _MUFFLED
    first = int(np.flatnonzero(~lost)[-1]) + 1
    if ratio.shape[0] - first < 2:
        return None
    edge = float(np.asarray(edges, dtype=float)[first])
    return (
        f"above {edge:.0f} Hz less than a tenth of the healthy level is heard: the mounting is"
        " loose, or a filter keeps it away"
    )


def without_spikes(x: npt.ArrayLike) -> tuple[AnyArray, int]:
    """The signal with each spike of a single sample replaced by the mean of its neighbours, and how
    many there were.

    What strikes a machine rings on for several samples, since a sensor and its filter pass less
    than half the sampling rate; a sample that leaps alone comes from the line. Spikes at even
    intervals stay: a fault's impacts are even too.

    Parameters
    ----------
    x : array, shape (n,), no missing samples
        float32 stays float32; not copied when there is no spike.

    Examples
    --------
    >>> x = np.random.default_rng(0).standard_normal(12000)
    >>> x[[2000, 6000, 6500]] += 50.0
    >>> clean, spikes = without_spikes(x)
    >>> spikes, bool(np.abs(clean).max() < 6.0)
    (3, True)
    """
    x = np.asarray(x)
    places = spike_places(x)
    if not places.size:
        return x, 0
    clean = np.array(x)
    clean[places] = (x[places - 1] + x[places + 1]) / 2
    return clean, int(places.size)


def spike_places(x: AnyArray) -> npt.NDArray[np.intp]:
    """Where single samples leap far from both neighbours, without any ringing beside them; none
    where they come evenly.
    """
    if x.shape[0] < _FEWEST_IN_BLOCK:
        return np.empty(0, dtype=np.intp)
    leap = x[1:-1] - (x[:-2] + x[2:]) / 2  # of sample k + 1
    sample = np.abs(leap[:: max(1, leap.shape[0] // _OF_SCALE)])
    # of the louder half, where the other one is silent
    sigma = float(np.quantile(sample, 0.75)) / 1.1503
    places = np.flatnonzero(np.abs(leap) > max(_SPIKE * sigma, float(np.finfo(leap.dtype).tiny)))
    places = places[(places >= 3) & (places < leap.shape[0] - 3)]
    height = np.abs(leap[places])
    beside = np.max([np.abs(leap[places + k]) for k in (-3, -2, 2, 3)], axis=0, initial=0.0)
    answering = np.max(
        [np.abs(leap[places + k] + leap[places] / 2) for k in (-1, 1)], axis=0, initial=0.0
    )
    alone = places[np.maximum(beside, answering) < _ALONE * height] + 1
    intervals = np.diff(alone)
    even = alone.size > 3 and float(intervals.std()) < _EVEN * float(intervals.mean())
    return np.empty(0, dtype=np.intp) if even else alone


def remarks(x: npt.ArrayLike, sampling_rate: float, unit: str, spikes: int = 0) -> list[str]:
    """What a reader of any verdict has to know of the signal, a sentence each; often none.

    * spikes that `without_spikes` left out;
    * an offset that gravity does not explain, five RMS or more (the sensor's bias or its zero);
    * one line that holds over half of the power: what beats with it looks like a fault's
      modulation.

    Parameters
    ----------
    x : array, shape (n,), no missing samples
    sampling_rate : float [Hz]
    unit : str
        `m/s²`, or "" where nothing is known of the signal's size.
    spikes : int
        How many were left out of it.
    """
    signal: AnyArray = np.asarray(x, dtype=float)
    mean, notes = float(signal.mean()), []
    if spikes:
        notes.append(
            f"spikes of single samples were left out, {spikes} of {signal.shape[0]}: a loose"
            " contact or interference"
        )
    if unit == "m/s²" and abs(mean) > max(1.5 * _GRAVITY, 5 * float(signal.std())):
        notes.append(
            f"the mean lies at {mean:.3g} m/s², which gravity does not explain: the sensor's bias"
            " or its zero is off"
        )
    frequency, share = strongest_line(signal[:_LOOKED_AT], sampling_rate)
    if share > _LINE:
        notes.append(f"one line, at {frequency:.4g} Hz, holds {100 * share:.0f} % of the power")
    return notes


def strongest_line(
    x: AnyArray, sampling_rate: float, low: float = 0.0, high: float = np.inf
) -> tuple[float, float]:
    """The strongest line between two frequencies: where it stands [Hz], and its share of the power
    between them.
    """
    n = fft.prev_fast_len(x.shape[0], real=True)
    power = np.abs(fft.rfft((x[:n] - x[:n].mean()) * np.hanning(n))) ** 2
    first, last = (
        int(np.ceil(low * n / sampling_rate)),
        int(min(high * n / sampling_rate, n // 2)) + 1,
    )
    inside = power[max(first, 1) : last]
    if not inside.size or not inside.sum() > 0:
        return low, 0.0
    peak = int(inside.argmax())
    share = float(inside[max(0, peak - 2) : peak + 3].sum() / inside.sum())
    return (max(first, 1) + peak) * sampling_rate / n, share


def clipped_share(x: AnyArray) -> float:
    """Share of the samples at a rail; 0 unless the extreme value holds more samples than the 5 % of
    range below it.

    The tail of a free signal thins out towards its extreme value; that of a clipped one piles up
    there.
    """
    return (_piled_up(x) + _piled_up(-x)) / x.shape[0]


def _piled_up(x: AnyArray) -> int:
    """Samples at the upper rail, when they outnumber those of the next 5 % of range (or the next
    step of a coarse converter).
    """
    high, span = float(x.max()), float(np.ptp(x))
    near = x[x >= high - 0.25 * span]
    at_rail = int((near >= high - 1e-6 * span).sum())
    if at_rail < _AT_RAIL:
        return 0
    below = near[near < high - 1e-6 * span]
    width = max(0.05 * span, high - float(below.max())) if below.size else span
    return at_rail if at_rail > int((below >= high - width * (1 + 1e-9)).sum()) else 0


def _repeated(x: AnyArray) -> str | None:
    """A link that drops out, or a sensor that is asked more often than it answers."""
    if np.count_nonzero(x[1:] == x[:-1]) <= (1 - 1 / _DROPPED_RUN) * _DROPPED_SHARE * x.shape[0]:
        return None  # too few for either, as of nearly every signal
    starts = np.flatnonzero(np.append(True, x[1:] != x[:-1]))
    lengths = np.diff(np.append(starts, x.shape[0]))
    long = lengths >= _DROPPED_RUN
    dropped = int(lengths[long].sum())
    if (
        dropped > _DROPPED_SHARE * x.shape[0]
        and np.unique(x[starts[long]]).size == 1
        and float(np.median(lengths)) < 2
    ):
        share, value = 100 * dropped / x.shape[0], float(x[starts[long]][0]) + 0.0
        return (
            f"the accelerometer drops out: {int(long.sum())} stretches, {share:.2g} % of the"
            f" samples, stand at {value:g}"
        )
    usual = int(np.median(lengths))
    if usual > 1 and (lengths == usual).mean() > _HELD_SHARE:
        return (
            f"each value stands for {usual} samples: the sensor is read {usual} times as often as"
            " it answers; give the record at its own rate"
        )
    return None


def _stuck_value(x: AnyArray) -> str | None:
    """One value again and again among values that hardly ever repeat: what a bad line hands on in
    place of a sample.
    """
    values, counts = np.unique(x[:4096], return_counts=True)
    most = int(counts.argmax())
    second_most = np.delete(counts, most).max(initial=0)
    if counts[most] > _FLAT_SHARE * counts.sum() and counts[most] > 10 * second_most:
        share = 100 * counts[most] / counts.sum()
        return (
            f"{share:.2g} % of the samples are {values[most] + 0.0:g}, a value of the line and not"
            " of the sensor"
        )
    return None


def _coarse(x: AnyArray) -> str | None:
    """A converter whose step is larger than the vibration's RMS."""
    values = np.unique(x[:4096])
    if values.size < 2 or values.size > 64:
        return None
    step = float(np.diff(values).min())
    if float(x.std(dtype=np.float64)) > _STEPS * step:
        return None
    return (
        f"the vibration is smaller than a step of its converter, {step:.3g}: its RMS is"
        f" {x.std(dtype=np.float64):.3g}"
    )


@njit()
def _longest_run(x: AnyArray) -> int:
    longest, run = 1, 1
    for k in range(1, x.shape[0]):
        run = run + 1 if x[k] == x[k - 1] else 1
        longest = max(longest, run)
    return longest
