"""Gate actuator: tooth faults of nylon gear, pinion and rack from the motor's own signals, movement
by movement.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import ClassVar, Self

import numpy as np

from residuum.diagnosis.diagnosers.base import Channel, Diagnoser, Example, NotTrained
from residuum.diagnosis.finding import Finding, Verdict
from residuum.diagnosis.gate.actuator_model import ActuatorConstants
from residuum.diagnosis.gate.gate_baseline import GateBaseline, TrainingMovement
from residuum.diagnosis.gate.movement_features import movement_features
from residuum.diagnosis.gate.movements import Movement, cut_movements
from residuum.diagnosis.gate.operating_events import event_of_profile
from residuum.diagnosis.gate.scored_movement import (
    ScoredMovement,
    evidence_of,
    example_records,
    not_assessed,
    sentence,
    source_sentence,
    unusable_movement,
    unusable_record,
)
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
