"""An estimation that did not come to rest says why, has no band, and gives no model unless asked to."""

import json

import numpy as np
import pytest

import residuum as rs
from residuum.identification.errors import NotIdentifiable
from residuum.service.cli import ANSWER_IS_NO, DONE, run

PENDULUM = """
name: pendulum
inputs: {torque: N*m}
states: {phi: {unit: rad, rate: w}, w: {unit: rad/s}}
parameters:
  J: {value: %g, unit: kg*m**2, lower: 1e-5}
  mgl: {value: %g, unit: N*m, lower: 0, upper: %g}
  b: {value: 0.002, unit: N*m*s/rad, fixed: true}
balances:
  pivot: {kind: torque, storage: J * der(w), terms: {motor: torque, weight: mgl * sin(phi), drag: -b * w},
          position: phi, velocity: w}
outputs: {angle: {value: phi, unit: rad}}
"""
TRUTH, FAR = (0.004, 0.3), (0.006, 0.2)


@pytest.fixture(scope="module")
def held():
    """An inverted pendulum that a controller holds for 15 s: no simulation stays with it."""
    rng, (J, mgl) = np.random.default_rng(32), TRUTH
    phi = w = old = 0.0
    rows = []
    for k in range(1500):
        angle = phi + 2e-4 * rng.standard_normal()
        torque = -(0.6 * angle + 0.03 * (angle - old) / 0.01 * (k > 0)) + 0.01 * (
            1 if (k // 15 * 7919) % 13 < 6 else -1
        )
        old = angle
        rows.append((torque, angle))
        for _ in range(20):
            w += (mgl * np.sin(phi) - 0.002 * w + torque) / J * 0.0005
            phi += w * 0.0005
    torque, angle = np.array(rows).T
    return rs.from_arrays(
        {"torque": torque, "angle": angle},
        units={"torque": "N*m", "angle": "rad"},
        sample_time=0.01,
    )


def pendulum(J, mgl, upper=1e3):
    return rs.model(PENDULUM % (J, mgl, upper))


@pytest.mark.parametrize("start", [TRUTH, FAR])
def test_a_search_that_was_left_has_no_band_and_gives_no_model(held, start):
    found = pendulum(*start).estimate(held)
    assert not found.to_dict()["converged"]
    assert {value["std"] for value in found.parameters.values()} == {None}
    assert "method prediction" in str(found)
    with pytest.raises(NotIdentifiable, match=r"has not converged: .*method prediction"):
        _ = found.model
    assert (
        pendulum(*start).estimate(held, anyway=True).model.parameters["J"].value
        == found.parameters["J"]["value"]
    )


@pytest.mark.parametrize("start", [TRUTH, FAR])
def test_the_way_on_that_is_named_leads_to_the_truth(held, start):
    found = pendulum(*start).estimate(held, method="prediction")
    assert found.unsettled == ()
    assert [found.model.parameters[name].value for name in ("J", "mgl")] == pytest.approx(
        TRUTH, rel=0.01
    )


def test_a_simulation_that_diverges_names_the_way_on_too(held):
    falling = rs.model((PENDULUM % (1e-5, 0.3, 1e3)).replace("sin(phi)", "phi"))
    with pytest.raises(NotIdentifiable, match=r"diverges .*method prediction"):
        falling.estimate(held)


def test_a_value_at_its_bound_is_none_that_the_data_tell(held):
    found = pendulum(*FAR, upper=0.25).estimate(held, method="prediction")
    told = found.to_dict()
    assert (told["converged"], told["unsettled"]) == (
        False,
        ["mgl sits at its bound: widen it, or fix the value"],
    )
    assert found.parameters["J"]["std"] is None
    # the least error within what the model allows
    assert found.model.parameters["mgl"].value == 0.25


def test_a_model_below_the_mean_says_so():
    force = np.repeat(np.random.default_rng(1).choice([-1.0, 1.0], 40), 10)
    apart = rs.from_arrays(
        {"force": force, "velocity": 5.0 + 0.01 * np.cumsum(np.roll(-force, 7))},
        units={"force": "N", "velocity": "m/s"},
        sample_time=0.1,
    )
    found = rs.model("linear-axis").estimate(apart, anyway=True)
    assert not found.to_dict()["converged"]


def test_from_the_truth_it_stays_there_and_is_settled():
    force = np.repeat(np.random.default_rng(2).choice([-1.0, 1.0], 100), 10)
    axis = rs.model("linear-axis").with_values(M=95.0)
    pushed = rs.from_arrays({"force": force}, units={"force": "N"}, sample_time=0.01)
    out = axis.simulate(pushed)
    noisy = {
        name: out[name] + 1e-5 * np.random.default_rng(3).standard_normal(1000)
        for name in out.names
    }
    record = rs.from_arrays(
        {"force": force, **noisy}, units={"force": "N", **out.units}, sample_time=0.01
    )
    first = axis.estimate(record)
    again = first.model.estimate(record)
    assert (first.unsettled, again.unsettled) == ((), ())
    assert again.parameters["M"]["value"] == pytest.approx(first.parameters["M"]["value"], rel=1e-6)


def test_the_command_writes_nothing_unless_asked(held, tmp_path, capsys):
    held.save(tmp_path / "held.npz")
    (tmp_path / "pendulum.yaml").write_text(PENDULUM % (*TRUTH, 1e3))
    out = tmp_path / "out.yaml"
    asked = [
        "estimate",
        str(tmp_path / "pendulum.yaml"),
        str(tmp_path / "held.npz"),
        "--out",
        str(out),
    ]
    assert run(asked) == ANSWER_IS_NO
    assert not out.exists()
    assert "not written (--anyway" in capsys.readouterr().out
    assert run([*asked, "--anyway", "--json"]) == ANSWER_IS_NO
    found = json.loads(capsys.readouterr().out)
    assert (found["converged"], found["model_file"]) == (False, str(out))
    assert found["unsettled"]
    assert out.exists()
    assert run([*asked, "--method", "prediction"]) == DONE
