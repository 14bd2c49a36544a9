"""When a quantile over drawn plants is known well enough, and that a design draws until it is."""

import numpy as np
import pytest

from benchmarks.promise_in_time import cases
from residuum.identification.linear_models.transfer_function import TransferFunction
from residuum.robust_control.certificates import (
    Measured,
    StepResponse,
    control_response,
    step_response,
)
from residuum.robust_control.control_problem import ControlProblem, Wishes
from residuum.robust_control.synthesis.constrained_structure import PIDN

TS = 1.0


def seen(times, overshoot=0.01):
    return Measured(
        StepResponse(0.0, 1.0, 1.0), tuple(StepResponse(overshoot, float(t), 1.0) for t in times)
    )


def test_a_quantile_is_known_once_its_interval_is_narrow():
    # 5.5 % settle late: of 200 nobody knows on which side 95 % lies
    two_groups = np.r_[np.full(189, 10.0), np.full(11, 25.0)]
    assert not seen(two_groups).is_sure_of(0.95, TS)
    assert seen(np.tile(two_groups, 64)).is_sure_of(0.95, TS)  # of 12 800 everybody does
    assert seen(np.tile(two_groups, 64)).reached_by(0.95)[1] == 25.0
    # a sample more or less is no matter
    assert seen(np.r_[np.full(100, 10.0), np.full(100, 11.0)]).is_sure_of(0.95, TS)
    assert not seen([*np.full(189, 10.0), *np.full(11, np.inf)]).is_sure_of(0.95, TS)


def test_overshoot_counts_too():
    steps = tuple(StepResponse(o, 10.0, 1.0) for o in np.r_[np.full(189, 0.02), np.full(11, 0.2)])
    assert not Measured(steps[0], steps).is_sure_of(0.95, TS)


def test_a_design_reports_what_95_percent_of_many_other_plants_reach():
    case = next(case for case in cases() if case.seed == 4007)
    problem, wishes = ControlProblem([case.model], case.seed), Wishes()
    found = problem.solve(PIDN(1.0), wishes)
    told = problem.measured(found, wishes)
    assert len(told.drawn) > 200  # some plants of this one settle a swing later than the others
    fresh = (
        Measured(told.nominal, told.drawn[: len(told.drawn) // 2]),
        Measured(told.nominal, told.drawn[len(told.drawn) // 2 :]),
    )
    for half in fresh:
        assert half.reached_by(0.95)[1] == pytest.approx(told.reached_by(0.95)[1], rel=0.1)


def test_output_and_control_signal_of_a_step_are_those_of_the_loop_run_sample_by_sample():
    """y(k) = .7 y(k−1) + .3 u(k−1) under the PI u(k) = u(k−1) + 1.2 e(k) − e(k−1)."""
    plant, controller = (
        TransferFunction([0.3], [1, -0.7], TS),
        TransferFunction([1.2, -1.0], [1, -1], TS),
    )
    y, u, e = np.zeros(60), np.zeros(60), np.ones(60)
    for k in range(60):
        y[k] = 0.7 * y[k - 1] + 0.3 * u[k - 1] if k else 0.0
        e[k] = 1 - y[k]
        u[k] = (u[k - 1] - e[k - 1] if k else 0.0) + 1.2 * e[k]
    np.testing.assert_allclose(step_response(plant, controller, 60.0), y, atol=1e-9)
    np.testing.assert_allclose(control_response(plant, controller, 60.0), u, atol=1e-9)
    # what holds the output at 1 when the plant's gain is 1
    assert u[-1] == pytest.approx(1.0, abs=1e-2)
