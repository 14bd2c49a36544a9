"""The view of a robust design: what is drawn is what the controller does, and what cannot be met is said."""

import time

import numpy as np
import pytest
from scipy.signal import lfilter

from residuum.identification.kernel_based.impulse_response import identify_impulse_response
from residuum.identification.linear_models.identified_model_file import save_identified
from residuum.identification.record import Record

A, B = 0.7, 0.3  # y(k) = A y(k−1) + B u(k−1)


@pytest.fixture
def stored(client, tmp_path):
    rng = np.random.default_rng(5)
    u = rng.normal(size=1500)
    y = lfilter([0, B], [1, -A], u) + 0.02 * rng.normal(size=1500)
    file = tmp_path / "plant.json"
    record = Record({"u": u, "y": y}, {"u": "V", "y": "m"}, 0.1)
    save_identified(identify_impulse_response(record, "u", "y", order=30, delay=1), file)
    answer = client.post(
        "/api/v1/models", params={"name": "plant", "kind": "identified"}, content=file.read_bytes()
    )
    assert answer.status_code == 201, answer.text
    return "plant"


def view(client, **asked):
    answer = client.post("/api/v1/control-designs/views", json=asked)
    assert answer.status_code == 202, answer.text
    end = time.monotonic() + 120
    while (job := client.get(answer.headers["location"]).json())["state"] in ("queued", "running"):
        assert time.monotonic() < end, job
        time.sleep(0.05)
    assert job["state"] == "done", job
    return job["result"]


def closed_loop(b, a, samples):
    """Step response of the true plant, and the control signal, under u(k) = Σ b e(k−i) − Σ a u(k−i)."""
    e, u, y = np.zeros(samples), np.zeros(samples), np.zeros(samples)
    for k in range(samples):
        y[k] = A * y[k - 1] + B * u[k - 1] if k else 0.0
        e[k] = 1 - y[k]
        past = range(1, min(k, len(a)) + 1)
        u[k] = b[0] * e[k] + sum(b[i] * e[k - i] - a[i - 1] * u[k - i] for i in past)
    return y, u


def test_every_point_of_the_front_behaves_as_it_is_drawn(client, stored):
    found = view(client, models=[{"model": stored}], aim="robust", structure="pi")
    assert found["feasible"] and found["wishes"] == ["high_gain_db", "critical_frequency_rad_s"]
    assert found["input"] == {"name": "u", "unit": "V"} and found["output"] == {
        "name": "y",
        "unit": "m",
    }
    firsts, seconds = ([point[name] for point in found["points"]] for name in ("first", "second"))
    # a front: more of the one, less of the other
    assert firsts == sorted(firsts) and seconds == sorted(seconds, reverse=True)
    for point in found["points"]:
        steps = point["steps"]
        samples = np.round(np.array(steps["time"]) / 0.1).astype(int)
        truth, asked = closed_loop(point["b"], point["a"], samples[-1] + 1)
        np.testing.assert_allclose(steps["nominal"], truth[samples], atol=0.08)
        assert np.mean(np.ptp(np.array(steps["drawn"]), axis=0) > 0) > 0.8
        np.testing.assert_allclose(steps["control"]["nominal"], asked[samples], rtol=0.1, atol=0.1)
        assert len(steps["control"]["drawn"]) == len(steps["drawn"])
        assert point["cost"] < found["limit"] and max(point["total"]) <= 1.001 * point["cost"]
        S, T = np.array(point["S"]), np.array(point["T"])
        assert np.all(S * point["W_S"] < 1.001) and np.all(T * point["W_T"] < 1.001)
        assert point["robust_stability_norm"] < 1 and point["figures"]["unstable"] == 0
        assert "RobustController" in point["exports"]["st"] and "double" in point["exports"]["c"]


def test_every_choice_of_the_weight_reaches_it(client, stored, refused):
    asked = {"models": [{"model": stored}], "structure": "pi", "points": 60, "lowest": 0.05}
    first = view(client, **asked)["uncertainty"]
    assert (first["samples"], first["order"]) == (738, 2) and first["frequency"][
        0
    ] == pytest.approx(0.05 / (2 * np.pi))
    chosen = asked | {"epsilon": 0.1, "zeta": 0.2, "rule": "worst-case", "weight_order": 1}
    other = view(client, **chosen)["uncertainty"]
    assert (other["samples"], other["order"]) == (16, 1)
    assert refused("POST", "/api/v1/control-designs/views", json=asked | {"epsilon": 0})[0] == 422


def test_limits_reach_the_code_and_what_cannot_be_is_said(client, stored, refused):
    asked = {
        "models": [{"model": stored, "version": 1}],
        "structure": "pi",
        "only": "settling-time",
        "limits": [None, 2.5],
    }
    made = view(client, **asked)
    assert made["points"][made["chosen"]]["second"] == min(
        point["second"] for point in made["points"]
    )
    assert "2.5" in made["points"][0]["difference_equation"]
    impossible = view(client, **asked, settling_time=0.3)
    assert (
        not impossible["feasible"]
        and "aim" in impossible["reason"]
        and impossible["uncertainty"]["critical_frequency"] > 0
    )
    address = "/api/v1/control-designs/views"
    assert refused("POST", address, json=asked | {"limits": [3, 2.5]})[0] == 422
    assert refused("POST", address, json={"models": [{"model": "none"}]})[0] == 404


def test_names_of_before_are_still_read(client, stored):
    asked = {"models": [{"model": stored}], "structure": "pi", "points": 60, "aim": "robust"}
    before = {
        "low_gain_db": 100,
        "smallest_high_gain_db": -6,
        "lowest_critical_frequency": 0.02,
        "lower": -9,
        "upper": 2.5,
    }
    now = {"low_gain": 100, "high_gain": -6, "critical_frequency": 0.02, "limits": [-9, 2.5]}
    assert view(client, **asked, **before) == view(client, **asked, **now)
