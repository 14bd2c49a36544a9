"""Tests of whether a simulation can follow a record."""

from __future__ import annotations

import numpy as np
import pytest

from residuum.identification.discrepancy.explain import explain
from residuum.identification.discrepancy.improve import improve
from residuum.identification.errors import NotIdentifiable
from residuum.identification.physics import PhysicalModel, match, read_model
from residuum.identification.record import Record
from residuum.identification.residual_analysis.compare import compare
from residuum.identification.residual_analysis.followed import (
    check_followed,
    growth_over_second_half,
)

PENDULUM = """
name: pendulum
inputs: {torque: N*m}
states: {phi: {unit: rad, rate: w}, w: {unit: rad/s}}
parameters:
  J: {value: 0.004, unit: kg*m**2, lower: 1e-5}
  mgl: {value: 0.3, unit: N*m}
balances:
  pivot: {kind: torque, storage: J * der(w), terms: {motor: torque, weight: mgl * sin(phi)}, position: phi, velocity: w}
outputs: {angle: {value: phi, unit: rad}}
"""


def on_its_head(seconds: float) -> Record:
    """A pendulum that a controller with noise of its own holds on its head."""
    rng, step, fine = np.random.default_rng(3), 0.01, 20
    n = round(seconds / step)
    phi, w, torque, angle = 0.02, 0.0, np.zeros(n), np.zeros(n)
    for k in range(n):
        angle[k] = phi + 2e-4 * rng.standard_normal()
        torque[k] = -1.2 * angle[k] - 0.08 * w + (0.02 if (k // 40) % 2 else -0.02)
        for _ in range(fine):
            w += (torque[k] + 0.3 * np.sin(phi)) / 0.004 * step / fine
            phi += w * step / fine
    return Record(
        channels={"torque": torque, "angle": angle},
        units={"torque": "N*m", "angle": "rad"},
        sample_time=step,
    )


@pytest.fixture(scope="module")
def held() -> Record:
    return on_its_head(6.0)


def with_values(model: PhysicalModel, **values: float) -> PhysicalModel:
    return model.with_values(values)


@pytest.mark.parametrize("asked", [compare, explain, improve])
def test_refuses_what_runs_away_from_any_record_and_names_the_way(held, asked) -> None:
    with pytest.raises(
        NotIdentifiable, match=r"unstable along record .* e-fold in 0\.1\d+ s.*method='prediction'"
    ):
        asked(read_model(PENDULUM), [held])


def test_the_growth_is_that_of_the_unstable_pole(held) -> None:
    model, (experiment,) = match(read_model(PENDULUM), [held])
    assert growth_over_second_half(model, experiment) == pytest.approx(
        3.0 * np.sqrt(0.3 / 0.004), rel=0.02
    )


def test_a_record_that_a_simulation_still_follows_is_judged() -> None:
    assert compare(read_model(PENDULUM), [on_its_head(0.6)]).outputs["angle"].rmse < 5e-3


def test_what_hangs_or_integrates_is_not_unstable_however_far_off(held) -> None:
    for mgl in (-0.3, 0.0):
        model, experiments = match(with_values(read_model(PENDULUM), mgl=mgl), [held])
        check_followed(model, experiments)
