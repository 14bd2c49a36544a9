"""Nothing is learned anew from windows in which a sensor's fault or a new effect is probable, although each is judged healthy."""

import numpy as np
import pytest

from residuum.diagnosis.diagnosers.model_based import _axis
from residuum.diagnosis.model_based.training import NothingLearned
from residuum.identification.record import Record


@pytest.fixture
def judge(complete_axis):
    return complete_axis


def with_fault(record, name, fault):
    values = fault(np.array(record[name]))
    return Record(
        {**record.channels, name: values},
        record.units,
        record.sample_time,
        t0=record.t0,
        source=record.source,
    )


FAULTS = {
    "offset of the speed's sensor": lambda r: with_fault(r, "velocity", lambda y: y + 1.5e-4),
    "gain of the speed's sensor": lambda r: with_fault(r, "velocity", lambda y: 1.002 * y),
    "larger gain of the speed's sensor": lambda r: with_fault(r, "velocity", lambda y: 1.05 * y),
    "offset of the position's sensor": lambda r: with_fault(r, "velocity", lambda y: y + 2e-3),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_no_window_with_a_sensor_s_fault_is_learned_from(judge, fault):
    windows = [FAULTS[fault](_axis(100 + seed)) for seed in range(12)]
    with pytest.raises(NothingLearned, match="not learned anew"):
        judge.relearned(windows)


def test_a_new_friction_is_not_learned(judge):
    with pytest.raises(NothingLearned):
        judge.refuse_learning([_axis(200 + seed, friction=2.0) for seed in range(12)])


@pytest.mark.parametrize("first", [300, 400])
def test_healthy_windows_are_not_refused(judge, first):
    judge.refuse_learning([_axis(first + seed) for seed in range(12)])


def test_healthy_windows_are_learned_from(judge):
    assert judge.relearned([_axis(600 + seed) for seed in range(8)]).baseline.windows == 8


@pytest.fixture
def rubbing():
    return [_axis(700 + seed, friction=2.0) for seed in range(8)]


def test_a_new_friction_is_not_learned_where_the_user_has_accepted_another_effect(judge, rubbing):
    with pytest.raises(NothingLearned):
        judge.relearned(rubbing, judge.model.with_effect("constant-load", "axis", {"tau_0": 0.0}))


def test_a_new_friction_is_learned_where_the_user_has_accepted_it(judge, rubbing):
    accepted = judge.relearned(
        rubbing, judge.model.with_effect("coulomb-friction", "axis", {"tau_c": 2.0})
    )
    assert accepted.baseline.model.values["coulomb-friction@axis.tau_c"] == pytest.approx(
        2.0, rel=0.05
    )
