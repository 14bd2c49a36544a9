"""Structured residuals decouple what they must not see."""

import numpy as np
import pytest

from benchmarks.peers.structured_residuals import structured_residuals
from residuum.identification.errors import BadModel
from residuum.identification.linear_models.transfer_function import TransferFunction

TS = 0.1


def test_structured_residuals_decouple_exactly_and_isolate_each_fault():
    def path(gain, pole):
        return TransferFunction([gain], [1.0, -pole], TS)

    zero, one = TransferFunction([0.0], [1.0], TS), TransferFunction([1.0], [1.0], TS)
    u_column = [path(0.5, 0.8), path(0.3, 0.7), path(0.4, 0.9)]
    d_column = [path(1.0, 0.5), path(-0.6, 0.6), path(0.8, 0.4)]
    faults = {"y1": [one, zero, zero], "y2": [zero, one, zero], "y3": [zero, zero, one]}
    bank = structured_residuals([u_column], [d_column], faults, [0.1, 0.2, 0.1])
    assert len(bank) == 3
    rng = np.random.default_rng(6)
    u, d = rng.standard_normal(2000), 5 * rng.standard_normal(2000)
    y = np.column_stack(
        [G.simulate(u) + D.simulate(d) for G, D in zip(u_column, d_column, strict=True)]
    )
    for residual in bank:
        assert residual.leak < 1e-7 and residual.filter.is_stable
        assert np.abs(residual.filter.simulate(np.column_stack([y, u]))[0][200:]).max() < 1e-5
        noise = residual.filter.simulate(
            np.column_stack([[0.1, 0.2, 0.1] * rng.standard_normal((20_000, 3)), np.zeros(20_000)])
        )[0]
        assert np.std(noise[200:]) == pytest.approx(1.0, rel=0.03)
        for k, name in enumerate(faults):
            moved = y.copy()
            moved[1000:, k] += 1.0
            change = np.abs(residual.filter.simulate(np.column_stack([moved, u]))[0][1200:]).max()
            assert (change > 0.01) == (name not in residual.blind_to) == (residual.sees[name] > 0)
    with pytest.raises(BadModel, match="outputs are needed"):
        structured_residuals([u_column], [d_column, u_column], faults, [0.1, 0.2, 0.1])
