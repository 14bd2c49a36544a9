"""One movement with what was said of it, and how a finding shows it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from residuum.diagnosis.finding import Finding
from residuum.diagnosis.gate.gate_baseline import GateBaseline, Judgement, SourceJudgement
from residuum.diagnosis.gate.movement_features import MovementFeatures
from residuum.diagnosis.gate.movements import Movement
from residuum.diagnosis.gate.operating_events import Happened
from residuum.diagnosis.gate.position_domain import average_profile
from residuum.diagnosis.residuals.fault_isolation import HEALTHY, PINION_OR_GEAR, RACK, UNKNOWN

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
        said = self.source if method == "source" else self.judgement
        return None if said is None else said.fault_class

    def known(self) -> tuple[MovementFeatures, Judgement]:
        """Features and judgement of a movement that was judged."""
        if self.features is None or self.judgement is None:
            raise ValueError("ScoredMovement: was not judged")
        return self.features, self.judgement


def not_assessed(diagnoser: str, scored: Sequence[ScoredMovement]) -> Finding:
    """The finding when no movement can be judged: what happened, or the first reason."""
    first = next((one for one in scored if one.happened), scored[0])
    evidence: dict[str, Any] = {"movements": [_summary(one) for one in scored]}
    if first.happened is not None:
        evidence["event"] = first.happened.event.value
    return Finding.not_assessable(diagnoser, f"{first.movement.direction}: {first.reason}", **evidence)


def evidence_of(baseline: GateBaseline, one: ScoredMovement, scored: Sequence[ScoredMovement]) -> dict[str, Any]:
    """What a person can check of the movement that the finding is about, and of all movements in the record."""
    features, judgement = one.known()
    shown = features.spectrum.frequency <= _SHOWN_SPECTRUM
    fine = max(1, round(features.spectrum.resolution / (4 * features.spectrum.frequency[1])))
    model = features.model
    evidence: dict[str, Any] = {
        "direction": one.movement.direction.value,
        "motor_speed": features.motor_speed,
        "turns": features.turns,
        "model": {"gain": model.gain, "time_constant": model.time_constant, "delay": model.delay, "load": list(model.load)},
        "pulse_position": features.pulse_position,
        "envelope_spectrum": {
            "frequency": features.spectrum.frequency[shown][::fine],
            "modulus": features.spectrum.modulus[shown][::fine],
        },
        "orders": features.pattern.orders()[: _SHOWN_ORDERS + 1],
        "movements": [_summary(each) for each in scored],
        "over_the_way": _over_the_way(scored),
        "healthy_movements_trained": baseline.features.n,
    }
    if judgement.isolation is not None:
        evidence |= {"probabilities": dict(judgement.isolation.probabilities), "distances": dict(judgement.isolation.distances)}
    if judgement.likely_part is not None:
        evidence["likely_part"] = judgement.likely_part
    evidence["default_method"] = {"verdict": _verdict(judgement.fault_class), "class": judgement.fault_class}
    evidence["source_method"] = _source_says(one)
    if one.source is not None:
        evidence |= {"source_class": one.source.fault_class or HEALTHY, "source_decision": one.source.decision}
    return evidence


def _source_says(one: ScoredMovement) -> dict[str, Any]:
    """What the source's classifier says, or why it says nothing."""
    if one.source is None or one.features is None:
        return {"verdict": "not-assessable", "class": None, "reason": "only healthy movements were trained; it needs faults too"}
    F1, F2 = (float(value) for value in one.features.source_vector())
    said = one.source.fault_class
    return {"verdict": _verdict(said), "class": said, "F1": F1, "F2": F2, "decision": one.source.decision}


def _verdict(fault_class: str | None) -> str:
    return "healthy" if fault_class is None else "faulty"


def source_sentence(one: ScoredMovement) -> str:
    """Why the source's method says what it says."""
    features, _ = one.known()
    F1, F2 = features.source_vector()
    said = one.said_by("source") or HEALTHY
    return (
        f"{one.movement.direction} at {features.motor_speed * 30 / np.pi:.0f} rpm: F1 = {F1:.2f} mm/s and F2 = {F2:.2f} mm/s of "
        f"the residual's envelope at {features.fault_frequency:.2f} Hz lie on the side of {said!r} (linear SVM)"
    )


def _over_the_way(scored: Sequence[ScoredMovement]) -> dict[str, Any]:
    """The pulse statistic by place of the gate, averaged over all movements that were assessed, both ways."""
    average = average_profile([one.features.profile for one in scored if one.features is not None])
    return {"place": average.place, "contrast": average.contrast, "statistic": average.statistic}


def _summary(one: ScoredMovement) -> dict[str, Any]:
    said = one.judgement.fault_class or HEALTHY if one.judgement else "not-assessable"
    event = one.happened.event.value if one.happened else None
    return {
        "direction": one.movement.direction.value,
        "start": one.movement.start * one.movement.sample_time,
        "class": said,
        "source_class": None if one.source is None else one.source.fault_class or HEALTHY,
        "event": event,
    }


def sentence(one: ScoredMovement) -> str:
    """Why the default method says what it says."""
    features, judgement = one.known()
    where = f"{one.movement.direction} at {features.motor_speed * 30 / np.pi:.0f} rpm, {features.turns} turns of the shaft"
    values = features.values
    if judgement.fault_class == PINION_OR_GEAR:
        return (
            f"{where}: the load changes once a turn ({features.fault_frequency:.2f} Hz) by up to {values['low_peak']:.1f} rad/s, "
            f"F1 = {values['F1']:.2f} mm/s"
        )
    if judgement.fault_class == RACK:
        return (
            f"{where}: one pulse of {values['single_pulse']:.0f} standard deviations at {100 * features.pulse_position:.0f} % of "
            "the way, not repeated once a turn"
        )
    if judgement.fault_class == UNKNOWN:
        return f"{where}: unlike healthy movements and unlike every fault that was trained"
    pulse = f"largest pulse {values['single_pulse']:.1f} standard deviations"
    return f"{where}: F1 = {values['F1']:.2f} mm/s, {pulse}, as in healthy movements"
