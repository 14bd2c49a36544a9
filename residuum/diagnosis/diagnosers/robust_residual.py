"""The robust residual of a plant with one input and one output: trained on healthy records, judged
on a sliding window.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np
from scipy import signal

from residuum.array_types import FloatArray
from residuum.diagnosis.diagnosers.base import Channel, Diagnoser, Example, NotTrained
from residuum.diagnosis.finding import Finding, Verdict
from residuum.diagnosis.residuals.fault_isolation import FAULT_KINDS, FaultEstimate, FaultEstimator
from residuum.diagnosis.residuals.generators.residual_generator import (
    ResidualGenerator,
    ResidualSignals,
)
from residuum.diagnosis.residuals.likelihood_ratio import BankOutput
from residuum.diagnosis.residuals.residual_design import ResidualDesign, design_residual
from residuum.diagnosis.thresholds.false_alarm_rate import (
    FEWEST_BLOCKS,
    alarms_per_sample,
    calibrated_threshold,
)
from residuum.diagnosis.thresholds.threshold import ThresholdTest, bounds, source_threshold
from residuum.identification.errors import BadInput, BadRecord
from residuum.identification.kernel_based.delay import estimate_delay
from residuum.identification.kernel_based.impulse_response import identify_impulse_response
from residuum.identification.linear_models.identified_model import IdentifiedModel
from residuum.identification.linear_models.uncertainty import (
    WEIGHT_ORDER,
    design_uncertainty_weight,
)
from residuum.identification.record import Record
from residuum.nearest_names import did_you_mean

FALSE_ALARMS_PER_DAY = 0.1
_SHORTEST_ORDER, _LONGEST_ORDER = 100, 400
_MARGIN = 1.5  # over the largest healthy peak when there are too few to extrapolate from
_FEWEST_JUDGED = 50  # samples beyond the model's memory that a window must have


class RobustResidual(Diagnoser):
    """Kernel identification, AFDP residual, likelihood-ratio test with the model's own uncertainty.

    Algorithms 1, 5 and 6 of the source; the threshold allows for the input that is applied, so the
    false-alarm rate is the chosen number while the healthy residual is what the model says. Where
    healthy records already carry structured error, the threshold is widened to them and every
    finding says so.

    Parameters
    ----------
    input, output : str
        Channel names.
    order : int or None
        Length m of the identified impulse response; None: 100, doubled (to 400 at most, a tenth of
        the record) until the response has died out.
    gamma : float
        γ of (4.7).
    false_alarms_per_day : float
    method : "default" or "source"
        What decides: the likelihood-ratio test on the whitened residual, or |r(t)| after the
        post-filter of Algorithm 6 against the automatic threshold γ max(‖u‖∞, ‖e‖∞) (4.9). Every
        finding holds what both say.
    """

    name: ClassVar[str] = "robust-residual"
    channels: ClassVar[Sequence[Channel]] = (
        Channel("u", "", "input applied to the plant (any unit; kept from training)"),
        Channel("y", "", "measured output (any unit; kept from training)"),
    )
    classes: ClassVar[Sequence[str]] = ("healthy", *FAULT_KINDS, "stuck-sensor", "plant-change")
    methods: ClassVar[Sequence[str]] = ("default", "source")
    views: ClassVar[Sequence[str]] = ("residual",)

    def __init__(
        self,
        *,
        input: str = "u",
        output: str = "y",
        order: int | None = None,
        gamma: float = 0.1,
        false_alarms_per_day: float = FALSE_ALARMS_PER_DAY,
        method: str = "default",
    ) -> None:
        if method not in self.methods:
            asked = did_you_mean(method, self.methods)
            raise BadInput(
                f"robust-residual, method {method[:40]!r}: {asked}must be"
                f" {' or '.join(self.methods)}"
            )
        self.method = method
        self.input, self.output, self.order, self.gamma = input, output, order, gamma
        self.false_alarms_per_day = false_alarms_per_day
        self._design: ResidualDesign | None = None
        self._generator: ResidualGenerator | None = None
        self._threshold = 0.0

    def fit(self, records: Sequence[Record], labels: Sequence[str] | None = None) -> Self:
        """Identify the plant and design the residual on the records labelled `healthy` (all,
        without labels).
        """
        if labels is not None and len(labels) != len(records):
            raise BadInput(
                f"robust-residual: {len(labels)} labels for {len(records)} records; one each is"
                " needed"
            )
        healthy = [r for k, r in enumerate(records) if labels is None or labels[k] == "healthy"]
        if not healthy:
            raise BadInput("robust-residual: no healthy record to train on")
        for record in healthy:
            if np.nanmax(record[self.output]) == np.nanmin(record[self.output]):
                raise BadRecord(
                    f"record {record.source!r}, channel {self.output!r}: does not move; nothing can"
                    " be learnt from it"
                )
        model = self._identify(healthy)
        W_T = design_uncertainty_weight(model, order=WEIGHT_ORDER).weight
        return self._use(design_residual(model, W_T, healthy, gamma=self.gamma))

    def _identify(self, healthy: Sequence[Record]) -> IdentifiedModel:
        n = sum(record.n for record in healthy)
        order = self.order or min(_SHORTEST_ORDER, max(n // 10, 10))
        delay = estimate_delay(
            healthy, self.input, self.output, order=min(order, 50), longest=min(20, n // 50)
        ).delay
        while True:
            model = identify_impulse_response(
                healthy, self.input, self.output, order=order, delay=delay
            )
            if (
                self.order is not None
                or 2 * order > min(_LONGEST_ORDER, n // 10)
                or _has_died_out(model)
            ):
                return model
            order *= 2

    def _use(self, design: ResidualDesign) -> Self:
        self._design, self._generator = design, design.generator
        rate = alarms_per_sample(self.false_alarms_per_day, design.model.sample_time)
        self._threshold = design.bank_threshold(rate)
        if design.has_structured_error:
            self._threshold = max(self._threshold, _widened(design, rate))
        return self

    @property
    def design(self) -> ResidualDesign:
        """The trained design; NotTrained before `fit`."""
        if self._design is None:
            raise NotTrained("robust-residual: has no baseline; train it on healthy records first")
        return self._design

    def stream(self) -> ResidualMonitor:
        """A monitor that takes samples as they come and gives the numbers of `score`'s residual and
        statistic.
        """
        return ResidualMonitor(self.design, self._threshold)

    def score(self, record: Record) -> Finding:
        """Judge one window: at least the model's memory and 50 samples, without a gap."""
        design = self.design
        u, y = self._signals(record)
        if (reason := self._unusable(record, u, y)) is not None:
            return Finding.not_assessable(self.name, reason)
        signals, bank = self.stream().process(u, y)
        tests = {
            "default": ThresholdTest.of("glr", "σ", bank.statistic, bank.alarm, self._threshold),
            "source": _algorithm_6(design, signals, u),
        }
        deciding = tests[self.method]
        verdict, estimate = Verdict.HEALTHY, None
        if deciding.alarm is not None:
            # swapped channels alarm too, and are no fault of the machine
            if (reason := design.swapped(record.source, u, y)) is not None:
                return Finding.not_assessable(self.name, reason)
            verdict, estimate = Verdict.FAULTY, self._estimate(u, y, deciding.alarm)
        evidence = self._evidence(record, signals, deciding.alarm, estimate) | {
            "method": self.method
        }
        evidence |= {f"{name}_method": test.to_json(record.time) for name, test in tests.items()}
        rms = float(np.sqrt(np.mean(signals.primary[signals.valid] ** 2)))
        return Finding(
            self.name,
            verdict,
            estimate.kind if estimate is not None else None,
            {test.indicator: test.largest for test in tests.values()} | {"residual_rms": rms},
            {deciding.indicator: deciding.threshold},
            {test.indicator: test.unit for test in tests.values()}
            | {"residual_rms": design.model.output_unit or "1"},
            evidence,
            self._reason(deciding, evidence, estimate),
        )

    def _signals(self, record: Record) -> tuple[FloatArray, FloatArray]:
        model = self.design.model
        return record.in_unit(self.input, model.input_unit), record.in_unit(
            self.output, model.output_unit
        )

    def _unusable(self, record: Record, u: FloatArray, y: FloatArray) -> str | None:
        """Why a window cannot be judged, or None."""
        needed, Ts = self._judged_from + _FEWEST_JUDGED, self.design.model.sample_time
        if abs(record.sample_time / Ts - 1.0) > 1e-3:
            return f"sampled every {record.sample_time:g} s; the model was trained at {Ts:g} s"
        if record.n < needed:
            return (
                f"{record.n} samples; at least {needed} are needed, {self._judged_from} of them to"
                " fill the model's memory"
            )
        for name, x in ((self.input, u), (self.output, y)):
            if np.isnan(x).any():
                first = int(np.argmax(np.isnan(x)))
                return (
                    f"channel {name!r} has {int(np.isnan(x).sum())} missing samples, the first at"
                    f" {record.time[first]:.6g} s"
                )
        if np.ptp(y) == 0.0 and np.ptp(u) == 0.0:
            return "both channels are flat: nothing moves, so nothing can be compared"
        if (share := _clipped_share(y)) > 0.0:
            return (
                f"channel {self.output!r} is clipped: {100 * share:.1f} % of its samples sit at an"
                " end of its range"
            )
        return None

    @property
    def _judged_from(self) -> int:
        return self._generator.warm_up if self._generator is not None else 0

    def _estimate(self, u: FloatArray, y: FloatArray, alarm: int) -> FaultEstimate | None:
        model, generator = self.design.model, self._generator
        if generator is None:
            return None
        estimator = FaultEstimator(
            generator, model.covariance, model.delay, (model.input_unit, model.output_unit)
        )
        return estimator.estimate(u, y, alarm)

    def _evidence(
        self,
        record: Record,
        signals: ResidualSignals,
        alarm: int | None,
        estimate: FaultEstimate | None,
    ) -> dict[str, Any]:
        evidence: dict[str, Any] = {
            "judged_samples": int(signals.valid.sum()),
            "false_alarms_per_day": self.false_alarms_per_day,
            "model_explains_healthy_data": not self.design.has_structured_error,
        }
        if alarm is not None:
            evidence["first_alarm_time"] = float(record.time[alarm])
        if estimate is not None:
            low, high = estimate.band()
            evidence["fault"] = {
                "kind": estimate.kind,
                "value": estimate.value,
                "std": estimate.std,
                "unit": estimate.unit,
                "band_95": [low, high],
                "onset_time": record.t0 + estimate.onset * record.sample_time,
                "present_from_the_start": estimate.onset <= self._judged_from,
                "indistinguishable_from": list(estimate.indistinguishable_from),
            }
        return evidence

    def _reason(
        self, test: ThresholdTest, evidence: dict[str, Any], estimate: FaultEstimate | None
    ) -> str:
        compared = (
            f"the residual reaches {test.largest:.2f} standard deviations (limit"
            f" {test.threshold:.2f})"
            if self.method == "default"
            else (
                f"the post-filtered residual reaches {test.largest:.3g} {test.unit} (automatic"
                f" threshold {test.threshold:.3g})"
            )
        )
        says = f"{compared}: {_describe(estimate, evidence)}" if estimate is not None else compared
        if not evidence["model_explains_healthy_data"] and self.method == "default":
            says += (
                "; the healthy records already carry structured error, so the limit was widened:"
                " find the missing effect with `residuum explain`, add it with `residuum improve`,"
                " and train `model-based` with the improved model to see smaller faults"
            )
        return says

    def save(self, path: str | Path) -> None:
        """Store the trained diagnoser."""
        settings = {
            "input": self.input,
            "output": self.output,
            "order": self.order,
            "gamma": self.gamma,
        }
        settings |= {"method": self.method}
        self.design.save(
            path,
            kind=self.name,
            settings={**settings, "false_alarms_per_day": self.false_alarms_per_day},
        )

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """The diagnoser stored by `save`."""
        design, settings = ResidualDesign.load_with_settings(path, kind=cls.name)
        try:
            return cls(**settings)._use(design)
        except TypeError as error:
            raise BadInput(f"{path}: is not a robust-residual diagnoser: {error}") from None

    @classmethod
    def examples(cls) -> Sequence[Example]:
        """A first-order plant with white input: an offset and a drift of the sensor, a lost
        actuator gain, a stuck sensor.
        """
        healthy = [_example(seed, n=600) for seed in (2, 3, 4)]
        faulty = [
            _example(5, n=600, offset=3.0),
            _example(6, n=600, drift=0.1),
            _example(7, n=600, gain=0.5),
            _example(8, n=600, stuck=True),
        ]
        return (Example([_example(1, n=4000)], None, healthy, faulty),)


class ResidualMonitor:
    """The diagnoser as a stream: residual and statistic sample by sample, with a state that can be
    saved and resumed.

    A missing sample (NaN) re-initialises the memory; `gaps` counts them, and the next samples are
    not judged until the memory is full again (`valid` says so).
    """

    def __init__(self, design: ResidualDesign, threshold: float) -> None:
        self._residual = design.generator.stream()
        self._bank = design.bank(threshold)

    @property
    def gaps(self) -> int:
        """Times the recursion was re-initialised by missing samples."""
        return self._residual.gaps

    def process(self, u: FloatArray, y: FloatArray) -> tuple[ResidualSignals, BankOutput]:
        """Residuals and statistics of the next block, u and y of shape (n,) in the design's
        units.
        """
        signals = self._residual.process(u, y)
        return signals, self._bank.process(signals)

    @property
    def state(self) -> dict[str, Any]:
        """Everything remembered."""
        return {"residual": self._residual.state, "bank": self._bank.state}

    def resume(self, state: dict[str, Any]) -> None:
        """Continue from a saved `state`; BadInput when it is of another design."""
        self._residual.resume(state["residual"])
        self._bank.resume(state["bank"])


def _algorithm_6(design: ResidualDesign, signals: ResidualSignals, u: FloatArray) -> ThresholdTest:
    """|r(t)| of the post-filtered residual against τ = γ max(‖u‖∞, ‖e‖∞)."""
    threshold = source_threshold(design, *bounds(design, u))
    size = np.where(signals.valid, np.abs(signals.robust), 0.0)
    return ThresholdTest.of(
        "robust_peak",
        design.model.output_unit or "1",
        size,
        size > threshold.level,
        threshold.typical,
    )


def _widened(design: ResidualDesign, rate: float) -> float:
    """Threshold of healthy records that a right model would not give; with too few of them, well
    above their largest peak.
    """
    peaks = design.peaks["glr"]
    if len(peaks) < FEWEST_BLOCKS:
        return _MARGIN * float(np.max(peaks, initial=design.bank_threshold(rate)))
    return calibrated_threshold(peaks, rate, design.model.sample_time).value


def _has_died_out(model: IdentifiedModel) -> bool:
    """Whether the last tenth of the impulse response is within its band, or below a hundredth of
    the largest value.
    """
    last = slice(-max(len(model.impulse_response) // 10, 1), None)
    g = np.abs(model.impulse_response)
    return bool(np.all(g[last] < np.maximum(3 * model.conditional_std[last], 0.01 * g.max())))


def _describe(estimate: FaultEstimate, evidence: dict[str, Any]) -> str:
    when = f"since {evidence['fault']['onset_time']:.6g} s"
    if evidence["fault"]["present_from_the_start"]:
        when = "since before the window began"
    if estimate.kind == "stuck-sensor":
        return f"the sensor has not moved {when}"
    if estimate.kind == "plant-change":
        return f"the plant has changed {when}, no single sensor or actuator fault explains it"
    size = f"{estimate.value:.3g} ± {1.96 * estimate.std:.2g} {estimate.unit}".strip()
    alike = (
        f" (or {', '.join(estimate.indistinguishable_from)})"
        if estimate.indistinguishable_from
        else ""
    )
    return f"{estimate.kind} of {size}{alike} {when}"


def _clipped_share(y: FloatArray) -> float:
    """Share of samples at the window's ends, when they stand there in runs as only a clipped signal
    does; else 0.
    """
    if len(np.unique(y)) < 20:
        return 0.0  # coarse quantisation, or a stuck sensor, which the residual judges
    at_end = (y == y.max()) | (y == y.min())
    in_runs = at_end[1:] & at_end[:-1] & (np.diff(y) == 0.0)
    share = float(at_end.mean())
    return share if share > 0.02 and int(in_runs.sum()) >= 5 else 0.0


def _example(
    seed: int,
    n: int,
    *,
    offset: float = 0.0,
    drift: float = 0.0,
    gain: float = 0.0,
    stuck: bool = False,
) -> Record:
    """y = 0.6 z⁻¹/(1 − 0.8 z⁻¹) u + e at 10 Hz, the fault from the middle on."""
    rng = np.random.default_rng(seed)
    since = np.maximum(np.arange(n) - n // 2, 0) / 10.0
    after = since > 0
    u = rng.standard_normal(n)
    y = signal.lfilter(
        [0.0, 0.6], [1.0, -0.8], np.where(after, 1.0 - gain, 1.0) * u
    ) + 0.3 * rng.standard_normal(n)
    y = y + offset * after + drift * since
    if stuck:
        y = np.where(after, y[n // 2], y)
    return Record({"u": u, "y": y}, {"u": "", "y": ""}, 0.1, source=f"example {seed}")
