"""Control of two inputs and two outputs: the certificate for the whole, promises measured, interactions, refusals."""

import json

import numpy as np
import pytest
from scipy import signal

from residuum.identification.errors import BadInput
from residuum.identification.kernel_based.multivariable import (
    identify_multivariable,
    multivariable_text,
)
from residuum.identification.linear_models.transfer_function import TransferFunction
from residuum.identification.record import Record
from residuum.robust_control.control_problem import WeightChoice, Wishes
from residuum.robust_control.multivariable_control import MultivariableProblem, closed_loop_steps
from residuum.robust_control.synthesis.constrained_structure import PI
from residuum.robust_control.weights.performance_weight import Infeasible
from residuum.service.cli import run

TS, LAGS = 0.5, 40
PATHS = [
    [([0, 0.5], [1, -0.5]), ([0, -0.3], [1, -0.6])],
    [([0, 0.2], [1, -0.7]), ([0, 0.4], [1, -0.6])],
]
FEW = WeightChoice(rule="worst-case", points=200)


def identified(n=2000, noise=0.05, seed=0, paths=PATHS):
    rng = np.random.default_rng(seed)
    u = rng.standard_normal((2, n))
    y = [
        sum(signal.lfilter(b, a, v) for (b, a), v in zip(row, u, strict=True))
        + noise * rng.standard_normal(n)
        for row in paths
    ]
    names = ("u0", "u1", "y0", "y1")
    record = Record(dict(zip(names, [*u, *y], strict=True)), dict.fromkeys(names, ""), TS)
    return identify_multivariable(record, ["u0", "u1"], ["y0", "y1"], order=LAGS)


@pytest.fixture(scope="module")
def problem():
    return MultivariableProblem(identified(), choice=FEW)


@pytest.fixture(scope="module")
def found(problem):
    return problem.solve(PI(TS), Wishes())


def truth():
    impulse = np.eye(1, LAGS + 1)[0]
    return np.array([[signal.lfilter(b, a, impulse) for b, a in row] for row in PATHS])[None]


def poles(taps, found):
    """Closed-loop poles of one plant from state equations: chains of delays for the inputs, companions for the controllers."""
    p, q, length = taps.shape
    shift = np.kron(np.eye(q), np.eye(length - 1, k=-1))
    enter = np.kron(np.eye(q), np.eye(length - 1, 1))
    read = np.hstack([taps[:, j, 1:] for j in range(q)])
    made = [signal.tf2ss(np.atleast_1d(K.num), K.den) for K in found.controllers]
    order = [len(A) for A, *_ in made]
    A_c, B_c, C_c = (
        np.zeros(shape) for shape in ((sum(order), sum(order)), (sum(order), p), (p, sum(order)))
    )
    D_c, at = np.zeros((p, p)), 0
    for i, (A, B, C, D) in enumerate(made):
        part = slice(at, at + len(A))
        A_c[part, part], B_c[part, i], C_c[i, part], D_c[i, i], at = (
            A,
            B[:, 0],
            C[0],
            D[0, 0],
            at + len(A),
        )
    top = np.hstack([shift - enter @ found.decoupler @ D_c @ read, enter @ found.decoupler @ C_c])
    return np.linalg.eigvals(np.vstack([top, np.hstack([-B_c @ read, A_c])]))


def test_all_loops_together_are_stable_for_every_drawn_plant(problem, found):
    assert found.certified and max(found.bounds) < 1.0
    for taps in (*problem.drawn(FEW.samples, 0), problem.nominal[0], truth()[0]):
        assert np.abs(poles(taps, found)).max() < 1.0


def test_the_bound_holds_interactions_and_uncertainty_at_every_frequency(problem):
    omega = np.linspace(0.003, np.pi / TS, 3001)  # frequencies that the fit never saw
    z = np.exp(-1j * omega[:, None] * TS * np.arange(problem.nominal.shape[3]))
    plants = np.einsum("npql,kl->nkpq", problem.drawn(FEW.samples, 0), z) @ problem.decoupler
    for i, loop in enumerate(problem.loops):
        own = loop.plant.frequency_response(omega)
        error = plants[:, :, i].copy()
        error[:, :, i] -= own
        assert loop.proven
        assert np.all(np.abs(error).sum(axis=2) / np.abs(own) <= loop.summed(omega) * (1 + 1e-9))


def test_without_interactions_in_the_bound_the_whole_would_not_be_certified(problem, found):
    alone = [
        np.abs(loop.weights[i].frequency_response(loop.loop.omega))
        for i, loop in enumerate(problem.loops)
    ]
    assert all(
        np.any(loop.magnitude > 1.5 * own) for loop, own in zip(problem.loops, alone, strict=True)
    )


def test_steps_are_those_of_the_state_equations_and_settle_without_error(problem, found):
    seen = problem.measured(found)
    y = closed_loop_steps(truth(), found.decoupler, found.controllers, 0, 400)[0]
    np.testing.assert_allclose(y[-1], [1.0, 0.0], atol=1e-6)
    for i, one in enumerate(seen):
        assert one.own.nominal.settling_time < 100.0 and one.own.reached_by(0.95)[0] < 0.5
        assert 0 < one.coupling < 1.0 and len(one.drawn_coupling) == len(one.own.drawn) >= 200
        true = closed_loop_steps(truth(), found.decoupler, found.controllers, i, 400)[0]
        assert true[:, i].max() - 1.0 < one.own.reached_by(0.95)[0] + 0.02
        assert np.abs(true[:, 1 - i]).max() < np.quantile(one.drawn_coupling, 0.95) + 0.02


def test_one_loop_of_a_pair_behaves_as_the_recursion_says():
    taps = np.zeros((1, 2, 2, 3))
    taps[0, 0, 0, 1] = taps[0, 1, 1, 1] = 1.0  # y(t) = u(t − 1)
    half = TransferFunction([0.5, 0.0], [1.0, -1.0], TS)
    y = closed_loop_steps(taps, np.eye(2), [half, half], 1, 6)[0]
    np.testing.assert_allclose(y[:, 1], [0, 0.5, 0.75, 0.875, 0.9375, 0.96875])
    assert not y[:, 0].any()


def test_relative_gains_and_what_cannot_be_controlled_are_told(problem):
    np.testing.assert_allclose(problem.relative_gains.sum(axis=0), 1.0)
    with pytest.raises(BadInput, match="nominal aim alone"):
        problem.solve(PI(TS), Wishes(aim="robust"))
    with pytest.raises(Infeasible, match="loop of 'y0'"):
        problem.solve(PI(TS), Wishes(settling_time=1e-3))
    one_way = [[([0, 0.5], [1, -0.5])], [([0, 0.2], [1, -0.7])]]
    rng = np.random.default_rng(0)
    u = rng.standard_normal(500)
    y = [signal.lfilter(b, a, u) + 0.1 * rng.standard_normal(500) for ((b, a),) in one_way]
    record = Record({"u": u, "y0": y[0], "y1": y[1]}, dict.fromkeys(("u", "y0", "y1"), ""), TS)
    with pytest.raises(BadInput, match="1 inputs and 2 outputs"):
        MultivariableProblem(identify_multivariable(record, ["u"], ["y0", "y1"], order=20))
    alike = [PATHS[0], [([0, 0.505], [1, -0.5]), ([0, -0.3], [1, -0.6])]]
    with pytest.raises(BadInput, match="interactions and uncertainty"):
        MultivariableProblem(identified(n=300, noise=3.0, paths=alike), choice=FEW).solve(
            PI(TS), Wishes()
        )


def test_the_command_writes_decoupler_and_loops(tmp_path, capsys):
    model, out = tmp_path / "m.json", tmp_path / "k.json"
    model.write_text(multivariable_text(identified()))
    options = ["--structure", "pi", "--rule", "worst-case", "--points", "200"]
    assert run(["control", "design", str(model), "--out", str(out), *options, "--json"]) == 0
    made = json.loads(capsys.readouterr().out)
    assert (
        made["certified"]
        and made["random_plants"]["unstable"] == 0
        and json.loads(out.read_text()) == made
    )
    np.testing.assert_allclose(
        np.array(made["static_gain"]) @ made["decoupler"], np.eye(2), atol=1e-9
    )
    for loop in made["loops"]:
        nominal, promised = loop["measured"]["nominal"], loop["promised"]
        held = all(nominal[name] <= promised[name] for name in promised)
        assert loop["measured"]["kept"] == held and loop["stability_bound"] < 1.0
    assert run(["control", "design", str(model), "--out", str(out), *options]) == 0
    assert "certified stable for every drawn model" in capsys.readouterr().out
    assert run(["control", "design", str(model), str(model), "--out", str(out)]) == 2
    assert "takes one model" in capsys.readouterr().err
    assert (
        run(
            [
                "control",
                "design",
                str(model),
                "--out",
                str(tmp_path / "n.json"),
                "--settling-time",
                ".001",
            ]
        )
        == 1
    )
    assert "infeasible: loop of" in capsys.readouterr().out and not (tmp_path / "n.json").exists()
