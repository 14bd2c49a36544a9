"""Indicators of a stretch of vibration: RMS, kurtosis, crest factor, impulsiveness."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from types import MappingProxyType
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import fft
from scipy.fft import irfft, next_fast_len, rfft
from scipy.linalg import solve_toeplitz
from scipy.signal import lfilter

from residuum.array_types import AnyArray
from residuum.diagnosis.finding import Finding, Verdict
from residuum.identification.errors import BadInput
from residuum.identification.record import Record
from residuum.kept_loops import njit
from residuum.nearest_names import known_names

# Vibration severity in zones A–D: broadband velocity RMS from acceleration, against the limits of
# a machine class.

# Upper limits of zones A, B, C [mm/s RMS]. Classes I–IV: small, medium, large on rigid, large on
# soft foundations; groups 1 and 2: large and medium industrial machines.
LIMITS = MappingProxyType(
    {
        "I": (0.71, 1.8, 4.5),
        "II": (1.12, 2.8, 7.1),
        "III": (1.8, 4.5, 11.2),
        "IV": (2.8, 7.1, 18.0),
        "group-1-rigid": (2.3, 4.5, 7.1),
        "group-1-flexible": (3.5, 7.1, 11.0),
        "group-2-rigid": (1.4, 2.8, 4.5),
        "group-2-flexible": (2.3, 4.5, 7.1),
    }
)


@dataclass(frozen=True)
class Severity:
    """Velocity RMS [mm/s], zone (A new, B unrestricted, C limited, D damaging) and the limits of A,
    B, C [mm/s].
    """

    velocity: float
    zone: str
    limits: tuple[float, float, float]


def severity(acceleration: npt.ArrayLike, sampling_rate: float, machine_class: str) -> Severity:
    """Zone of a record of acceleration [m/s²].

    Raises BadInput for an unknown class or a record that cannot hold 10 … 1000 Hz.

    Examples
    --------
    10 mm/s of amplitude at 50 Hz is 7.07 mm/s RMS:

    >>> t = np.arange(10000) / 5000
    >>> found = severity(2 * np.pi * 50 * 0.010 * np.cos(2 * np.pi * 50 * t), 5000, "II")
    >>> round(found.velocity, 2), found.zone
    (7.07, 'C')
    """
    if machine_class not in LIMITS:
        raise BadInput(
            f"severity: machine class {machine_class!r} is not known;"
            f" {known_names(machine_class, LIMITS)}"
        )
    velocity = 1000 * velocity_rms(acceleration, sampling_rate)
    limits = LIMITS[machine_class]
    return Severity(velocity, "ABCD"[int(np.searchsorted(limits, velocity))], limits)


def velocity_rms(
    acceleration: npt.ArrayLike, sampling_rate: float, low: float = 10.0, high: float = 1000.0
) -> float:
    """RMS of velocity [m/s] between low and high [Hz]: each line of the spectrum divided by its 2πf
    (Parseval).

    The Hann window keeps what lies below `low` from leaking in, where 1/f would magnify it.
    """
    a: AnyArray = np.asarray(acceleration, dtype=float)
    if sampling_rate < 2 * high or a.shape[0] < 4 * sampling_rate / low:
        raise BadInput(
            f"severity: {a.shape[0]} samples of {sampling_rate:g} Hz; {low:g} … {high:g} Hz need"
            f" {2 * high:g} Hz, {4 / low:g} s"
        )
    window = np.hanning(a.shape[0])
    padded = fft.next_fast_len(a.shape[0], real=True)
    f = fft.rfftfreq(padded, 1 / sampling_rate)
    inside = (f >= low) & (f <= high)
    power = np.abs(fft.rfft((a - a.mean()) * window, padded)[inside] / (2 * np.pi * f[inside])) ** 2
    return float(np.sqrt(2 * power.sum() / (padded * np.sum(window**2))))


# Short torque pulses in a speed residual: whitening by an autoregressive model and matched
# filters.

Signal = npt.NDArray[np.float64]


def autoregressive_whitener(x: Signal, order: int) -> Signal:
    """Coefficients [1, a₁, …, a_p] of the prediction error filter A(z) of x by Yule–Walker, shape
    (order + 1,).

    A x is then white as far as an order-p model goes. A ridge of 10⁻⁹ of the power keeps a
    noise-free x solvable.
    """
    centred = x - np.mean(x)
    n = centred.shape[0]
    spectrum = rfft(centred, next_fast_len(2 * n, real=True))
    covariance = irfft(np.abs(spectrum) ** 2)[: order + 1] / n
    covariance[0] = covariance[0] * (1.0 + 1e-9) + np.finfo(float).tiny
    return np.concatenate([[1.0], -solve_toeplitz(covariance[:-1], covariance[1:])])


def pulse_templates(widths: Sequence[float], T: float, sample_time: float) -> list[Signal]:
    """Speed of a first-order drive after a load pulse, for each width [s]: one-signed, and a drop
    followed by a catch-up.

    A missing tooth unloads the drive while its place passes (one-signed) and is met again with a
    blow (opposite sign); which of the two rules depends on the backlash, so both shapes are tried.
    """
    a = float(np.exp(-sample_time / T))
    templates = []
    for width in widths:
        samples = max(1, round(width / sample_time))
        tail = round(4 * T / sample_time)
        one_signed = np.concatenate([np.ones(samples), np.zeros(tail)])
        drop_and_blow = np.concatenate([np.ones(samples), -np.ones(samples), np.zeros(tail)])
        templates += [
            np.asarray(lfilter([1.0 - a], [1.0, -a], load)) for load in (one_signed, drop_and_blow)
        ]
    return templates


def matched_filter(x: Signal, whitener: Signal, template: Signal) -> tuple[Signal, float]:
    """Amplitude of `template` at every start, in standard deviations, shape (n,), and that
    deviation [unit of x].

    Both are whitened, so that z(t) = ⟨A s(·−t), A x⟩ / (σ ‖A s‖) is standard normal where there is
    no pulse; σ is the robust (median) deviation of A x, which a few pulses do not raise.
    """
    innovation = np.asarray(lfilter(whitener, [1.0], x - np.mean(x)))
    innovation[: whitener.shape[0]] = 0.0
    shape = np.asarray(lfilter(whitener, [1.0], template))
    sigma = 1.4826 * float(np.median(np.abs(innovation))) + np.finfo(float).tiny
    length = next_fast_len(x.shape[0] + shape.shape[0], real=True)
    correlation = irfft(rfft(innovation, length) * np.conj(rfft(shape, length)), length)[
        : x.shape[0]
    ]
    energy = float(np.sqrt(shape @ shape))
    return np.asarray(correlation / (sigma * energy)), sigma / energy


# A recording of hours, judged block by block so that memory does not grow with it.

LONGEST = 1 << 22  # samples judged as one: 5 min at 12.8 kHz
_FEWEST_FAULTY = 2
_FAULTY_SHARE = 0.05  # of the blocks


def blocks_of(record: Record, longest: int = LONGEST) -> Iterator[Record]:
    """The record in the fewest equal windows of at most `longest` samples (views of it, no copy).

    >>> record = Record({"a": np.zeros(25)}, {"a": "g"}, 0.1)
    >>> [block.n for block in blocks_of(record, 10)]
    [8, 8, 9]
    """
    count = -(-record.n // longest)
    edges = [k * record.n // count for k in range(count + 1)]
    return (record.window(start, stop) for start, stop in pairwise(edges))


def score_in_blocks(
    name: str, score: Callable[[Record], Finding], record: Record, longest: int = LONGEST
) -> Finding:
    """One finding of the blocks' own.

    Faulty when at least 2 blocks, and 5 % of them, are (a single block of many may be a false
    alarm; a fault that began during the recording still counts), with the class that most of these
    name. A block that cannot be judged makes the whole not assessable, unless others show a fault:
    a recording with a gap is never healthy. Indicators are medians over the blocks that decide;
    `evidence` says which these are.

    Parameters
    ----------
    name : str
        Of the diagnoser.
    score : callable
        Judges one block.
    longest : int
        Samples of a block.
    """
    findings, seconds = [], []
    for block in blocks_of(record, longest):
        findings.append(score(block))
        seconds.append(float(block.t0 - record.t0))
    faulty = [k for k, finding in enumerate(findings) if finding.verdict is Verdict.FAULTY]
    unusable = [
        k for k, finding in enumerate(findings) if finding.verdict is Verdict.NOT_ASSESSABLE
    ]
    needed = min(len(findings), max(_FEWEST_FAULTY, int(np.ceil(_FAULTY_SHARE * len(findings)))))
    evidence = {"blocks": len(findings), "block_seconds": record.duration / len(findings)}
    if len(faulty) >= needed:
        named = Counter(findings[k].fault_class for k in faulty).most_common(1)[0][0]
        deciding = [findings[k] for k in faulty if findings[k].fault_class == named]
        evidence |= {"faulty_blocks": len(faulty), "first_faulty_block_s": seconds[faulty[0]]}
        says = (
            f"{len(faulty)} of {len(findings)} blocks are faulty, the first at"
            f" {seconds[faulty[0]]:.0f} s: {deciding[0].reason}"
        )
        return _together(name, Verdict.FAULTY, named, deciding, evidence, says)
    if unusable:
        k = unusable[0]
        return Finding.not_assessable(
            name,
            f"block {k + 1} of {len(findings)}, at {seconds[k]:.0f} s: {findings[k].reason}",
            **evidence,
        )
    reason = next(
        (
            f"at {seconds[k]:.0f} s: {finding.reason}"
            for k, finding in enumerate(findings)
            if finding.reason
        ),
        None,
    )
    return _together(
        name, Verdict.HEALTHY, None, findings, evidence | {"faulty_blocks": len(faulty)}, reason
    )


def _together(
    name: str,
    verdict: Verdict,
    named: str | None,
    findings: Sequence[Finding],
    evidence: Mapping[str, Any],
    says: str | None,
) -> Finding:
    def median(key: str, part: str) -> float:
        return float(
            np.median(
                [
                    getattr(finding, part)[key]
                    for finding in findings
                    if key in getattr(finding, part)
                ]
            )
        )

    first = findings[0]
    return Finding(
        name,
        verdict,
        named,
        {key: median(key, "indicators") for key in first.indicators},
        {key: median(key, "thresholds") for key in first.thresholds},
        first.units,
        {**first.evidence, **evidence},
        says,
    )


@dataclass(frozen=True)
class Indicators:
    """Scalars of a signal x of n samples; all but `rms`, `peak` and `mean` are free of unit and
    gain.

    Attributes
    ----------
    rms : √(E x²), in the signal's unit, mean included
    kurtosis : E(x − μ)⁴ / (E(x − μ)²)²
        3 for a Gaussian signal, 3.245 for the envelope of Gaussian noise; NaN when x is constant.
    peak : max |x|
    crest : peak / rms; NaN for silence
    impulsiveness : peak / E|x| (impulse factor); NaN for silence
    mean : μ
    """

    rms: float
    kurtosis: float
    peak: float
    crest: float
    impulsiveness: float
    mean: float


def indicators(x: npt.ArrayLike) -> Indicators:
    """The indicators of a vector of at least one sample, in two passes with double sums (no double
    copy of float32).

    >>> found = indicators([1.0, -1.0, 1.0, -1.0])
    >>> found.rms, found.kurtosis, found.crest
    (1.0, 1.0, 1.0)
    """
    x = np.ascontiguousarray(x)
    if x.dtype != np.float32:
        x = x.astype(np.float64, copy=False)
    mean, square, absolute, peak = _first_pass(x)
    second, fourth = _central_moments(x, mean)
    rms = float(np.sqrt(square))
    # rounding of the mean leaves a second moment in equal samples
    constant = not second > 0 or float(np.ptp(x)) == 0
    kurtosis = np.nan if constant else fourth / second**2
    return Indicators(
        rms, float(kurtosis), float(peak), _ratio(peak, rms), _ratio(peak, absolute), float(mean)
    )


def _ratio(numerator: float, denominator: float) -> float:
    return float(numerator / denominator) if denominator > 0 else float("nan")


@njit(fastmath={"reassoc", "contract"})
def _first_pass(x: AnyArray) -> tuple[float, float, float, float]:
    total, square, absolute, peak = 0.0, 0.0, 0.0, 0.0
    for k in range(x.shape[0]):
        value = float(x[k])
        total += value
        square += value * value
        absolute += abs(value)
        peak = max(peak, abs(value))
    n = x.shape[0]
    return total / n, square / n, absolute / n, peak


@njit(fastmath={"reassoc", "contract"})
def _central_moments(x: AnyArray, mean: float) -> tuple[float, float]:
    second, fourth = 0.0, 0.0
    for k in range(x.shape[0]):
        square = (float(x[k]) - mean) ** 2
        second += square
        fourth += square * square
    return second / x.shape[0], fourth / x.shape[0]
