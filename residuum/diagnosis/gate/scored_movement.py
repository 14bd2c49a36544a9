"""One movement with what was said of it, and how a finding shows it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.signal import lfilter

from residuum.diagnosis.finding import Finding
from residuum.diagnosis.gate.actuator_model import ActuatorConstants
from residuum.diagnosis.gate.gate_baseline import GateBaseline, Judgement, SourceJudgement
from residuum.diagnosis.gate.movement_features import FEWEST_TURNS, MovementFeatures, whole_turns
from residuum.diagnosis.gate.movements import Movement, average_profile, flat_part
from residuum.diagnosis.gate.operating_events import Happened
from residuum.diagnosis.residuals.fault_isolation import HEALTHY, PINION_OR_GEAR, RACK, UNKNOWN
from residuum.identification.record import Record

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
