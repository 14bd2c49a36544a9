"""The standard deviations of what was estimated are those of its estimates over many records."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import cont2discrete, lfilter

from residuum.identification.physics import Experiment, estimate, load_model, with_coloured_noise

RECORDS, N, SAMPLE_TIME = 200, 4000, 0.005
M, B, K, D = 1.0, 3.0, 400.0, 6.0


def error_free():
    """A mass on a spring, driven by held steps of random height: its exact discrete transfer function."""
    u = np.repeat(np.random.default_rng(3).standard_normal(N // 10), 10)
    b, a, _ = cont2discrete(([B], [M, D, K]), SAMPLE_TIME, method="zoh")
    return Experiment(u[:, None], lfilter(np.ravel(b), a, u)[:, None], np.zeros(1), SAMPLE_TIME)


@pytest.mark.parametrize(("freedom", "rho"), [(None, 0.0), (None, 0.8), (5.0, 0.8)])
def test_doubts_are_as_large_as_the_estimates_scatter(freedom, rho):
    """Normal and heavy-tailed noise, white and coloured: of the bands of 95 % as many hold the truth."""
    experiment, known = error_free(), {"b": B, "k": K, "d": D, "y_0": 0.0}
    model = load_model("oscillator").with_values(known)
    rng = np.random.default_rng(11)
    scores = []
    for _ in range(RECORDS):
        e = rng.standard_normal(N) if freedom is None else rng.standard_t(freedom, N)
        noise = lfilter([1.0], [1.0, -rho], 0.05 * np.std(experiment.Y) * e)
        records = [replace(experiment, Y=experiment.Y + noise[:, None])]
        found = with_coloured_noise(estimate(model, records, initial=[np.zeros(2)]), records)
        scores.append(
            [
                (found.model.values[n] - known[n]) / s
                for n, s in zip(found.parameters, found.std, strict=True)
            ]
        )
    scores = np.array(scores)
    assert np.sqrt(np.mean(scores**2)) == pytest.approx(1.0, abs=0.1)
    assert np.mean(np.abs(scores) < 1.96) == pytest.approx(0.95, abs=0.025)
