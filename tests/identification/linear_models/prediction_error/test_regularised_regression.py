"""Ridge, lasso, elastic net: closed form, optimality, calibrated posterior, sparse lags found, a penalty that pays, refusals."""

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.signal import lfilter

from residuum.identification.errors import BadInput, NotIdentifiable
from residuum.identification.linear_models.prediction_error import STRUCTURES, Orders, identify
from residuum.identification.linear_models.prediction_error.data import signals
from residuum.identification.linear_models.prediction_error.regularised_regression import (
    _splits,
    identify_regularised,
)
from residuum.identification.record import Record


def driven(g, n, noise, seed, level=0.0):
    rng = np.random.default_rng(seed)
    u = rng.normal(size=n)
    return Record(
        {"u": u, "y": lfilter([0, *g], [1], u) + noise * rng.normal(size=n) + level},
        {"u": "V", "y": "m"},
        0.1,
    )


def test_ridge_is_its_closed_form():
    record = driven([1.0, 0.5, 0.2], 120, 0.3, 0, level=4.0)
    model = identify_regularised([record], "u", "y", orders=Orders(na=1, nb=4), strength=3.0)
    u, y = ((record[c] - record[c].mean()) / record[c].std() for c in "uy")
    phi = np.stack([-y[3:-1], u[3:-1], u[2:-2], u[1:-3], u[:-4]], axis=1)
    phi, target = phi - phi.mean(axis=0), y[4:] - y[4:].mean()
    theta = np.linalg.solve(phi.T @ phi + 3.0 * np.eye(5), phi.T @ target)
    np.testing.assert_allclose(model.denominator[1], theta[0], rtol=1e-8)
    np.testing.assert_allclose(
        model.numerator[:4], theta[1:] * record["y"].std() / record["u"].std(), rtol=1e-8
    )
    freedom = np.trace(phi @ np.linalg.solve(phi.T @ phi + 3.0 * np.eye(5), phi.T))
    assert model.hyper_parameters["degrees_of_freedom"] == pytest.approx(freedom)
    assert model.offset == pytest.approx(4.0, abs=0.2)


def test_posterior_of_the_ridge_covers_responses_of_its_prior():
    """60 coefficients from 50 rows: half of the spread is the prior's, and 95 % of the truth must lie within 1.96 std."""
    inside = []
    for seed in range(25):
        g = np.random.default_rng([seed, 1]).normal(size=60)
        record = driven(g, 110, 1.0, seed)
        strength = 1.0 / np.mean(record["u"] ** 2)  # σ²/var g for an input of unit power
        model = identify_regularised(
            [record], "u", "y", orders=Orders(nb=60), strength=strength, offset=False
        )
        std = np.sqrt(np.diag(model.covariance) / model.noise_variance)  # with the true σ² = 1
        inside.append(np.abs(model.impulse_response - g[: model.order]) < 1.96 * std)
    assert np.mean(np.concatenate(inside)) == pytest.approx(0.95, abs=0.018)


def test_cross_validated_ridge_beats_least_squares_on_short_noisy_records():
    """60 coefficients of std 0.1 from 260 rows with σ = 2.8: the best ridge halves the error, a blind one would not."""
    errors = []
    for seed in range(4):
        g = 0.1 * np.random.default_rng([seed, 2]).normal(size=60)
        record = driven(g, 320, 2.8, seed)
        ridge = identify_regularised([record], "u", "y", orders=Orders(nb=60))
        plain = identify(STRUCTURES["fir"], [record], "u", "y", order=60)
        errors.append([np.sum((m.numerator[:60] - g) ** 2) for m in (ridge, plain)])
    assert np.divide(*np.sum(errors, axis=0)) < 0.4


def test_lasso_finds_the_few_lags_that_matter():
    g = np.zeros(40)
    g[[4, 17]] = 1.0, -0.6
    model = identify_regularised(
        [driven(g, 400, 0.2, 1)], "u", "y", orders=Orders(nb=40), penalty="lasso"
    )
    order = np.argsort(-np.abs(model.impulse_response))
    assert set(order[:2]) == {4, 17}
    assert np.abs(model.impulse_response[order[2:]]).max() < 0.05
    dropped = model.numerator[:40] == 0.0
    assert dropped.sum() > 15 and np.all(np.diag(model.parameter_covariance)[:40][dropped] == 0.0)
    assert any("known beforehand" in text for text in model.warnings)


def test_elastic_net_is_the_minimum_that_a_search_without_corners_finds():
    """θ = p − q with p, q ≥ 0 makes the penalty smooth: a bounded quasi-Newton search knows nothing of coordinate descent."""
    record, strength, mix = driven([1.0, 0.9, 0.0, 0.3], 200, 0.5, 3, level=2.0), 0.05, 0.4
    model = identify_regularised(
        [record], "u", "y", orders=Orders(nb=8), penalty="elastic-net", strength=strength, mix=mix
    )
    u, y = ((record[c] - record[c].mean()) / record[c].std() for c in "uy")
    phi = np.stack([u[7 - k : len(u) - 1 - k] for k in range(8)], axis=1)
    phi, target = phi - phi.mean(axis=0), y[8:] - y[8:].mean()

    def cost(both):
        theta = both[:8] - both[8:]
        e = target - phi @ theta
        gradient = -phi.T @ e / len(target) + strength * (1 - mix) * theta
        value = e @ e / (2 * len(target)) + strength * (
            mix * both.sum() + (1 - mix) / 2 * theta @ theta
        )
        return value, np.r_[gradient + strength * mix, -gradient + strength * mix]

    found = minimize(
        cost,
        np.full(16, 0.1),
        jac=True,
        bounds=[(0, None)] * 16,
        options={"ftol": 1e-15, "gtol": 1e-10},
    )
    theta = (found.x[:8] - found.x[8:]) * record["y"].std() / record["u"].std()
    np.testing.assert_allclose(model.numerator[:8], theta, atol=2e-4)
    assert model.hyper_parameters["mix"] == mix


def test_elastic_net_keeps_neighbours_together_that_a_slow_input_hardly_tells_apart():
    """Eight lags of equal weight under an input that hardly changes: the lasso keeps few of them, and errs more."""
    g = np.zeros(30)
    g[8:16] = 0.25
    errors, kept = {}, {}
    for penalty in ("lasso", "elastic-net"):
        found = []
        for seed in range(5):
            rng = np.random.default_rng([seed, 4])
            u = lfilter([1.0], [1.0, -0.98], rng.normal(size=500))
            y = lfilter([0, *g], [1], u)
            record = Record(
                {"u": u, "y": y + y.std() * rng.normal(size=500)}, {"u": "", "y": ""}, 1.0
            )
            found.append(
                identify_regularised(
                    [record], "u", "y", orders=Orders(nb=30), penalty=penalty
                ).numerator[:30]
            )
        errors[penalty] = np.mean([np.sum((one - g) ** 2) for one in found])
        kept[penalty] = np.mean([np.count_nonzero(one[8:16]) for one in found])
    assert errors["elastic-net"] < 0.7 * errors["lasso"]
    assert kept["elastic-net"] > kept["lasso"] + 2


def test_no_row_of_the_fit_shares_a_sample_with_the_held_out_block():
    record = driven([1.0], 100, 0.1, 0)
    data, orders = signals([record, record], "u", "y", offset=True), Orders(na=3, nb=5)
    reach = orders.memory
    for training, held_out in _splits(data, orders, 4):
        used = {
            first + lag
            for first in training + training // (100 - reach) * reach
            for lag in range(reach + 1)
        }
        explained = set(held_out + held_out // (100 - reach) * reach + reach)
        assert not used & explained
        assert len(explained) == len(held_out) and len(training) > 100


def test_an_input_without_effect_is_said_to_be_one():
    rng = np.random.default_rng(0)
    record = Record({"u": rng.normal(size=300), "y": rng.normal(size=300)}, {"u": "", "y": ""}, 1.0)
    model = identify_regularised([record], "u", "y", orders=Orders(nb=20), penalty="lasso")
    assert np.abs(model.impulse_response).max() < 0.1


@pytest.mark.parametrize(
    ("change", "error", "rule"),
    [
        (
            {"penalty": "elastic"},
            BadInput,
            "penalty 'elastic': did you mean 'elastic-net'. must be one of ridge, lasso, elastic-net",
        ),
        ({"orders": Orders(nb=2, nf=2)}, BadInput, "must have B, may have A, nothing else"),
        ({"mix": 0.5}, BadInput, "mix 0.5: belongs to the elastic net"),
        ({"penalty": "elastic-net", "mix": 0.0}, BadInput, "must lie between 0 and 1"),
        ({"strength": 0.0}, BadInput, "strength 0.0: must be a positive number"),
        (
            {"orders": Orders(nb=120), "strength": 1.0},
            NotIdentifiable,
            "needs 130 samples, ten beyond",
        ),
        ({"folds": 50}, NotIdentifiable, "50 blocks"),
    ],
)
def test_refusals(change, error, rule):
    with pytest.raises(error, match=rule):
        identify_regularised(
            [driven([1.0], 110, 0.1, 0)], "u", "y", **{"orders": Orders(nb=3), **change}
        )
