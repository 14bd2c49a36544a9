"""The scan over places: noise of any colour stands out nowhere, an error at one place of a travel does."""

import numpy as np
import pytest
from scipy.signal import lfilter

from residuum.identification.residual_analysis.locate import Axis
from residuum.identification.residual_analysis.structure_tests import local_structure


def _signals(rng, n):
    u = np.repeat(rng.standard_normal(n // 50 + 1), 50)[:n]
    x = lfilter([0.02], [1.0, -0.98], u)
    time = np.arange(n, dtype=float)
    return x, [
        Axis("u", "V", "input", u),
        Axis("x", "rad", "position", x),
        Axis("time", "s", "time", time),
    ]


def _noise(rng, n, rho):
    return lfilter([np.sqrt(1 - rho**2)], [1.0, -rho], rng.standard_normal(n + 1000))[1000:]


@pytest.mark.parametrize("rho", [0.0, 0.9, 0.99])
@pytest.mark.parametrize("n", [600, 6000])
def test_noise_of_any_colour_stands_out_nowhere(rho, n):
    rng = np.random.default_rng(11)
    found = []
    for _ in range(60):
        _, axes = _signals(rng, n)
        found.append(local_structure([_noise(rng, n, rho)], [axes]))
    assert sum(place is not None and place.present for place in found) == 0


def test_an_error_at_one_place_of_the_travel_is_found_there():
    rng = np.random.default_rng(12)
    x, axes = _signals(rng, 6000)
    low, high = np.quantile(x, [0.4, 0.45])
    error = _noise(rng, 6000, 0.5) + 6.0 * ((x > low) & (x < high))
    place = local_structure([error], [axes])
    assert place.present and place.axis == "x"
    assert place.low < high and place.high > low and place.times_noise > 3.0


def test_no_place_is_judged_where_most_samples_have_no_error_at_all_or_are_few():
    _, axes = _signals(np.random.default_rng(13), 400)
    assert local_structure([np.where(np.arange(400) > 300, 1.0, 0.0)], [axes]) is None
    assert local_structure([np.ones(50)], [[Axis("time", "s", "time", np.arange(50.0))]]) is None
