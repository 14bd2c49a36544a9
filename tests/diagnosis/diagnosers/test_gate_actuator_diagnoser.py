"""The gate-actuator diagnoser on simulated actuators: detection, isolation, operating events, unusable windows."""

import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from sklearn.utils.estimator_checks import check_estimator

from residuum.diagnosis.diagnosers.base import NotTrained
from residuum.diagnosis.diagnosers.gate_actuator import GateActuator
from residuum.diagnosis.gate.movement_features import movement_features
from residuum.diagnosis.gate.movements import average_profile, cut_movements
from residuum.diagnosis.residuals.fault_isolation import RayDistances
from residuum.identification.errors import BadInput, NotIdentifiable
from residuum.identification.record import Record
from residuum.simulation import MACHINES
from residuum.simulation.gate_actuator import _rail_profile


def life(exemplar, count, seed, faults=None, event=None):
    """Whole movements of a simulated actuator's life, one record each."""
    machine = MACHINES["gate-actuator"](seed=seed, exemplar=exemplar, faults=faults or {})
    if event:
        machine.trigger(event)
    signals = machine.simulate(count * 19.5 + 8.0)
    record = Record(signals.channels, signals.units, signals.sample_time)
    return [record.window(m.start, m.start + m.n) for m in cut_movements(record)[:count]]


@cache
def trained():
    plan = (
        (None, "healthy", 5),
        ("gear-notch", "gear-notch", 2),
        ("pinion-tooth", "pinion", 2),
        ("rack-tooth", "rack", 2),
    )
    records, labels, exemplars = [], [], []
    for exemplar in range(4):
        for fault, label, count in plan:
            new = life(exemplar, count, 10 + exemplar, {fault: None} if fault else None)
            records += new
            labels += [label] * len(new)
            exemplars += [exemplar] * len(new)
    return GateActuator().fit(records, labels, exemplars)


@cache
def healthy_movement():
    return life(1, 1, 500)[0]


def test_movements_of_trained_exemplars_not_seen_before_are_judged_right():
    assert [trained().score(record).fault_class for record in life(1, 4, 501)] == [None] * 4
    for fault, expected in (
        ("gear-notch", "pinion-or-gear"),
        ("pinion-tooth", "pinion-or-gear"),
        ("rack-tooth", "rack"),
    ):
        finding = trained().score(life(2, 1, 502, {fault: None})[0])
        assert (finding.verdict, finding.fault_class) == ("faulty", expected), fault


@pytest.mark.parametrize("fault", ["pinion-tooth", "rack-tooth"])
def test_missing_teeth_of_an_unseen_exemplar_are_named(fault):
    finding = trained().score(life(7, 1, 503, {fault: None})[0])
    assert finding.fault_class == {"pinion-tooth": "pinion-or-gear", "rack-tooth": "rack"}[fault]


def test_a_small_notch_is_seen_in_a_gear_whose_healthy_teeth_are_known():
    known, stranger = (
        trained().score(life(2, 1, 510, {"gear-notch": 0.5})[0]),
        life(7, 1, 510, {"gear-notch": 0.5})[0],
    )
    assert (known.fault_class, known.evidence["known_gear"]) == ("pinion-or-gear", True)
    assert trained().score(stranger).evidence["known_gear"] is False
    commissioned = trained().relearned(life(7, 3, 511))
    assert commissioned.score(life(7, 1, 512)[0]).verdict == "healthy"
    found = commissioned.score(stranger)
    assert (found.verdict, found.evidence["known_gear"]) == ("faulty", True)
    assert found.indicators["notch_match"] > found.thresholds["notch_match"]


def test_known_gears_survive_the_file(tmp_path):
    record = life(2, 1, 510, {"gear-notch": 0.5})[0]
    trained().save(tmp_path / "gate.model")
    again = GateActuator.load(tmp_path / "gate.model")
    assert again.score(record).indicators == trained().score(record).indicators


def test_fault_frequency_follows_the_measured_speed():
    record = healthy_movement()
    finding = trained().score(record)
    flat = np.median(np.abs(record["speed"]))
    assert finding.indicators["fault_frequency"] == pytest.approx(flat / (2 * np.pi * 44), rel=0.01)
    assert finding.units["fault_frequency"] == "Hz"


def test_the_place_of_a_missing_rack_tooth_is_the_same_both_ways():
    opening, closing = life(3, 2, 504, {"rack-tooth": None})
    places = [trained().score(record).evidence["pulse_position"] for record in (opening, closing)]
    # the damaged tooth is 1.2 m from the closed gate of 2.85 m
    assert places == pytest.approx([1.2 / 2.85] * 2, abs=0.03)


def test_a_record_with_open_pause_close_is_judged_whole():
    machine = MACHINES["gate-actuator"](seed=505, exemplar=1, faults={"rack-tooth": None})
    signals = machine.simulate(45.0)
    finding = trained().score(Record(signals.channels, signals.units, signals.sample_time))
    assert finding.fault_class == "rack"
    assert [m["direction"] for m in finding.evidence["movements"]][:2] == ["opening", "closing"]


def test_current_and_phase_may_be_absent():
    bare = healthy_movement().select(["speed", "voltage"])
    assert trained().score(bare).verdict == "healthy"


@pytest.mark.parametrize(
    ("event", "named"),
    [
        ("cut-short", "cut-short"),
        ("obstacle", "obstacle-stop"),
        ("supply-sag", "supply-sag"),
        ("manual-push", "manual-pushing"),
    ],
)
def test_operating_events_are_named_and_never_a_tooth_fault(event, named):
    for exemplar in (0, 6):
        findings = [trained().score(record) for record in life(exemplar, 2, 506, event=event)]
        assert findings[0].verdict == "not-assessable"
        assert findings[0].evidence["event"] == named
        assert findings[1].verdict != "faulty"


def changed(record, name, change):
    return replace(
        record, channels=dict(record.channels) | {name: change(np.array(record[name], dtype=float))}
    )


@pytest.mark.parametrize(
    ("harm", "reason"),
    [
        (lambda r: r.window(0, r.n // 2), "breaks off at full voltage"),
        (
            lambda r: changed(
                r, "speed", lambda x: np.where(np.arange(x.size) == 30000, np.nan, x)
            ),
            "gap: 1 of",
        ),
        (lambda r: replace(r, sample_time=1e-3), "trained at 5000 Hz"),
        (lambda r: changed(r, "speed", lambda x: np.clip(x, -396.0, 396.0)), "clipped"),
        (lambda r: changed(r, "voltage", np.zeros_like), "flat: voltage"),
        (lambda r: changed(r, "phase", np.zeros_like), "flat: phase|no movement"),
    ],
    ids=["cut", "gap", "rate", "clipped", "flat", "no movement"],
)
def test_unusable_windows_say_why(harm, reason):
    finding = trained().score(harm(healthy_movement()))
    assert finding.verdict == "not-assessable"
    assert re.search(reason, finding.reason)


def test_healthy_movements_alone_suffice_to_detect_on_the_same_exemplar():
    judge = GateActuator().fit(life(0, 8, 507))
    assert judge.score(life(0, 1, 508)[0]).verdict == "healthy"
    assert judge.score(life(0, 1, 508, {"pinion-tooth": None})[0]).fault_class == "pinion-or-gear"
    assert judge.score(life(0, 1, 508, {"rack-tooth": None})[0]).fault_class == "rack"


def test_a_disturbance_like_no_trained_fault_is_unknown():
    t = np.arange(healthy_movement().n) / 5000.0
    chirping = changed(
        healthy_movement(),
        "speed",
        lambda x: x + 20.0 * np.sin(2 * np.pi * 90.0 * t) * (np.abs(x) > 100),
    )
    finding = trained().score(chirping)
    assert (finding.verdict, finding.fault_class) == ("faulty", "unknown")


def test_bad_training_is_refused():
    with pytest.raises(BadInput, match="label 'broken' is not known"):
        GateActuator().fit([healthy_movement()], ["broken"])
    with pytest.raises(BadInput, match="1 records and 2 labels"):
        GateActuator().fit([healthy_movement()], ["healthy"] * 2)
    with pytest.raises(NotIdentifiable, match="at least 3"):
        GateActuator().fit([healthy_movement()])
    with pytest.raises(NotTrained, match="train"):
        GateActuator().score(healthy_movement())


def test_ray_distances_follow_the_estimator_rules():
    check_estimator(RayDistances(), on_skip=None)


def test_a_larger_fault_of_a_known_kind_stays_near_its_ray():
    rng = np.random.default_rng(0)
    X = rng.normal(0, 1, (200, 3))
    X[100:] += [6.0, 0.0, 0.0]
    rays = RayDistances(origin="healthy").fit(X, ["healthy"] * 100 + ["worn"] * 100)
    larger, other = rays.transform([[20.0, 0.0, 0.0], [0.0, 20.0, 0.0]])
    assert larger[0] > 15 and larger[1] < 3
    assert other.min() > 15


def test_averaging_over_the_way_finds_the_place_of_a_small_rack_damage():
    records = life(5, 6, 509, {"rack-tooth": 0.2})
    features = [
        movement_features(cut_movements(record)[0], trained().constants) for record in records
    ]
    average = average_profile([one.profile for one in features])
    assert average.place == pytest.approx(1.2 / 2.85, abs=0.02)
    assert average.contrast > np.median([one.profile.contrast for one in features])


def longer_gate(travel, faults=None, event=None):
    """One opening of a gate of exemplar 7 with a longer way and a rail as uneven all along."""
    machine = MACHINES["gate-actuator"](seed=520, exemplar=7, faults=faults or {})
    machine.actuator = machine.actuator._replace(travel=travel)
    machine._rail = _rail_profile(np.random.default_rng(520), travel)
    if event:
        machine.trigger(event)
    signals = machine.simulate(travel / 0.26 + 8.0)
    record = Record(signals.channels, signals.units, signals.sample_time)
    movement = cut_movements(record)[0]
    return record.window(movement.start, movement.start + movement.n)


def test_a_gate_three_times_as_long_as_those_trained_is_judged_like_them():
    """Its load is no parabola of the way; one was called pushed."""
    assert trained().score(longer_gate(7.9)).verdict == "healthy"
    assert trained().score(longer_gate(7.9, {"rack-tooth": None})).fault_class == "rack"
    assert trained().score(longer_gate(7.9, {"pinion-tooth": None})).fault_class == "pinion-or-gear"
    assert (
        trained().score(longer_gate(7.9, event="manual-push")).evidence["event"] == "manual-pushing"
    )
