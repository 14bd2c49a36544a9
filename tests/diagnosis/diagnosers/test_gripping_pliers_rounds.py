"""Gripping pliers on the virtual machine: Table 6, the place of the fault, and what must not alarm."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from residuum.diagnosis.diagnosers.gripping_pliers import GrippingPliers
from residuum.diagnosis.finding import Verdict
from residuum.identification.errors import BadInput, NotIdentifiable
from residuum.identification.record import Record
from residuum.simulation.gripping_pliers import FRAME
from residuum.simulation.gripping_pliers import GrippingPliers as Machine


def record(signals):
    return Record(signals.channels, signals.units, signals.sample_time, signals.t0)


def run(seconds, seed=1, fault=None, **settings):
    return record(
        Machine(seed=seed, faults={"plier-bearing": fault} if fault else {}, **settings).simulate(
            seconds
        )
    )


@cache
def trained():
    return GrippingPliers().fit([run(60.0)])


def test_faulty_rounds_are_found_at_once_and_the_plier_named():
    findings = [trained().score(run(4.0, seed=seed, fault=1.0)) for seed in range(10, 20)]
    assert {finding.verdict for finding in findings} == {Verdict.FAULTY}
    assert np.mean([finding.evidence["loudest_plier"] == 3 for finding in findings]) >= 0.8
    centres = [finding.evidence["differs_most"]["centre"] for finding in findings]
    assert np.median(np.abs(np.array(centres) - FRAME.frequency)) < 150


@pytest.mark.parametrize("plier", [1, 2, 3, 4])
def test_damage_in_any_plier_is_found_and_named(plier):
    findings = [
        trained().score(run(20.0, seed=seed, fault=1.0, damaged_plier=plier))
        for seed in range(30, 33)
    ]
    assert {finding.verdict for finding in findings} == {Verdict.FAULTY}
    assert [finding.evidence["loudest_plier"] for finding in findings] == [plier] * 3


def test_healthy_rounds_of_other_runs_stay_healthy():
    judged = trained().score(run(120.0, seed=5))
    assert (
        judged.verdict is Verdict.HEALTHY
        and judged.evidence["exceeding_rounds"] == 0
        and judged.evidence["rounds"] >= 58
    )
    assert all(judged.indicators[name] < limit for name, limit in judged.thresholds.items())


def test_table_6_envelope_grows_as_in_the_source():
    """Trained with a faulty test too, the kurtogram chooses the frame's mode; kurtosis and RMS of the envelope rise."""
    faulty = run(40.0, seed=2, fault=1.0)
    diagnoser = GrippingPliers().fit([run(60.0), faulty], ["healthy", "plier-bearing"])
    assert (
        diagnoser.band.low - 70 < FRAME.frequency < diagnoser.band.high + 70
        and diagnoser.band.width <= 800
    )
    healthy = [diagnoser.score(run(40.0, seed=seed)).indicators for seed in (3, 4)]
    judged = diagnoser.score(faulty)
    assert judged.verdict is Verdict.FAULTY
    for name, least in (("kurtosis", 2.0), ("rms", 1.3)):
        assert judged.indicators[name] > least * np.mean(
            [indicators[name] for indicators in healthy]
        )
    compared = diagnoser.compare(faulty)
    medians = np.median(compared.quadrant_rms, axis=0)
    assert medians[2] > medians[3] > 1.1 * medians[:2].max()
    assert compared.exceeding[: compared.place.size // 2].max() < 0.1


def test_without_a_long_pulse_no_plier_is_named_and_quadrants_share_limits():
    diagnoser = GrippingPliers().fit([run(40.0, long_pulse=False)])
    judged = diagnoser.score(run(4.0, seed=7, fault=1.5, long_pulse=False))
    assert judged.verdict is Verdict.FAULTY and judged.evidence["loudest_plier"] is None
    assert judged.thresholds["rms_q1"] == pytest.approx(judged.thresholds["rms_q3"], rel=1e-6)


def test_what_does_not_fit_the_baseline_is_not_assessed():
    slow = trained().score(run(8.0, rounds_per_hour=1400.0))
    assert slow.verdict is Verdict.NOT_ASSESSABLE and "a round takes" in slow.reason
    unmarked = trained().score(run(4.0, long_pulse=False))
    assert unmarked.verdict is Verdict.NOT_ASSESSABLE and "longer pulse" in unmarked.reason
    whole = run(4.0)
    t = np.arange(whole.n) * whole.sample_time
    humming = dict(whole.channels) | {
        "acceleration": whole["acceleration"] + 5 * np.cos(2 * np.pi * 50 * t)
    }
    assert "mains hum" in trained().score(replace(whole, channels=humming)).reason


def test_training_refuses_too_few_rounds_and_unusable_records():
    with pytest.raises(NotIdentifiable, match="at least 10 are needed"):
        GrippingPliers().fit([run(8.0)])
    with pytest.raises(BadInput, match=r"cannot be trained on: .*lost or extra"):
        whole = run(30.0)
        pulses = np.where(np.arange(whole.n) // 6400 == 9, 0.0, whole["indicator"])
        GrippingPliers().fit(
            [replace(whole, channels=dict(whole.channels) | {"indicator": pulses})]
        )
