"""Gate actuator: tooth faults of nylon gear, pinion and rack from the motor's own signals, movement
by movement.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np
import numpy.typing as npt
from scipy.signal import lfilter

from residuum.diagnosis.diagnosers.base import Channel, Diagnoser, Example, NotTrained
from residuum.diagnosis.finding import Finding, Verdict
from residuum.diagnosis.gate.actuator_model import ActuatorConstants
from residuum.diagnosis.gate.gate_baseline import (
    GateBaseline,
    Judgement,
    SourceJudgement,
    TrainingMovement,
)
from residuum.diagnosis.gate.movement_features import (
    FEWEST_TURNS,
    MovementFeatures,
    movement_features,
    whole_turns,
)
from residuum.diagnosis.gate.movements import Movement, average_profile, cut_movements, flat_part
from residuum.diagnosis.gate.operating_events import Happened, event_of_profile
from residuum.diagnosis.residuals.fault_isolation import HEALTHY, PINION_OR_GEAR, RACK, UNKNOWN
from residuum.identification.errors import BadInput, NotIdentifiable
from residuum.identification.record import Record
from residuum.nearest_names import known_names

_SPELLINGS = {
    HEALTHY: HEALTHY,
    **dict.fromkeys(
        (PINION_OR_GEAR, "pinion", "gear", "nylon-gear", "pinion-tooth", "gear-notch"),
        PINION_OR_GEAR,
    ),
    **dict.fromkeys((RACK, "rack-tooth"), RACK),
}
_UNITS = {
    "F1": "mm/s",
    "F2": "mm/s",
    "low_peak": "rad/s",
    "low_rms": "rad/s",
    "high_peak": "rad/s",
    "level": "rad/s",
}
_NO_CLASSIFIER = (
    "gate-actuator, method source: its classifier needs movements with faults; train it with"
    " labels, or use the default method"
)
_NOTHING_TRAINED = "gate-actuator: has not been trained; train it on healthy movements first"


class GateActuator(Diagnoser):
    """The model-based scheme of the source (chapter 7), with features in shaft angle beside its F₁
    and F₂.

    Each movement (opening or closing) is cut out by the phase; the model (7.2), (7.4) is adapted to
    it, its output error (7.5) is evaluated at flat voltage. The source's path is the reference and
    is reported beside: band-pass 0.5–10 Hz, envelope, θ(f), F₁ and F₂ at the fault frequency of the
    *measured* speed, linear support vector machine.

    The verdict holds features of the typical shaft turn (gear: a matched filter for a notch;
    pinion) and of single pulses (rack) against limits from healthy movements; whether the turn or
    one place alone passes its limit names the class. A gear that was trained healthy is recognised
    by its tooth errors, and only what is new in its turn is held against a lower limit. Trained on
    labelled faults too, a logistic regression on all features gives probabilities, and `unknown`
    for what fits no class.

    A movement that was cut short, stopped, pushed, or ran through a supply sag is `not-assessable`,
    named in `evidence["event"]`. On exemplars never seen: benchmarks/results/gate_actuator.md.
    Fails when the fault lies where the gate only ramps (its first and last decimetres); a notch
    hides in the tooth errors of a gear that was never seen healthy.

    With `method` "source" the source's path decides: the support vector machine on F₁ and F₂ of the
    residual's envelope. Every finding holds what both say; benchmarks/results/gate_actuator.md has
    the measurement that makes the other one the default.

    Parameters
    ----------
    constants : ActuatorConstants
        Data sheet of the actuator; tooth numbers set the fault frequency.

    References
    ----------
    N. Valceschini, Data-Driven Robust Control and Diagnosis, chapter 7, (7.1)–(7.6).
    """

    name: ClassVar[str] = "gate-actuator"
    channels: ClassVar[Sequence[Channel]] = (
        Channel("speed", "rad/s", "motor speed ω_M"),
        Channel("voltage", "V", "motor voltage V"),
        Channel("current", "A", "motor current i", required=False),
        Channel(
            "phase",
            "",
            "0 pause, 1 opening, 2 closing; without it the sign of the voltage tells",
            required=False,
        ),
    )
    classes: ClassVar[Sequence[str]] = (PINION_OR_GEAR, RACK, UNKNOWN)
    methods: ClassVar[Sequence[str]] = ("default", "source")
    views: ClassVar[Sequence[str]] = ("decision-regions",)

    def __init__(self, *, constants: ActuatorConstants | None = None) -> None:
        self.constants = constants or ActuatorConstants()
        self._baseline: GateBaseline | None = None

    def fit(
        self,
        records: Sequence[Record],
        labels: Sequence[str] | None = None,
        exemplars: Sequence[object] | None = None,
    ) -> Self:
        """Learn from labelled movements.

        Parameters
        ----------
        records : sequence of Record
            One or more movements each; what `score` would not assess is left out.
        labels : sequence of str or None
            One a record: healthy, pinion-or-gear, rack (or the part's name); None: all healthy.
        exemplars : sequence or None
            Which actuator each record comes from, so that alarm limits hold for one never seen;
            None: each record its own.

        Raises
        ------
        BadInput
            Unknown label, unequal lengths, records of different rates.
        NotIdentifiable
            Fewer than three movements of a class.
        """
        names = _labels(records, labels)
        groups = list(range(len(records))) if exemplars is None else list(exemplars)
        if len(groups) != len(records):
            raise BadInput(
                f"gate-actuator: {len(records)} records but {len(groups)} exemplars; must be one"
                " each"
            )
        rate = float(np.median([record.sampling_rate for record in records]))
        training: list[TrainingMovement] = []
        for record, label, group in zip(records, names, groups, strict=True):
            if reason := unusable_record(record, rate):
                raise BadInput(
                    f"gate-actuator: record {record.source!r} cannot be trained on: {reason}"
                )
            for movement in cut_movements(record):
                # the shortest travel is not known before training: 0 judges none
                left_out = self._unusable(movement, 0.0)
                if left_out is None:
                    features = movement_features(movement, self.constants)
                    travel = float(movement.motor_angle[-1])
                    training.append(TrainingMovement(features, label, group, travel))
                elif not training and record is records[-1]:
                    raise NotIdentifiable(
                        "gate-actuator: no movement can be trained on; the last one:"
                        f" {left_out.reason}"
                    )
        self._baseline = GateBaseline.of(training, self.constants, rate)
        return self

    def relearned(self, healthy: Sequence[Record]) -> Self:
        """The same classifier, with limits from these healthy movements, whose gear is known from
        now on.
        """
        fresh = super().relearned(healthy)
        if self._baseline is not None and fresh._baseline is not None:
            fresh._baseline = fresh._baseline.after(self._baseline)
        return fresh

    def score(self, record: Record) -> Finding:
        """Judge every movement in the record; the finding is that of the first faulty one, else of
        the last.
        """
        if self._baseline is None:
            raise NotTrained(_NOTHING_TRAINED)
        # for their refusals: a channel that is absent, or of another quantity
        record.in_unit("speed", "rad/s")
        record.in_unit("voltage", "V")
        if reason := unusable_record(record, self._baseline.rate):
            return Finding.not_assessable(self.name, reason)
        movements = cut_movements(record)
        if not movements:
            return Finding.not_assessable(
                self.name, f"no movement in {record.duration:.4g} s: the phase is 0 throughout"
            )
        scored = [self._score_movement(self._baseline, movement) for movement in movements]
        judged = [move for move in scored if move.judgement is not None]
        if not judged:
            return not_assessed(self.name, scored)
        if self.method == "source" and self._baseline.source is None:
            raise NotTrained(_NO_CLASSIFIER)
        worst = next((move for move in judged if move.said_by(self.method) is not None), judged[-1])
        return self._finding(self._baseline, worst, scored)

    def _unusable(self, movement: Movement, shortest_travel: float) -> ScoredMovement | None:
        driven = np.max(movement.speed) > 0 and np.max(movement.voltage) > 0
        if driven and (happened := event_of_profile(movement, shortest_travel)):
            return ScoredMovement(movement, happened.says, happened)
        reason = unusable_movement(movement, self.constants)
        return ScoredMovement(movement, reason) if reason else None

    def _score_movement(self, baseline: GateBaseline, movement: Movement) -> ScoredMovement:
        if unusable := self._unusable(movement, baseline.shortest_travel):
            return unusable
        try:
            features = movement_features(movement, self.constants)
        except NotIdentifiable as error:
            return ScoredMovement(movement, str(error))
        if happened := baseline.pushed(features):
            return ScoredMovement(movement, happened.says, happened, features)
        return ScoredMovement(
            movement,
            None,
            None,
            features,
            baseline.judge(features),
            baseline.judge_by_source(features),
        )

    def _finding(
        self, baseline: GateBaseline, move: ScoredMovement, scored: Sequence[ScoredMovement]
    ) -> Finding:
        features, judgement = move.features, move.judgement
        if features is None or judgement is None:
            raise NotTrained("gate-actuator: the movement was not judged")
        known = baseline.known(features)
        indicators = baseline.indicators(features, known) | {
            "fault_frequency": features.fault_frequency
        }
        if judgement.isolation is not None:
            indicators["fault_probability"] = judgement.isolation.fault_probability
        fault_class = move.said_by(self.method)
        return Finding(
            self.name,
            Verdict.HEALTHY if fault_class is None else Verdict.FAULTY,
            fault_class,
            indicators,
            baseline.feature_limits(known) if self.method == "default" else {},
            _UNITS | {"fault_frequency": "Hz"},
            evidence_of(baseline, move, scored)
            | {
                "known_gear": known is not None,
                "method": self.method,
            },
            sentence(move) if self.method == "default" else source_sentence(move),
        )

    @property
    def baseline(self) -> GateBaseline:
        """What was learned; NotTrained before `fit`."""
        if self._baseline is None:
            raise NotTrained(_NOTHING_TRAINED)
        return self._baseline

    def save(self, path: str | Path) -> None:
        """Store the trained diagnoser."""
        if self._baseline is None:
            raise NotTrained("gate-actuator: has not been trained; there is nothing to save")
        self._baseline.save(path, self.name, self.method)

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """The diagnoser stored by `save`."""
        baseline, method = GateBaseline.load(path, cls.name)
        loaded = cls(constants=baseline.constants)
        loaded.method = method
        loaded._baseline = baseline
        return loaded

    @classmethod
    def examples(cls) -> Sequence[Example]:
        """Made-up movements: trained with all classes, and on healthy ones alone."""
        healthy, gear, rack = (
            example_records(fault, 8, seed)
            for fault, seed in (("healthy", 0), ("gear", 100), ("rack", 200))
        )
        unseen = example_records("healthy", 2, 50)
        faulty = example_records("gear", 1, 150) + example_records("rack", 1, 250)
        labels = [HEALTHY] * 8 + [PINION_OR_GEAR] * 8 + [RACK] * 8
        return (
            Example([*healthy, *gear, *rack], labels, unseen, faulty),
            Example(healthy, None, unseen, faulty),
        )


def _labels(records: Sequence[Record], labels: Sequence[str] | None) -> list[str]:
    given = [HEALTHY] * len(records) if labels is None else list(labels)
    if not records or len(given) != len(records):
        raise BadInput(
            f"gate-actuator: {len(records)} records and {len(given)} labels; must be one each, at"
            " least one"
        )
    if unknown := [label for label in given if label not in _SPELLINGS]:
        raise BadInput(
            f"gate-actuator: label {unknown[0]!r} is not known;"
            f" {known_names(unknown[0], _SPELLINGS)}"
        )
    return [_SPELLINGS[label] for label in given]


# Can a record of the gate be judged at all? Rate, gaps, dead and clipped sensors, too few turns.

_RATE_TOLERANCE = 0.01
_CLIPPED = 0.1  # of the samples at full voltage stand at the largest value
_SHORTEST = 1.0  # s


def unusable_record(record: Record, rate: float) -> str | None:
    """Why no movement of the record can be judged, in one sentence; None when they can be looked
    at. `rate` in Hz.
    """
    if abs(record.sampling_rate / rate - 1.0) > _RATE_TOLERANCE:
        return f"sampled at {record.sampling_rate:.6g} Hz; trained at {rate:.6g} Hz"
    for name in ("speed", "voltage", "current", "phase"):
        if name not in record.names:
            continue
        if missing := int(np.count_nonzero(record.missing(name))):
            first = int(np.argmax(record.missing(name)))
            return (
                f"gap: {missing} of {record.n} samples of {name} are missing, the first at"
                f" {first * record.sample_time:.4g} s"
            )
        if name != "phase" and record.n > 1 and float(np.ptp(record[name])) == 0.0:
            return (
                f"flat: {name} stands at {float(record[name][0]):.4g} {record.units[name]}"
                " throughout"
            )
    return None


def unusable_movement(movement: Movement, constants: ActuatorConstants) -> str | None:
    """Why one movement cannot be judged, in one sentence; None when it can."""
    if movement.duration < _SHORTEST:
        return (
            f"too short: the movement lasts {movement.duration:.3g} s; at least {_SHORTEST:g} s are"
            " needed"
        )
    if np.max(movement.voltage) <= 0 or np.max(movement.speed) <= 0:
        return "the motor is not driven during the movement"
    flat, level = flat_part(movement)
    if np.ptp(movement.speed[flat]) == 0.0:
        return f"flat: speed stands at {movement.speed[flat][0]:.4g} rad/s at full voltage"
    for name, signal in (("speed", movement.speed), ("current", movement.current)):
        if signal is not None and (share := _share_at_rail(signal[flat])) > _CLIPPED:
            top = float(np.max(signal[flat]))
            return (
                f"clipped: {100 * share:.0f} % of the samples of {name} at full voltage stand at"
                f" its largest value {top:.4g}"
            )
    turns = whole_turns(movement, constants)
    if turns < FEWEST_TURNS:
        return (
            f"too short: {max(turns, 0.0):.1f} turns of the shaft at the full {level:.1f} V; at"
            f" least {FEWEST_TURNS} are needed"
        )
    return None


def _share_at_rail(x: npt.NDArray[np.float64]) -> float:
    return float(np.mean(x >= np.max(x) - 1e-9 * np.ptp(x)))


# One movement with what was said of it, and how a finding shows it.

_SHOWN_SPECTRUM = 10.0  # Hz
_SHOWN_ORDERS = 50


@dataclass(frozen=True)
class ScoredMovement:
    """A reason why a movement cannot be judged, or its features and what both methods say of it."""

    movement: Movement
    reason: str | None = None
    happened: Happened | None = None
    features: MovementFeatures | None = None
    judgement: Judgement | None = None
    source: SourceJudgement | None = None

    def said_by(self, method: str) -> str | None:
        """The fault class by this method; None: healthy, or not judged by it."""
        judgement = self.source if method == "source" else self.judgement
        return None if judgement is None else judgement.fault_class

    def known(self) -> tuple[MovementFeatures, Judgement]:
        """Features and judgement of a movement that was judged."""
        if self.features is None or self.judgement is None:
            raise ValueError("ScoredMovement: was not judged")
        return self.features, self.judgement


def not_assessed(diagnoser: str, scored: Sequence[ScoredMovement]) -> Finding:
    """The finding when no movement can be judged: what happened, or the first reason."""
    first = next((move for move in scored if move.happened), scored[0])
    evidence: dict[str, Any] = {"movements": [_summary(move) for move in scored]}
    if first.happened is not None:
        evidence["event"] = first.happened.event.value
    return Finding.not_assessable(
        diagnoser, f"{first.movement.direction}: {first.reason}", **evidence
    )


def evidence_of(
    baseline: GateBaseline, subject: ScoredMovement, scored: Sequence[ScoredMovement]
) -> dict[str, Any]:
    """What a person can check of the movement that the finding is about, and of all movements in
    the record.
    """
    features, judgement = subject.known()
    shown = features.spectrum.frequency <= _SHOWN_SPECTRUM
    fine = max(1, round(features.spectrum.resolution / (4 * features.spectrum.frequency[1])))
    model = features.model
    evidence: dict[str, Any] = {
        "direction": subject.movement.direction.value,
        "motor_speed": features.motor_speed,
        "turns": features.turns,
        "model": {
            "gain": model.gain,
            "time_constant": model.time_constant,
            "delay": model.delay,
            "load": list(model.load),
        },
        "pulse_position": features.pulse_position,
        "envelope_spectrum": {
            "frequency": features.spectrum.frequency[shown][::fine],
            "modulus": features.spectrum.modulus[shown][::fine],
        },
        "orders": features.pattern.orders()[: _SHOWN_ORDERS + 1],
        "movements": [_summary(move) for move in scored],
        "over_the_way": _over_the_way(scored),
        "healthy_movements_trained": baseline.features.n,
    }
    if judgement.isolation is not None:
        evidence |= {
            "probabilities": dict(judgement.isolation.probabilities),
            "distances": dict(judgement.isolation.distances),
        }
    if judgement.likely_part is not None:
        evidence["likely_part"] = judgement.likely_part
    evidence["default_method"] = {
        "verdict": _verdict(judgement.fault_class),
        "class": judgement.fault_class,
    }
    evidence["source_method"] = _source_says(subject)
    if subject.source is not None:
        evidence |= {
            "source_class": subject.source.fault_class or HEALTHY,
            "source_decision": subject.source.decision,
        }
    return evidence


def _source_says(move: ScoredMovement) -> dict[str, Any]:
    """What the source's classifier says, or why it says nothing."""
    if move.source is None or move.features is None:
        return {
            "verdict": "not-assessable",
            "class": None,
            "reason": "only healthy movements were trained; it needs faults too",
        }
    F1, F2 = (float(value) for value in move.features.source_vector())
    fault_class = move.source.fault_class
    return {
        "verdict": _verdict(fault_class),
        "class": fault_class,
        "F1": F1,
        "F2": F2,
        "decision": move.source.decision,
    }


def _verdict(fault_class: str | None) -> str:
    return "healthy" if fault_class is None else "faulty"


def source_sentence(move: ScoredMovement) -> str:
    """Why the source's method says what it says."""
    features, _ = move.known()
    F1, F2 = features.source_vector()
    fault_class = move.said_by("source") or HEALTHY
    return (
        f"{move.movement.direction} at {features.motor_speed * 30 / np.pi:.0f} rpm: F1 = {F1:.2f}"
        f" mm/s and F2 = {F2:.2f} mm/s of the residual's envelope at {features.fault_frequency:.2f}"
        f" Hz lie on the side of {fault_class!r} (linear SVM)"
    )


def _over_the_way(scored: Sequence[ScoredMovement]) -> dict[str, Any]:
    """The pulse statistic by place of the gate, averaged over all movements that were assessed,
    both ways.
    """
    average = average_profile(
        [move.features.profile for move in scored if move.features is not None]
    )
    return {"place": average.place, "contrast": average.contrast, "statistic": average.statistic}


def _summary(move: ScoredMovement) -> dict[str, Any]:
    fault_class = move.judgement.fault_class or HEALTHY if move.judgement else "not-assessable"
    event = move.happened.event.value if move.happened else None
    return {
        "direction": move.movement.direction.value,
        "start": move.movement.start * move.movement.sample_time,
        "class": fault_class,
        "source_class": None if move.source is None else move.source.fault_class or HEALTHY,
        "event": event,
    }


def sentence(move: ScoredMovement) -> str:
    """Why the default method says what it says."""
    features, judgement = move.known()
    where = (
        f"{move.movement.direction} at {features.motor_speed * 30 / np.pi:.0f} rpm,"
        f" {features.turns} turns of the shaft"
    )
    values = features.values
    if judgement.fault_class == PINION_OR_GEAR:
        return (
            f"{where}: the load changes once a turn ({features.fault_frequency:.2f} Hz) by up to"
            f" {values['low_peak']:.1f} rad/s, F1 = {values['F1']:.2f} mm/s"
        )
    if judgement.fault_class == RACK:
        return (
            f"{where}: one pulse of {values['single_pulse']:.0f} standard deviations at"
            f" {100 * features.pulse_position:.0f} % of the way, not repeated once a turn"
        )
    if judgement.fault_class == UNKNOWN:
        return f"{where}: unlike healthy movements and unlike every fault that was trained"
    pulse = f"largest pulse {values['single_pulse']:.1f} standard deviations"
    return f"{where}: F1 = {values['F1']:.2f} mm/s, {pulse}, as in healthy movements"


# Made-up movements of a gate by formula, for the conformance test to train on. Not a machine: no
# friction, no teeth.

_RATE = 2000.0  # Hz
_LEVEL, _GAIN, _T = 30.0, 14.37, 0.0434  # V, rad/(V·s), s
_GEAR_TEETH = 44
_OPENING, _CLOSING = 1, 2


def example_record(fault: str, seed: int, duration: float = 7.0) -> Record:
    """One movement of `duration` seconds with ramps of 1 s.

    Speed is the first-order response to the voltage less a load; `gear` adds a load pulse once a
    shaft turn, `rack` one in the middle of the way. Tooth errors are a fixed random pattern once a
    turn; noise is white.
    """
    rng = np.random.default_rng(seed)
    t = np.arange(round(duration * _RATE)) / _RATE
    voltage = _LEVEL * np.clip(np.minimum(t, duration - t), 0.0, 1.0) + 0.03 * rng.standard_normal(
        t.shape[0]
    )
    flat = _GAIN * _LEVEL / (2 * np.pi * _GEAR_TEETH)
    turns = flat * (t - 0.5) + rng.uniform()
    load = 20.0 + sum(
        rng.normal(0.0, 0.4) * np.cos(2 * np.pi * (k * turns + rng.uniform())) for k in range(1, 15)
    )
    if fault == "gear":
        load = load + 60.0 * np.exp(-0.5 * ((turns % 1.0 - 0.5) / 0.015) ** 2)
    if fault == "rack":
        load = load + 150.0 * np.exp(-0.5 * ((t - 0.5 * duration) / 0.01) ** 2)
    speed = _low_pass(np.maximum(_GAIN * voltage - load, 0.0)) + rng.normal(0.0, 1.0, t.shape[0])
    closing = seed % 2 == 1
    sign = -1.0 if closing else 1.0
    channels = {
        "speed": sign * speed,
        "voltage": sign * voltage,
        "phase": np.full(t.shape[0], _CLOSING if closing else _OPENING, float),
    }
    return Record(
        channels,
        {"speed": "rad/s", "voltage": "V", "phase": ""},
        1.0 / _RATE,
        source=f"example {fault} {seed}",
    )


def example_records(fault: str, count: int, first_seed: int) -> list[Record]:
    """`count` movements with consecutive seeds."""
    return [example_record(fault, first_seed + k) for k in range(count)]


def _low_pass(u: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    a = float(np.exp(-1.0 / (_RATE * _T)))
    return np.asarray(lfilter([1.0 - a], [1.0, -a], u))
