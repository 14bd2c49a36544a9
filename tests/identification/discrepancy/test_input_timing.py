"""A controller's force is held for a sample though it moves at every one: its look does not tell, the error does."""

import numpy as np
import pytest

from residuum.identification.discrepancy.explain import explain
from residuum.identification.discrepancy.improve import improve
from residuum.identification.physics import estimate, match, read_model
from residuum.identification.record import Record
from residuum.identification.residual_analysis.feedback import a_step_away, at_likelier_timing

MASS = """name: mass
inputs: {force: N}
states: {v: {unit: m/s}}
parameters: {M: {value: 2.2, unit: kg, lower: 0.1}, d: {value: 2.7, unit: N*s/m, lower: 0}}
balances: {body: {kind: force, storage: M * der(v), terms: {drive: force, friction: -d * v}, velocity: v}}
outputs: {speed: {value: v, unit: m/s}}
"""


def held_record(n=2000, sample_time=0.01):
    rng = np.random.default_rng(3)
    force = np.convolve(rng.normal(size=n + 40), np.hanning(40), "same")[:n]
    v = np.zeros(n)
    decay = np.exp(-3.0 / 2.0 * sample_time)
    for k in range(n - 1):
        v[k + 1] = decay * v[k] + (1.0 - decay) * force[k] / 3.0
    return Record(
        {"force": force, "speed": v + 1e-4 * rng.normal(size=n)},
        {"force": "N", "speed": "m/s"},
        sample_time,
    )


def test_a_held_input_is_recognised_by_the_error_that_it_leaves():
    model, experiments = match(read_model(MASS), [held_record()])
    assert experiments[0].hold[0] == 1.0  # it looks as if it moved evenly
    turned, found = at_likelier_timing(experiments, lambda tried: estimate(model, tried))
    assert turned[0].hold[0] == 0.0
    assert np.all(np.abs(found.theta - [2.0, 3.0]) < 4.0 * found.std)
    assert np.any(np.abs(estimate(model, experiments).theta - [2.0, 3.0]) > 4.0 * found.std)


def test_each_of_several_inputs_has_its_own_timing():
    """A valve that a controller holds beside a temperature that was only measured: one of them turned alone is right."""
    text = MASS.replace("inputs: {force: N}", "inputs: {force: N, wind: N}").replace(
        "drive: force", "drive: force, wind: wind"
    )
    rng = np.random.default_rng(5)
    n, h = 2000, 0.01
    force, wind = (
        np.convolve(rng.normal(size=n + 40), np.hanning(40), "same")[:n],
        rng.normal(size=n),
    )
    v, decay = np.zeros(n), np.exp(-1.5 * h)
    for k in range(n - 1):
        v[k + 1] = decay * v[k] + (1.0 - decay) * (force[k] + wind[k]) / 3.0
    channels = {"force": force, "wind": wind, "speed": v + 1e-4 * rng.normal(size=n)}
    record = Record(channels, {"force": "N", "wind": "N", "speed": "m/s"}, h)
    model, experiments = match(read_model(text), [record])
    assert experiments[0].hold.tolist() == [1.0, 0.0]
    turned, found = at_likelier_timing(experiments, lambda tried: estimate(model, tried))
    assert turned[0].hold.tolist() == [0.0, 0.0]
    assert np.all(np.abs(found.theta - [2.0, 3.0]) < 4.0 * found.std)
    assert explain(model, [record], effects=["input-delay", "input-lag"]).verdict == "adequate"


def test_timings_that_a_step_leaves_far_behind_are_not_fitted():
    """Of six fits to four inputs, what was chosen, its values and their bands are those of all six, to the last digit."""
    names = ("force", "wind", "slope", "load")
    text = MASS.replace(
        "inputs: {force: N}", f"inputs: {{{', '.join(f'{n}: N' for n in names)}}}"
    ).replace("drive: force", ", ".join(f"{n}: {n}" for n in names))
    rng = np.random.default_rng(7)
    n, h = 2000, 0.01
    pushes = {
        name: np.convolve(rng.normal(size=n + 40), np.hanning(40), "same")[:n] for name in names
    }
    v, decay = np.zeros(n), np.exp(-1.5 * h)
    for k in range(n - 1):
        v[k + 1] = decay * v[k] + (1.0 - decay) * sum(u[k] for u in pushes.values()) / 3.0
    channels = pushes | {"speed": v + 1e-4 * rng.normal(size=n)}
    record = Record(channels, dict.fromkeys(names, "N") | {"speed": "m/s"}, h)
    model, experiments = match(read_model(text), [record])
    fits = {"all": [], "some": []}

    def fitted(which):
        return lambda tried: fits[which].append(estimate(model, tried)) or fits[which][-1]

    turned, found = at_likelier_timing(experiments, fitted("all"))
    nearby, as_well = at_likelier_timing(experiments, fitted("some"), a_step_away)
    assert nearby[0].hold.tolist() == turned[0].hold.tolist() == [0.0] * 4
    assert as_well.theta.tolist() == found.theta.tolist()
    assert as_well.covariance.tolist() == found.covariance.tolist()
    assert np.all(np.abs(found.theta - [2.0, 3.0]) < 4.0 * found.std)
    # The first, and that with all turned, which is right: none with one of them turned back.
    assert (len(fits["all"]), len(fits["some"])) == (6, 2)


@pytest.mark.parametrize("held", [True, False])
def test_a_delay_is_not_half_a_sample_off_because_the_timing_was_chosen_without_it(held):
    rng = np.random.default_rng(8)
    n, h, delay = 2000, 0.01, 0.022
    force = np.convolve(rng.normal(size=n + 20), np.hanning(4), "same")[:n]
    late = (np.arange(100 * n) + 0.5) * h / 100 - delay
    drives = (
        force[np.clip(late // h, 0, n - 1).astype(int)]
        if held
        else np.interp(late, np.arange(n) * h, force)
    )
    v, speed = 0.0, np.empty(n)
    for k in range(100 * n):
        if k % 100 == 0:
            speed[k // 100] = v
        v += h / 100 * (drives[k] - 3.0 * v) / 2.0
    record = Record(
        {"force": force, "speed": speed + 3e-4 * rng.normal(size=n)},
        {"force": "N", "speed": "m/s"},
        h,
    )
    found = explain(read_model(MASS), [record])
    assert list(found.accepted) == [("input-delay", "force")]
    assert found.found.validation.data.experiments[0].hold[0] == (0.0 if held else 1.0)
    assert abs(found.candidates[0].parameters["delay"].value - delay) < 2e-4
    improved = improve(read_model(MASS), [record])
    assert abs(improved.model.values["input-delay@force.delay"] - delay) < 2e-4
