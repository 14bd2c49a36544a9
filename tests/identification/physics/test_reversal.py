"""A velocity that reverses between two samples under Coulomb friction: by hand, it falls with F + τ_c and rises with F − τ_c."""

import numpy as np
import pytest

from residuum.identification.physics import Experiment, Simulator, load_model

SLIDE = """
name: slide
inputs: {force: N}
states: {v: {unit: m/s}}
parameters: {M: {value: 2, unit: kg, lower: 0.1}}
balances:
  slide: {kind: force, storage: M * der(v), terms: {drive: force}, velocity: v}
outputs: {speed: {value: v, unit: m/s}}
effects:
  - {id: coulomb-friction, balance: slide, parameters: {tau_c: {value: 0.7, unit: N}}}
"""
STEP, FORCE, M, TAU = 0.1, 5.0, 2.0, 0.7


def by_hand(v0: float, M: float, tau: float, n: int) -> np.ndarray:
    """v(k·h) of M·v' = −F − τ·sign(v) from v0 > 0: at the rate of F + τ down to zero, then at that of F − τ."""
    t, stop = STEP * np.arange(n), v0 * M / (FORCE + tau)
    return np.where(t < stop, v0 - (FORCE + tau) / M * t, -(FORCE - tau) / M * (t - stop))


@pytest.fixture
def simulator(tmp_path):
    (tmp_path / "slide.yaml").write_text(SLIDE, encoding="utf-8")
    return Simulator(load_model(str(tmp_path / "slide.yaml")))


@pytest.mark.parametrize("v0", [0.9, 1.0, 1.13])
def test_a_reversal_within_a_step_is_exact(simulator, v0):
    n = 12
    experiment = Experiment(np.full((n, 1), -FORCE), np.full((n, 1), np.nan), np.zeros(1), STEP)
    names = ["M", "coulomb-friction@slide.tau_c", "initial:v"]
    run = simulator.run_vectors(experiment, np.array([v0]), simulator.p(), slopes=names, substeps=1)
    assert run.Y[:, 0] == pytest.approx(by_hand(v0, M, TAU, n), abs=1e-12)
    d = 1e-6
    numeric = [
        (by_hand(v0, M + d, TAU, n) - by_hand(v0, M - d, TAU, n)) / (2 * d),
        (by_hand(v0, M, TAU + d, n) - by_hand(v0, M, TAU - d, n)) / (2 * d),
        (by_hand(v0 + d, M, TAU, n) - by_hand(v0 - d, M, TAU, n)) / (2 * d),
    ]
    assert run.dY[:, 0] == pytest.approx(np.column_stack(numeric), abs=1e-8)
