"""Set membership as a method: intervals of an independent computation, the truth inside them, refusals that say what helps."""

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.spatial import HalfspaceIntersection

from residuum.identification.errors import BadInput, NotIdentifiable
from residuum.identification.linear_models.set_membership import identify_set_membership
from residuum.identification.record import Record

G = np.array([0.8, -0.3])


def bounded(seed, n=200, bound=0.1, level=0.0):
    rng = np.random.default_rng(seed)
    u = rng.standard_normal(n)
    y = lfilter(np.r_[0.0, G], [1.0], u) + level + rng.uniform(-bound, bound, n)
    return Record({"u": u, "y": y}, {"u": "V", "y": "mm"}, 1.0)


def test_intervals_are_those_of_the_polytopes_corners():
    record = bounded(0)
    model = identify_set_membership([record], "u", "y", order=2, noise_bound=0.1, offset=False)
    u, y = record["u"], record["y"]
    Phi, target = np.stack([u[1:-1], u[:-2]], axis=1), y[2:]
    halves = np.r_[np.c_[Phi, -target - 0.1], np.c_[-Phi, target - 0.1]]
    corners = HalfspaceIntersection(halves, G).intersections
    np.testing.assert_allclose(
        model.impulse_response, (corners.max(axis=0) + corners.min(axis=0)) / 2, atol=1e-7
    )
    np.testing.assert_allclose(
        np.sqrt(3) * model.std, (corners.max(axis=0) - corners.min(axis=0)) / 2, atol=1e-7
    )


@pytest.mark.parametrize("seed", range(10))
def test_the_truth_is_inside_whatever_the_noise_does_within_its_bound(seed):
    record = bounded(seed, level=7.0)
    model = identify_set_membership([record], "u", "y", order=6, noise_bound=0.1)
    assert np.all(
        np.abs(model.impulse_response - np.r_[G, np.zeros(4)]) <= np.sqrt(3) * model.std + 1e-9
    )
    assert model.offset == pytest.approx(7.0, abs=0.05)
    assert model.hyper_parameters["smallest_noise_bound"] <= 0.1


def test_missing_samples_and_several_records_only_take_rows_away():
    whole, holed = bounded(1), bounded(2)
    u, y = holed["u"].copy(), holed["y"].copy()
    u[50], y[120] = np.nan, np.nan
    both = [whole, Record({"u": u, "y": y}, {"u": "V", "y": "mm"}, 1.0)]
    model = identify_set_membership(both, "u", "y", order=3, noise_bound=0.1)
    assert model.provenance["n"] == 2 * (200 - 3) - 3 - 1
    assert np.all(np.abs(model.impulse_response[:2] - G) <= np.sqrt(3) * model.std[:2] + 1e-9)


def test_refusals_say_what_would_help():
    with pytest.raises(
        NotIdentifiable,
        match=r"at most 0.01 mm no impulse response of 4 .* the smallest bound that leaves one is 0.0",
    ):
        identify_set_membership([bounded(0)], "u", "y", order=4, noise_bound=0.01)
    with pytest.raises(BadInput, match="must be 1 to 60"):
        identify_set_membership([bounded(0)], "u", "y", order=61)
    with pytest.raises(NotIdentifiable, match="record longer, or take a smaller order"):
        identify_set_membership([bounded(0, n=40)], "u", "y", order=20)
    with pytest.raises(BadInput, match="bound: is -1"):
        identify_set_membership([bounded(0)], "u", "y", order=4, noise_bound=-1)
    slow = lfilter([0.0, 1.0], [1.0, -0.9], bounded(0)["u"])
    cut = identify_set_membership(
        [Record({"u": bounded(0)["u"], "y": slow}, {"u": "V", "y": "mm"}, 1.0)], "u", "y", order=3
    )
    assert any("has not decayed within 3 lags" in text for text in cut.warnings)
