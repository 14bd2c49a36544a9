"""Fixed-structure synthesis on plants where the answer, or a bound on it, is known."""

import numpy as np
import pytest
from scipy.optimize import differential_evolution

from residuum.identification.errors import BadInput
from residuum.identification.linear_models.transfer_function import TransferFunction
from residuum.robust_control.certificates import (
    RobustAim,
    assess,
    design_for_robust_performance,
    step_response,
)
from residuum.robust_control.loop import Loop, Weights, frequency_grid
from residuum.robust_control.synthesis.constrained_structure import (
    PI,
    PIDN,
    LeadLag,
    Point,
    Rational,
    bisected_front,
    preferred,
)
from residuum.robust_control.synthesis.structured_synthesis import (
    NoStabilisingStart,
    default_starts,
    synthesise,
)
from residuum.robust_control.weights.performance_weight import (
    Infeasible,
    MonotoneWeight,
    NominalAim,
    ReferenceModel,
    design_for_nominal_performance,
    shortest_settling_time,
)

TS = 0.05
PLANT = TransferFunction([2.0], [1.0, 1.2, 1.0]).discretise(TS)
OMEGA = frequency_grid([PLANT], points=300, lowest=1e-3)
LOOP = Loop([PLANT], OMEGA)
W_T = np.abs(TransferFunction([0.3, 0.3], [0.01, 1.0]).frequency_response(OMEGA))
W_S = ReferenceModel(0.05, 6.0).weight_magnitude(OMEGA)


@pytest.mark.parametrize(
    "structure", [PI(TS), PIDN(TS), LeadLag(TS), Rational(TS, order=2)], ids=lambda s: s.name
)
def test_gradients_are_those_of_the_cost(structure):
    rho = structure.starts(2.0, 1.0)[1] * 1.1 + 0.01
    pairs = (np.zeros(7, dtype=int), np.arange(10, 290, 40))
    for entries, W_K in (("1", None), ("2", None), ("1", W_T), ("2", W_T)):
        weights = Weights(W_S, W_T, entries, W_K)
        K = structure.response(rho, LOOP.z)[0]
        value, slope = LOOP.slopes(*structure.response(rho, LOOP.z[pairs[1]]), weights, pairs)
        np.testing.assert_allclose(value, LOOP.cost(K, weights)[pairs], rtol=1e-12)
        for j in range(len(rho)):
            moved = rho + 1e-7 * (np.arange(len(rho)) == j)
            numeric = (
                LOOP.cost(structure.response(moved, LOOP.z)[0], weights)[pairs] - value
            ) / 1e-7
            np.testing.assert_allclose(slope[:, j], numeric, rtol=1e-4, atol=1e-5)


def test_transfer_functions_agree_with_responses():
    for structure in (PI(TS), PIDN(TS), LeadLag(TS), Rational(TS, order=3)):
        rho = structure.starts(2.0, 1.0)[2] * 1.3
        expected = structure.response(rho, LOOP.z)[0]
        np.testing.assert_allclose(
            structure.transfer_function(rho).frequency_response(OMEGA), expected, rtol=1e-8
        )


def test_a_slower_reference_costs_no_more():
    """Its bound asks less; a dearer controller would be another valley's."""
    plant = TransferFunction([2.0], np.polymul([1200.0, 1.0], [60.0, 1.0])).discretise(60.0)
    loop = Loop([plant], frequency_grid([plant]))
    W_T = 0.5 * np.hypot(1.0, loop.omega / 0.017)
    cost = [
        synthesise(
            loop, Weights(ReferenceModel(0.01, time).weight_magnitude(loop.omega), W_T), PIDN(60.0)
        ).cost
        for time in (300.0, 500.0, 700.0)
    ]
    assert cost[2] < cost[1] < cost[0]


def test_the_optimum_is_as_good_as_a_global_search():
    weights = Weights(W_S, W_T)
    found = synthesise(LOOP, weights, PI(TS))

    def cost(rho):
        structure = PI(TS)
        if not LOOP.is_stable(structure.transfer_function(rho)):
            return 1e3
        return LOOP.cost(structure.response(rho, LOOP.z)[0], weights).max()

    globally = differential_evolution(cost, [(-2, 2), (0.01, 3)], seed=1, maxiter=60, popsize=12)
    assert found.cost <= globally.fun * (1 + 1e-3)
    assert found.stable and found.certified == pytest.approx(found.cost, rel=0.02)


def test_more_freedom_never_costs():
    weights = Weights(W_S, W_T)
    assert synthesise(LOOP, weights, PIDN(TS)).cost <= synthesise(LOOP, weights, PI(TS)).cost * (
        1 + 1e-6
    )


def test_a_weight_on_the_control_effort_lowers_it_and_costs_performance():
    effort = np.full(len(OMEGA), 4.0)
    free, careful = (
        synthesise(LOOP, Weights(W_S, W_T, "2", W_K), PIDN(TS)) for W_K in (None, effort)
    )
    K = careful.controller.frequency_response(OMEGA)
    S = 1 / (1 + LOOP.G[0] * K)
    assert careful.cost > free.cost and np.abs(4.0 * K * S).max() <= careful.certified
    K_free = free.controller.frequency_response(OMEGA)
    assert np.abs(K * S).max() < np.abs(K_free / (1 + LOOP.G[0] * K_free)).max()


def test_several_plants_are_stabilised_together():
    others = [TransferFunction([gain], [1.0, 1.2, 1.0]).discretise(TS) for gain in (1.0, 2.0, 4.0)]
    found = synthesise(Loop(others, OMEGA), Weights(W_S, W_T), PIDN(TS))
    assert found.stable
    for plant in others:
        assert np.isfinite(assess(step_response(plant, found.controller, 30.0), TS).settling_time)


def test_nominal_design_meets_its_weights():
    design = design_for_nominal_performance(LOOP, W_T, PIDN(TS), NominalAim(0.02, 20.0), 10.0)
    assert design.chosen.design.stable and design.chosen.design.certified < 1.1
    S = 1 / (1 + LOOP.G[0] * design.chosen.design.controller.frequency_response(OMEGA))
    assert np.all(np.abs(S) * design.reference.weight_magnitude(OMEGA) < 1.1)


def test_robust_design_meets_the_sum_condition_everywhere():
    design = design_for_robust_performance(
        LOOP, W_T, PIDN(TS), RobustAim(lowest_critical_frequency=0.01), 3.0
    )
    controller = design.chosen.design.controller
    fine = np.geomspace(1e-3, np.pi / TS, 20_000)
    L = PLANT.frequency_response(fine) * controller.frequency_response(fine)
    W_S_fine = design.weight.magnitude(fine)
    W_T_fine = np.abs(TransferFunction([0.3, 0.3], [0.01, 1.0]).frequency_response(fine))
    assert np.all(W_S_fine / np.abs(1 + L) + W_T_fine * np.abs(L / (1 + L)) < 1.0)


def test_an_impossible_aim_is_refused_with_its_frequency():
    with pytest.raises(Infeasible, match=r"no controller 'pi' meets it.* rad/s, by"):
        design_for_nominal_performance(
            LOOP, np.full(len(OMEGA), 1.5), PI(TS), NominalAim(0.01, 20.0), 10.0
        )


def test_a_plant_that_no_start_stabilises_is_refused():
    unstable = TransferFunction([1.0], [1.0, -3.0, 2.0], TS)
    with pytest.raises(NoStabilisingStart, match="none of"):
        synthesise(Loop([unstable], OMEGA), Weights(W_S, W_T), PI(TS))


def test_reference_model_and_weight_follow_their_equations():
    model = ReferenceModel(0.1, 2.0)
    assert model.damping == pytest.approx(
        0.5912, abs=1e-4
    ) and model.natural_frequency == pytest.approx(4 / (model.damping * 2.0))
    T = model.transfer_function()
    w = model.bandwidth
    loop_gain = T.frequency_response([w]) / (1 - T.frequency_response([w]))
    assert abs(loop_gain[0]) == pytest.approx(1.0, rel=1e-9)
    assert ReferenceModel(0.1, shortest_settling_time(0.1, 7.0)).bandwidth == pytest.approx(7.0)
    weight = MonotoneWeight(60.0, -20.0, 3.0)
    np.testing.assert_allclose(weight.magnitude([1e-9, 3.0, 1e9]), [1000.0, 1.0, 0.1], rtol=1e-6)


def test_front_by_bisection_equals_the_full_grid():
    def meets(a, b, _):
        return (a, b) if a + b * b <= 60 else None

    found = {
        (p.first, p.second) for p in bisected_front(list(range(0, 70, 7)), list(range(12)), meets)
    }
    feasible = {(a, b) for a in range(0, 70, 7) for b in range(12) if meets(a, b, None)}
    undominated = {
        p for p in feasible if not any(q != p and q[0] >= p[0] and q[1] >= p[1] for q in feasible)
    }
    assert found == undominated


def test_bad_settings_are_refused():
    with pytest.raises(BadInput, match="one must lie above"):
        MonotoneWeight(10.0, 20.0, 1.0)
    with pytest.raises(BadInput, match="overshoot"):
        ReferenceModel(1.5, 1.0)
    with pytest.raises(BadInput, match="increase up to"):
        Loop([PLANT], np.array([1.0, 1e9]))


def test_starts_of_very_different_speed_come_near_one_optimum_on_a_slow_plant():
    """ρ mixes units: with k_i about 1e-3 and N_d about 60 s a search that compares them stops far from the optimum."""
    slow = TransferFunction([2.3], [4000.0, 1.0]).discretise(60.0)
    omega = frequency_grid([slow], points=200)
    loop, structure = Loop([slow], omega), PIDN(60.0)
    weights = Weights(ReferenceModel(0.01, 900.0).weight_magnitude(omega), np.full(len(omega), 0.3))
    starts = default_starts(loop, structure)
    costs = [
        synthesise(loop, weights, structure, starts=[rho]).cost
        for rho in (starts[0], starts[-2], starts[7])
    ]
    assert max(costs) < 1.1 * min(costs)
    assert synthesise(loop, weights, structure).cost < 1.001 * min(costs)


@pytest.mark.parametrize(
    "plant",
    [
        TransferFunction([0.1], [1.0, -1.05], TS),
        TransferFunction([1.0], [1.0, 1.0, 0.0]).discretise(TS),
        TransferFunction([1.0], [1.0, 0.0, 0.0]).discretise(TS),
        TransferFunction([-1.0, 1.0], [1.0, 2.0, 1.0]).discretise(TS),
        TransferFunction([0.1], np.r_[1.0, -0.9, np.zeros(40)], TS),
    ],
    ids=["unstable", "integrating", "double integrator", "non-minimum-phase", "delayed"],
)
def test_difficult_plants_get_a_controller_that_holds_them(plant):
    omega = frequency_grid([plant], points=300)
    weights = Weights(ReferenceModel(0.05, 20.0).weight_magnitude(omega), np.full(len(omega), 0.3))
    found = synthesise(Loop([plant], omega), weights, PIDN(TS))
    assert found.stable and found.certified < 1.35
    y = step_response(plant, found.controller, 600.0)
    assert np.abs(y[-20:] - 1).max() < 0.05


def test_the_fine_grid_agrees_with_the_design():
    sharp = TransferFunction([1.0], np.polymul([1.0, 0.01, 4.0], [1.0, 1.0])).discretise(TS)
    omega = frequency_grid([sharp], points=60)
    W_T = np.abs(TransferFunction([0.3, 0.3], [0.01, 1.0]).frequency_response(omega))
    found = synthesise(
        Loop([sharp], omega),
        Weights(ReferenceModel(0.05, 60.0).weight_magnitude(omega), W_T),
        PIDN(TS),
    )
    assert found.stable and found.certified == pytest.approx(found.cost, rel=1e-3)


def test_one_wish_alone_takes_its_own_end_of_the_front():
    front = [Point(first, second, None) for first, second in ((1.0, 9.0), (2.0, 4.0), (5.0, 1.0))]
    chosen = [preferred(front, (0.0, 0.0), (1.0, 1.0), only) for only in (None, 0, 1)]
    assert [(point.first, point.second) for point in chosen] == [(2.0, 4.0), (1.0, 9.0), (5.0, 1.0)]
    aims = [
        RobustAim(lowest_critical_frequency=0.01, high_gains=3, only=only)
        for only in ("high-gain", "critical-frequency")
    ]
    high, fast = (design_for_robust_performance(LOOP, W_T, PI(TS), aim, 3.0).chosen for aim in aims)
    assert high.first >= fast.first and fast.second >= high.second
    with pytest.raises(BadInput, match="only: is 'speed'"):
        NominalAim(only="speed")


def test_the_fastest_loop_lies_between_the_grids_settling_times():
    def fastest(halvings):
        aim = NominalAim(0.05, 20.0, 0.1, overshoots=1, settling_times=12, halvings=halvings)
        return design_for_nominal_performance(LOOP, W_T, PIDN(TS), aim, 3.0).chosen

    on_the_grid, between = fastest(0), fastest(6)
    assert between.second < on_the_grid.second and between.design.certified < 1.1
    shorter = Weights(
        ReferenceModel(between.first, 0.985 * between.second).weight_magnitude(OMEGA), W_T
    )
    assert synthesise(LOOP, shorter, PIDN(TS)).certified > 1.1
