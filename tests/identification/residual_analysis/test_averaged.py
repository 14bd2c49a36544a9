"""Averaging thins residuals out, never the simulation: nothing about the physics changes."""

import numpy as np
import pytest
from scipy.signal import lfilter

from residuum.identification.discrepancy.fitting.structure_fits import fit_structure
from residuum.identification.physics import Experiment, block_means, load_model
from residuum.identification.residual_analysis.averaged import averaged


def lagged(n, held):
    """Exact first-order lag of 1 s driven by slow noise, sampled every 0.05 s."""
    u = np.convolve(np.random.default_rng(0).standard_normal(n + 60), np.hanning(61), "valid")[:n]
    pole = np.exp(-0.05)
    y = lfilter([0.0, 1 - pole], [1.0, -pole], u)
    return Experiment(u[:, None], y[:, None], np.array([0.0 if held else 1.0]), 0.05)


def test_blocks_follow_the_wanted_number_and_keep_the_samples():
    e = lagged(3000, held=True)
    (thinned,) = averaged([e], 1000)
    assert (thinned.n, thinned.sample_time, thinned.block) == (3000, 0.05, 3)
    means = thinned.means(thinned.Y)
    assert means.shape == (1000, 1)
    assert means.mean() == pytest.approx(e.Y.mean(), rel=1e-12)


def test_of_very_long_records_the_liveliest_stretch_is_taken():
    e = lagged(3000, held=True)
    quiet = Experiment(np.r_[0.0 * e.U, e.U], np.r_[0.0 * e.Y, e.Y], e.hold, e.sample_time)
    (taken,) = averaged([quiet], 1000)
    assert taken.n == 3000
    assert taken.Y.std() > 0.9 * e.Y.std()


def test_fast_physics_is_not_averaged_away_but_white_noise_is():
    e = lagged(3000, held=True)
    white = np.random.default_rng(1).standard_normal((3000, 1))
    driven = Experiment(white, 0.5 * white, e.hold, e.sample_time)
    noisy = Experiment(e.U, e.Y + 0.3 * white, e.hold, e.sample_time)
    resonant = Experiment(e.U, e.Y + lfilter([1.0], [1.0, 1.0, 0.9], white, axis=0), e.hold, e.sample_time)
    assert [averaged([each], 1000)[0].block for each in (driven, resonant, noisy)] == [1, 1, 3]


def test_a_missing_sample_makes_its_block_missing():
    y = np.arange(9.0)[:, None]
    y[4] = np.nan
    assert np.array_equal(block_means(y, 3), [[1.0], [np.nan], [7.0]], equal_nan=True)


def test_estimates_do_not_depend_on_the_blocks():
    """A mass that a force pushes, both estimated on every sample and on means of five: the same mass."""
    model = load_model("linear-axis")
    rng = np.random.default_rng(3)
    force = np.repeat(rng.uniform(-50.0, 50.0, 60), 20)[:, None]
    v = np.r_[0.0, np.cumsum(force[:-1, 0]) * 0.01 / 80.0]
    q = np.r_[0.0, np.cumsum(v[:-1] * 0.01 + 0.5 * force[:-1, 0] / 80.0 * 1e-4)]
    Y = np.column_stack([q, v]) + 1e-4 * rng.standard_normal((1200, 2))
    one = Experiment(force, Y[:, : len(model.outputs)], np.zeros(1), 0.01)
    five = Experiment(force, Y[:, : len(model.outputs)], np.zeros(1), 0.01, block=5)
    fits = [fit_structure(model, [e], [np.zeros(2)]) for e in (one, five)]
    assert all(fit.model.values["M"] == pytest.approx(80.0, rel=1e-3) for fit in fits)
    assert fits[0].rmse == pytest.approx(fits[1].rmse, rel=1e-3)
