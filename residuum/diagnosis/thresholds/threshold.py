"""The thresholds of the robust residual, each with what it guarantees."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
from scipy import stats

from residuum.array_types import FloatArray
from residuum.diagnosis.residuals.residual_design import ResidualDesign
from residuum.diagnosis.residuals.residual_evaluation import CUSUM_REFERENCE, RMS_WINDOW
from residuum.diagnosis.thresholds.false_alarm_rate import (
    calibrated_threshold,
    cusum_threshold,
    scan_threshold,
)
from residuum.identification.errors import BadInput

# A statistic held against a threshold over one window, as a finding shows it.


@dataclass(frozen=True)
class ThresholdTest:
    """Name and unit of the indicator, its largest value, the threshold, and the sample of the first
    alarm (None: none).
    """

    indicator: str
    unit: str
    largest: float
    threshold: float
    alarm: int | None

    @classmethod
    def of(
        cls,
        indicator: str,
        unit: str,
        statistic: FloatArray,
        alarm: npt.NDArray[np.bool_],
        threshold: float,
    ) -> ThresholdTest:
        """Of a statistic sample by sample, shape (n,)."""
        first = int(np.argmax(alarm)) if alarm.any() else None
        return cls(indicator, unit, float(statistic.max()), threshold, first)

    def to_json(self, time: FloatArray) -> Mapping[str, Any]:
        """What the test alone says: verdict, numbers, time of the first alarm [s]."""
        return {
            "verdict": "healthy" if self.alarm is None else "faulty",
            "indicator": self.indicator,
            "value": self.largest,
            "threshold": self.threshold,
            "unit": self.unit,
            "first_alarm_time": None if self.alarm is None else float(time[self.alarm]),
        }


ThresholdKind = Literal["posterior", "peak", "source", "calibrated"]
EvaluationName = Literal["point", "rms", "cusum", "glr"]
DEFAULT_EVALUATION: dict[str, EvaluationName] = {
    "posterior": "glr",
    "calibrated": "glr",
    "source": "point",
    "peak": "point",
}
_TYPICAL_PEAK = 4.0  # noise standard deviations taken for ‖e‖_∞ when no healthy record tells


@dataclass(frozen=True, eq=False)
class Threshold:
    """A threshold for an evaluated residual.

    `level` is a number, or shape (n,) where it follows the input; `false_alarms_per_day` is the
    chosen or predicted rate (0 = never under the stated bounds, None = nothing is known);
    `guarantee` says what holds, in one sentence. `rate_factor` is F: for 95 % of designs learnt
    from as many healthy samples the real rate lies within 1/F … F times that rate (None: not
    known).
    """

    kind: ThresholdKind
    evaluation: EvaluationName
    level: float | FloatArray
    unit: str
    false_alarms_per_day: float | None
    guarantee: str
    rate_factor: float | None = None

    @property
    def typical(self) -> float:
        """The level, or its median over the record."""
        return float(np.median(self.level))


def source_threshold(design: ResidualDesign, input_bound: float, noise_bound: float) -> Threshold:
    """τ = γ max(‖u‖_∞, ‖e‖_∞) for |r(t)|; (4.9) of the source, as printed.

    It is not a bound: γ limits the gain in energy, and a signal of bounded peak can reach the sum
    of the ℓ₁ norms. For white input and noise it lies many standard deviations out; for slow inputs
    against a wrong gain it can be crossed.
    """
    level = design.gamma * max(input_bound, noise_bound)
    # what a right model's Gaussian noise would cross, either way: told, not promised
    per_sample = 2.0 * float(stats.norm.sf(level / design.robust_spread))
    return Threshold(
        "source",
        "point",
        level,
        design.model.output_unit,
        per_sample * 86400.0 / design.model.sample_time,
        "none: it bounds energy, not peaks; the rate is that of Gaussian noise with an exact model",
    )


def peak_threshold(design: ResidualDesign, input_bound: float, noise_bound: float) -> Threshold:
    """τ = ‖Q N W_T‖₁ ū + ‖Q M‖₁ ē for |r(t)|, ‖·‖₁ the sum of the absolute impulse response.

    Never exceeded by a healthy plant y = G₀(u + W_T Δu) + e with |Δu(t)| ≤ ū and |e(t)| ≤ ē at
    every t, however u, Δ and e conspire: Δ may be nonlinear and time-varying with a peak-to-peak
    gain ≤ 1. (A linear Δ of which only ‖Δ‖_∞ ≤ 1 is known may have a larger peak gain.) The price
    is that only large faults exceed it.
    """
    gains = design.peak_gains
    # the last channel of the noise path is e, those before it u
    level = float(gains[-1] * noise_bound + gains[:-1].sum() * input_bound)
    return Threshold(
        "peak",
        "point",
        level,
        design.model.output_unit,
        0.0,
        f"never exceeded while healthy with |u − mean| ≤ {input_bound:.4g} and"
        f" |e| ≤ {noise_bound:.4g}",
    )


def posterior_threshold(
    design: ResidualDesign, u: FloatArray, rate: float, evaluation: EvaluationName
) -> Threshold:
    """The threshold of a chosen false-alarm rate, from the noise model and the posterior of the
    identified model.

    `point`: τ(t) = q √(φ_Qᵀ Σ_g φ_Q + σ_r²), φ_Q the input applied so far through Q: it follows the
    input; noise with bounds or with a tail of its own is convolved with that error
    (`NoiseModel.limit`), and where its rate is below one in all healthy samples the tail is
    extrapolated. `glr`: b of the likelihood-ratio bank, which carries the same variance in its
    statistic, and that of the operating point; it allows for a σ that was estimated. `rms`,
    `cusum`: of the whitened scores, whose variance these two do not enlarge by the model error. The
    rate holds over the joint draw of identification data and noise while the noise keeps the colour
    and tails it had when healthy. Bounds that too few healthy samples reach are not seen, and
    single samples then alarm less often than chosen.
    """
    per_day = rate * 86400.0 / design.model.sample_time
    guarantee = "the chosen rate, while noise and model are as identified"
    if evaluation == "glr":
        b = design.bank_threshold(rate)
        factor = design.noise.rate_factor(b)
        known = (
            f"{guarantee}; within a factor of {factor:.2g} of it for 95 % of designs from as much"
            " healthy data"
        )
        return Threshold("posterior", "glr", b, "σ", per_day, known, factor)
    if evaluation == "cusum":
        return Threshold(
            "posterior", "cusum", cusum_threshold(rate, CUSUM_REFERENCE), "σ", per_day, guarantee
        )
    if evaluation == "rms":
        return Threshold("posterior", "rms", _rms_level(rate), "σ", per_day, guarantee)
    law = design.single_sample_noise
    level = law.innovation_std * law.limit(rate, design.robust_error(u) / law.innovation_std)
    return Threshold("posterior", "point", level, design.model.output_unit, per_day, guarantee)


def calibrated(design: ResidualDesign, rate: float, evaluation: EvaluationName) -> Threshold:
    """The threshold learnt from the healthy records of the design; see
    `false_alarm_rate.calibrated_threshold`.

    Raises
    ------
    BadInput
        The design has no healthy records, or too few.
    """
    if not design.peaks:
        raise BadInput(
            "calibrated threshold: the design has no healthy records",
            way_on=[("healthy", "RECORD", "in its design")],
        )
    learnt = calibrated_threshold(design.peaks[evaluation], rate, design.model.sample_time)
    unit = design.model.output_unit if evaluation == "point" else "σ"
    if learnt.guaranteed:
        guarantee = (
            f"at most twice the chosen rate with 95 % confidence, from {learnt.days:.3g} days of"
            " healthy data"
        )
    else:
        guarantee = (
            f"none: extrapolated from {learnt.days:.3g} days of healthy data;"
            f" {learnt.days_needed:.3g} days give one at this rate"
        )
    per_day = rate * 86400.0 / design.model.sample_time
    return Threshold("calibrated", evaluation, learnt.value, unit, per_day, guarantee)


def bounds(
    design: ResidualDesign, u: FloatArray, noise_bound: float | None = None
) -> tuple[float, float]:
    """ū and ē for the `source` and `peak` thresholds: u is known, so its own largest deviation
    counts too.
    """
    applied = float(np.nanmax(np.abs(u - design.input_mean)))
    known = [bound for bound in (design.input_bound, applied) if np.isfinite(bound)]
    if noise_bound is None:
        noise_bound = design.noise_bound
        if not np.isfinite(noise_bound):
            noise_bound = _TYPICAL_PEAK * design.noise.innovation_std
    return max(known), noise_bound


def _rms_level(rate: float) -> float:
    """Moving RMS that is crossed at `rate`: the cube-root normal of χ², Wilson and Hilferty."""
    spread = 2.0 / (9.0 * RMS_WINDOW)
    b = scan_threshold(rate, [(1, [RMS_WINDOW])])
    return float((1.0 - spread + b * np.sqrt(spread)) ** 1.5)
