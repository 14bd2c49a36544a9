"""A plant that acts within its sample: what is promised holds on the true plant, whose controller answers a sample later."""

import numpy as np
import pytest

import residuum as rs

G = {
    "direct": np.r_[1.0, 0.5 * 0.8 ** np.arange(60)],
    "static": np.array([2.0]),
    "mostly": np.r_[5.0, 0.05 * 0.9 ** np.arange(80)],
}


def identified(g, method):
    rng = np.random.default_rng(0)
    u = np.repeat(rng.standard_normal(500), 4)
    y = np.convolve(u, g)[: u.size]
    y = y + 0.02 * y.std() * rng.standard_normal(u.size)
    record = rs.Record({"u": u, "y": y}, {"u": "V", "y": "V"}, 0.1)
    return rs.identify(record, input="u", output="y", method=method, delay=0)


def step_in_the_loop(controller, g, samples=400):
    """The true plant under the controller: each sample its output is measured, then the input is written."""
    num, den = controller.num / controller.den[0], controller.den / controller.den[0]
    num = np.r_[np.zeros(len(den) - len(num)), num]
    u, e, y = np.zeros(samples), np.zeros(samples), np.zeros(samples)
    for k in range(samples):
        past = u[max(0, k - len(g)) : k][::-1]
        y[k] = g[: past.size] @ past
        e[k] = 1.0 - y[k]
        if abs(y[k]) > 1e6:
            break
        u[k] = sum(b * e[k - i] for i, b in enumerate(num) if k >= i) - sum(
            a * u[k - i] for i, a in enumerate(den) if 0 < i <= k
        )
    return y


@pytest.mark.parametrize(
    ("plant", "method"), [("direct", "arx"), ("static", "arx"), ("mostly", "kernel")]
)
def test_the_loop_of_the_true_plant_is_as_promised(plant, method):
    controller = rs.control.design(identified(G[plant], method), structure="pi")
    answer = controller.to_dict()
    assert answer["computation_samples"] == 1 and answer["stable"]
    assert "one sample later" in str(controller)
    y = step_in_the_loop(controller.transfer_function, G[plant])
    settled = round(answer["measured"]["nominal"]["settling_time_s"] / 0.1) + 2
    assert np.abs(y[settled:] - 1).max() < 0.03
    assert y.max() - 1 == pytest.approx(answer["measured"]["nominal"]["overshoot"], abs=0.01)


def test_a_plant_that_acts_a_sample_later_is_taken_as_it_is():
    plant = identified(np.r_[0.0, G["direct"]], "arx")
    # delay 0 was asked for
    assert rs.control.design(plant, structure="pi").to_dict()["computation_samples"] == 1
    rng = np.random.default_rng(1)
    u = rng.standard_normal(800)
    record = rs.Record(
        {"u": u, "y": np.convolve(u, np.r_[0.0, G["direct"]])[:800]}, {"u": "V", "y": "V"}, 0.1
    )
    later = rs.identify(record, input="u", output="y", method="arx", order=2, delay=1)
    assert rs.control.design(later, structure="pi").to_dict()["computation_samples"] == 0
