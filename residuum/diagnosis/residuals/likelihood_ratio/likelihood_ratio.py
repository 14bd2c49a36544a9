"""Generalised likelihood ratio over windows: offset, ramp, gain and power of a whitened residual, model error allowed for."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy import optimize

from residuum.array_types import FloatArray
from residuum.diagnosis.residuals.generators.residual_generator import BoolArray, ResidualSignals
from residuum.diagnosis.residuals.likelihood_ratio.window_scan import (
    HEAD_START,
    SHORT,
    SHORT_START,
    SHORTEST_GAIN,
    SHORTEST_POWER,
    ModelError,
    ScanMemory,
    scan,
    scan_limits,
)
from residuum.diagnosis.thresholds.false_alarm_rate import scan_rate, shiryaev_roberts_rate
from residuum.identification.blas_threads import LARGEST_FOR_ONE_THREAD, one_thread_if_small
from residuum.identification.errors import BadInput

LONGEST_WINDOW = 1024
_SHARE = 0.83  # of the sum of their own rates, what windows, templates and Shiryaev–Roberts alarm together


class BankOutput(NamedTuple):
    """Per sample: the largest standardised statistic, what alarmed (`window_scan`, 0 = nothing) and its window [samples]."""

    statistic: FloatArray
    kind: npt.NDArray[np.int64]
    window: npt.NDArray[np.int64]

    @property
    def alarm(self) -> BoolArray:
        """Samples at which an alarm was given."""
        return np.asarray(self.kind > 0)


def window_lengths(longest: int = LONGEST_WINDOW) -> npt.NDArray[np.int64]:
    """1, 2, 3, 4, 6, 8, 12, … samples: steps of about √2, so that some window is nearly as long as any fault has lasted."""
    powers = 2 ** np.arange(int(np.log2(longest)) + 1)
    lengths = np.union1d(powers, 3 * powers // 2)
    return np.asarray(lengths[lengths <= longest], dtype=np.int64)


@cache
def bank_threshold(rate: float, longest: int = LONGEST_WINDOW) -> float:
    """b of a bank that alarms `rate` times per sample of independent standard normal scores.

    Windows, templates and Shiryaev–Roberts often cross together: of the sum of their own rates the whole bank alarms 0.79 at
    b = 3.9, 0.82 at 4.3, 0.83 at 4.7 and 5.1 (± 0.02, measured over up to 3·10⁷ samples; 5·10⁻³ … 2·10⁻⁵ alarms a sample).
    """
    windows = window_lengths(longest).tolist()
    long = [length for length in windows if length >= SHORTEST_POWER]
    short = [length for length in windows if length <= SHORT]
    scans = [(2, windows[len(short) :]), (2, [length for length in windows if length >= SHORTEST_GAIN]), (1, long), (2, long)]

    def excess(b: float) -> float:
        scanned = sum(sides * scan_rate(b, lengths) for sides, lengths in scans if lengths)
        scanned += 2.0 * scan_rate(float(np.sqrt(max(b * b - 2.0 * SHORT_START, 0.01))), short)
        alone = scanned + shiryaev_roberts_rate(b * b / 2.0 - HEAD_START, 1.0)
        return float(np.log(_SHARE * alone / rate))

    return float(optimize.brentq(excess, 1.0, 30.0)) if excess(1.0) > 0 else 1.0


class LikelihoodRatioBank:
    """Scans normal scores s(t) for a lasting offset, a ramp, a lost gain and a rise of power, over windows of many lengths.

    For a window of ℓ samples and a template p (1 for an offset, 1 … ℓ for a ramp, the whitened prediction for a gain),

        z = Σ s p / √(Σ p² + wᵀ Σ_g w + v (Σ p)²),   w = Σ p(t) φ(t),

    is standard normal while healthy: φ(t) is the whitened input at the model's lags and Σ_g the covariance of the identified
    impulse response, so the second term is exactly what the model's own uncertainty adds for the input that was applied; the
    third is what an operating point adds that was itself estimated, v being 1/n for n Gaussian samples.
    z²/2 is the log likelihood ratio of a fault of unknown size in that window (Willsky and Jones, 1976), the largest over
    the windows that of a fault of unknown onset. The power scan compares Σ s² with χ²_ℓ by the cube-root normal of Wilson
    and Hilferty. Beside the windows run the statistics of Shiryaev and Roberts for an offset of ±1,

        R(t) = (1 + R(t − 1)) exp(±s(t) − ½),

    the likelihood ratio added up over all onsets: of all tests it finds a step of just this size in the shortest time on
    average (Pollak and Tartakovsky, Statistica Sinica 19, 2009). It need not guess size and onset, so it may alarm at A = 2.2
    nats less, and counts as z = √(2 (ln R + A)); ln R, too, is lowered by what the model error may add. Offsets over one or
    two samples have a start of 1.2 nats. An alarm is z > b; after it windows and R start empty again.

    The rate of alarms of healthy, independent scores is set through `bank_threshold`. It fails (too many alarms) when
    scores are not independent: a noise colour that changed, or a model with structured error.

    Parameters
    ----------
    rate : float
        False alarms per sample.
    covariance : array, shape (m, m)
        Σ_g [(output unit / input unit)²].
    delay : int
        Lag of the first coefficient.
    longest : int
        Longest window [samples].
    threshold : float or None
        b, when it comes from elsewhere (calibration); then `rate` is not used.
    level_variance : float
        v: variance of the scores' mean that the operating point's own error makes.
    restart : bool
        Whether the windows start empty after an alarm; False gives the undisturbed statistic.
    """

    def __init__(
        self,
        rate: float,
        covariance: FloatArray,
        delay: int,
        longest: int = LONGEST_WINDOW,
        *,
        threshold: float | None = None,
        level_variance: float = 0.0,
        restart: bool = True,
    ) -> None:
        if longest < 1:
            raise BadInput(f"likelihood-ratio bank, longest: is {longest}; must be at least one sample")
        self.windows = window_lengths(longest)
        self.b = bank_threshold(rate, longest) if threshold is None else float(threshold)
        self.restart = restart
        self.covariance: FloatArray = np.ascontiguousarray(covariance, dtype=float)
        self._limits = scan_limits(self.windows, self.b, _upper_mean_square(self.covariance, self.b))
        self._model = ModelError(covariance_root(self.covariance), float(level_variance), int(delay))
        self._ring = int(self.windows[-1]) + 1
        self._memory = self._ring + len(self.covariance) + delay
        self.reset()

    def reset(self) -> None:
        """Empty all windows and forget the input."""
        self._sums: FloatArray = np.zeros((5, self._ring))  # running Σ s, Σ s p, Σ p², Σ s², Σ τ s
        self._past: FloatArray = np.zeros((2, self._memory))  # p and the whitened input
        self._steps: FloatArray = np.zeros((2, 2))  # up, down: R of Shiryaev and Roberts, and the samples since it was below 1
        self._counts = np.zeros(2, dtype=np.int64)  # samples in the windows, samples in the memory

    def process(self, signals: ResidualSignals) -> BankOutput:
        """Scan the next block; samples that are not valid empty the windows."""
        n = len(signals.scores)
        output = BankOutput(np.zeros(n), np.zeros(n, dtype=np.int64), np.zeros(n, dtype=np.int64))
        inputs = (signals.scores, signals.gain_template, signals.white_input, signals.valid)
        memory = ScanMemory(self._sums, self._past, self._steps, self._counts)
        scan(*inputs, self._limits, self._model, memory, self.restart, *output)
        return output

    @property
    def state(self) -> dict[str, Any]:
        """Everything the scan remembers."""
        return {
            "sums": self._sums.copy(), "past": self._past.copy(), "steps": self._steps.copy(), "counts": self._counts.copy()
        }  # fmt: skip

    def resume(self, state: Mapping[str, Any]) -> None:
        """Continue from a saved `state`; BadInput when it is of another bank."""
        if state.keys() != self.state.keys() or any(np.shape(state[name]) != np.shape(mine) for name, mine in self.state.items()):
            raise BadInput("likelihood-ratio bank: the saved state is of another design; start anew without it")
        self._sums = np.array(state["sums"], dtype=float)
        self._past = np.array(state["past"], dtype=float)
        self._steps = np.array(state["steps"], dtype=float)
        self._counts = np.array(state["counts"], dtype=np.int64)


@one_thread_if_small(LARGEST_FOR_ONE_THREAD)
def covariance_root(covariance: FloatArray) -> FloatArray:
    """Rows of Bᵀ with Σ_g = B Bᵀ, largest first, shape (r, m); what makes up less than 10⁻⁶ of the trace is left out."""
    eigenvalues, vectors = np.linalg.eigh(covariance)
    eigenvalues = np.maximum(eigenvalues[::-1], 0.0)
    left = np.cumsum(eigenvalues[::-1])[::-1]
    kept = left > 1e-6 * left[0] if left.size and left[0] > 0 else np.zeros(len(left), dtype=bool)
    kept[:1] = True
    return np.ascontiguousarray((vectors[:, ::-1][:, kept] * np.sqrt(eigenvalues[kept])).T)


def _upper_mean_square(covariance: FloatArray, b: float) -> float:
    """How far δᵀ A δ may exceed its mean at the b-sigma level, δ being the model error with this covariance."""
    trace, square = float(np.trace(covariance)), float(np.sum(covariance**2))
    if trace <= 0.0:
        return 0.0
    spread = 2.0 * square / (9.0 * trace**2)
    return float((1.0 - spread + b * np.sqrt(spread)) ** 3)
