"""Feasible sets hold the truth whenever the noise keeps its bound, and say so when nothing is feasible."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from residuum.identification.errors import BadInput, NotIdentifiable
from residuum.identification.linear_models.set_membership import feasible_set


@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    norm=st.sampled_from(["inf", "2"]),
    scale=st.sampled_from([1e-9, 1.0, 1e6]),
)
def test_the_truth_is_inside(seed, norm, scale):
    rng = np.random.default_rng(seed)
    Phi, beta = rng.normal(size=(60, 3)) * [1.0, 100.0, 0.01], rng.normal(size=3) * scale
    e = rng.uniform(-1, 1, size=60) * 0.1 * scale
    bound = 0.1 * scale if norm == "inf" else float(np.linalg.norm(e)) * 1.01
    found = feasible_set(Phi, Phi @ beta + e, bound, norm=norm)
    assert not found.empty
    slack = 1e-7 * (np.abs(beta) + found.radius)
    assert np.all(found.lower - slack <= beta) and np.all(beta <= found.upper + slack)
    assert np.all(np.abs(found.centre - beta) <= found.radius + slack)


def test_the_intervals_are_tight():
    """Corners of the polytope are reached: a brute-force search finds nothing outside and nearly all inside."""
    rng = np.random.default_rng(0)
    Phi = rng.normal(size=(20, 2))
    y = Phi @ [1.0, -2.0] + rng.uniform(-0.2, 0.2, size=20)
    found = feasible_set(Phi, y, 0.25)
    grid = found.centre + 1.2 * found.radius * rng.uniform(-1, 1, size=(400_000, 2))
    inside = grid[np.abs(y - grid @ Phi.T).max(axis=1) <= 0.25]
    assert np.all(inside >= found.lower - 1e-9) and np.all(inside <= found.upper + 1e-9)
    np.testing.assert_allclose(inside.max(axis=0), found.upper, atol=0.03 * found.radius.max())


@pytest.mark.parametrize("norm", ["inf", "2"])
def test_an_empty_set_names_the_smallest_bound(norm):
    rng = np.random.default_rng(1)
    Phi = rng.normal(size=(40, 2))
    y = Phi @ [1.0, -2.0] + rng.normal(size=40)
    empty = feasible_set(Phi, y, 0.01, norm=norm)
    assert empty.empty and np.isnan(empty.lower).all()
    assert not feasible_set(Phi, y, empty.smallest_bound * 1.0001, norm=norm).empty
    assert feasible_set(Phi, y, empty.smallest_bound * 0.999, norm=norm).empty


@pytest.mark.parametrize(
    ("Phi", "y", "bound", "norm", "error", "rule"),
    [
        (np.ones((3, 2)), np.ones(3), 0.1, "inf", NotIdentifiable, "not determined"),
        (np.ones((1, 2)), np.ones(1), 0.1, "inf", NotIdentifiable, "not determined"),
        (np.eye(3), np.ones(2), 0.1, "inf", BadInput, "shape"),
        (np.eye(3), np.ones(3), 0.0, "inf", BadInput, "positive"),
        (np.eye(3), np.ones(3), 0.1, "1", BadInput, "norm"),
        (np.eye(3), np.array([1.0, np.nan, 1.0]), 0.1, "2", BadInput, "missing"),
    ],
)
def test_refusals(Phi, y, bound, norm, error, rule):
    with pytest.raises(error, match=rule):
        feasible_set(Phi, y, bound, norm=norm)
