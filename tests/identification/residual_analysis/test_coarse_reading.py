"""What coarse steps hide of an output, and that fine ones and other records are left as they are."""

import numpy as np
import pytest

from residuum.identification.physics import Experiment
from residuum.identification.residual_analysis.noise import fit_noises
from residuum.identification.residual_analysis.structure_tests import reading_variances

RNG = np.random.default_rng(5)
SLOW = 20.0 * np.sin(np.arange(4000) / 300.0)


def experiment(*outputs):
    return Experiment(np.zeros((4000, 1)), np.stack(outputs, axis=1), np.zeros(1), 1e-3)


def test_the_variance_is_that_of_a_step_where_most_samples_repeat():
    coarse, fine = (
        2.0 * np.round(SLOW / 2.0),
        0.01 * np.round((SLOW + RNG.normal(scale=0.1, size=4000)) / 0.01),
    )
    standing, absent = np.where(SLOW > 0.0, SLOW, 0.0), np.full(4000, np.nan)
    found = reading_variances([experiment(coarse, fine, standing, absent)])
    assert found == pytest.approx([4.0 / 12.0, 0.0, 0.0, 0.0])


def test_a_reading_in_steps_is_not_taken_for_noise_that_is_integrated():
    stairs = 2.0 * np.round(SLOW / 2.0)
    residual = (stairs - 1.02 * SLOW)[:, None]
    swallowing = fit_noises([residual])[0]
    honest = fit_noises([residual], reading=reading_variances([experiment(stairs)]))[0]
    assert swallowing.innovation_variance < 0.01 * residual.var()
    assert honest.innovation_variance > 0.1 * residual.var()
