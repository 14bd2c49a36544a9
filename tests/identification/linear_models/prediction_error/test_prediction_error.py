"""Prediction error methods: truth recovered at the maximum likelihood, honest covariance, stable predictors, refusals."""

import numpy as np
import pytest
from scipy.signal import lfilter

from residuum.identification.errors import BadRecord, NotIdentifiable
from residuum.identification.linear_models.identified_model_file import (
    load_identified,
    save_identified,
)
from residuum.identification.linear_models.prediction_error import STRUCTURES, Orders, identify
from residuum.identification.linear_models.prediction_error.criterion import Criterion, reflected
from residuum.identification.linear_models.prediction_error.data import signals
from residuum.identification.record import Record

TRUE = {
    "arx": {"a": [1, -1.2, 0.5], "b": [0.8, -0.3], "f": [1], "c": [1], "d": [1]},
    "armax": {"a": [1, -1.2, 0.5], "b": [0.8, -0.3], "f": [1], "c": [1, 0.6], "d": [1]},
    "oe": {"a": [1], "b": [0.8, -0.3], "f": [1, -1.2, 0.5], "c": [1], "d": [1]},
    "bj": {"a": [1], "b": [0.8, -0.3], "f": [1, -1.2, 0.5], "c": [1, 0.6], "d": [1, -0.8]},
}
ORDERS = {
    "arx": Orders(na=2, nb=2),
    "armax": Orders(na=2, nb=2, nc=1),
    "oe": Orders(nb=2, nf=2),
    "bj": Orders(nb=2, nf=2, nc=1, nd=1),
}


def simulated(structure, seed, n=2000, noise=0.3, level=0.0):
    true = TRUE[structure]
    rng = np.random.default_rng(seed)
    u, e = rng.normal(size=n + 200), noise * rng.normal(size=n + 200)
    w = lfilter([0, *true["b"]], np.convolve(true["a"], true["f"]), u)
    y = w + lfilter(true["c"], np.convolve(true["d"], true["a"]), e)
    return Record({"u": u[200:], "y": y[200:] + level}, {"u": "V", "y": "m"}, 0.1)


def truth(structure):
    """[numerator, denominator₁…] of the plant in descending powers of z."""
    true = TRUE[structure]
    return np.r_[true["b"], np.convolve(true["a"], true["f"])[1:]]


@pytest.mark.parametrize("structure", TRUE)
def test_truth_is_within_its_own_uncertainty(structure):
    model = identify(
        STRUCTURES[structure], [simulated(structure, 1)], "u", "y", orders=ORDERS[structure]
    )
    error = np.r_[model.numerator, model.denominator[1:]] - truth(structure)
    std = np.sqrt(np.diag(model.parameter_covariance))
    assert np.all(np.abs(error) < 4 * std) and np.all(std < 0.05)
    assert model.noise_variance == pytest.approx(0.09, rel=0.1)


@pytest.mark.parametrize("structure", TRUE)
def test_ellipses_cover_the_truth_at_their_rate(structure):
    """The 95 % ellipsoid (1.107) over repetitions; 80 draws make 90 % … 99 % the range of chance."""
    inside = 0
    for seed in range(80):
        model = identify(
            STRUCTURES[structure],
            [simulated(structure, seed, n=800)],
            "u",
            "y",
            orders=ORDERS[structure],
        )
        error = np.r_[model.numerator, model.denominator[1:]] - truth(structure)
        inside += error @ np.linalg.solve(model.parameter_covariance, error) < 9.488
    assert 0.88 <= inside / 80 <= 1.0


@pytest.mark.parametrize("structure", ["armax", "oe", "bj"])
def test_gradient_is_that_of_the_innovations(structure):
    data = signals(
        [simulated(structure, 2, n=60), simulated(structure, 3, n=50)], "u", "y", offset=True
    )
    criterion = Criterion(data, Orders(1, 2, 2, 1, 1) if structure == "bj" else ORDERS[structure])
    rng = np.random.default_rng(0)
    x = 0.2 * rng.normal(size=criterion.size)
    normal = criterion.normal(x)
    e0 = np.concatenate(criterion.innovations(x))
    numeric = np.array(
        [
            -(np.concatenate(criterion.innovations(x + h)) - e0) / 1e-7
            for h in 1e-7 * np.eye(criterion.size)
        ]
    )
    np.testing.assert_allclose(normal.gradient, numeric @ e0, rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(normal.gram, numeric @ numeric.T, rtol=1e-3, atol=1e-3)


def test_output_error_order_is_found_and_is_the_maximum_likelihood():
    """The fourth-order benchmark (2.38) of the source, SNR 25."""
    b, f = [0, 0, 0, 0.28261, 0.50666], [1, -1.41833, 1.58939, -1.31608, 0.88642]
    rng = np.random.default_rng(7)
    u = rng.normal(size=6000)
    y0 = lfilter(b, f, u)
    y = y0 + np.std(y0) / 5 * rng.normal(size=6000)
    record = Record({"u": u[1000:], "y": y[1000:]}, {"u": "", "y": ""}, 0.01)
    model = identify(STRUCTURES["oe"], [record], "u", "y")
    assert model.provenance["orders"].startswith("nb = 4, nf = 4")
    assert model.transfer_function().is_stable
    pulse = np.r_[1.0, np.zeros(299)]
    g0, g = lfilter(b, f, pulse), model.transfer_function().simulate(pulse)
    assert 100 * (1 - np.linalg.norm(g - g0) / np.linalg.norm(g0)) > 99.3


def test_records_are_experiments_of_their_own():
    parts = [simulated("oe", seed, n=700, level=5.0) for seed in range(3)]
    model = identify(STRUCTURES["oe"], parts, "u", "y", orders=ORDERS["oe"])
    np.testing.assert_allclose(
        np.r_[model.numerator, model.denominator[1:]], truth("oe"), atol=0.05
    )
    assert model.offset == pytest.approx(5.0, abs=0.1)


def test_units_scale_the_model():
    record = simulated("oe", 4)
    scaled = Record({"u": record["u"] * 1e-6, "y": record["y"] * 1e5}, {"u": "V", "y": "m"}, 0.1)
    plain, big = (
        identify(STRUCTURES["oe"], [r], "u", "y", orders=ORDERS["oe"]) for r in (record, scaled)
    )
    np.testing.assert_allclose(big.numerator, plain.numerator * 1e11, rtol=1e-6)
    np.testing.assert_allclose(big.denominator, plain.denominator, rtol=1e-6)


def test_a_model_that_cannot_be_simulated_says_so():
    """A loop around an unstable plant: the prediction is stable, the plant is not."""
    rng = np.random.default_rng(0)
    u, y = np.zeros(600), np.zeros(600)
    for t in range(1, 600):
        y[t] = 1.1 * y[t - 1] + u[t - 1] + 0.3 * rng.normal()
        u[t] = rng.normal() - 0.5 * y[t]
    model = identify(
        STRUCTURES["arx"], [Record({"u": u, "y": y}, {"u": "", "y": ""}, 1.0)], "u", "y", order=1
    )
    assert model.denominator[1] == pytest.approx(-1.1, abs=0.03)
    assert any("outside the unit circle" in text for text in model.warnings)


def test_time_series_and_finite_response():
    rng = np.random.default_rng(0)
    v = lfilter([1], [1, -1.6, 0.8], rng.normal(size=3000))
    model = identify(STRUCTURES["ar"], [Record({"v": v}, {"v": "V"}, 1.0)], None, "v", order=2)
    np.testing.assert_allclose(model.noise_denominator[1:], [-1.6, 0.8], atol=0.05)
    fir = identify(STRUCTURES["fir"], [simulated("oe", 5)], "u", "y", order=25)
    expected = lfilter(TRUE["oe"]["b"], TRUE["oe"]["f"], np.r_[1.0, np.zeros(24)])
    np.testing.assert_allclose(fir.impulse_response, expected, atol=0.06)


def test_reflection_keeps_the_modulus():
    p = np.array([1.0, -3.2, 2.9, -0.6])
    w = np.exp(1j * np.linspace(0, 3, 7))
    ratio = np.abs(np.polyval(p, w) / np.polyval(reflected(p), w))
    np.testing.assert_allclose(ratio, ratio[0], rtol=1e-9)
    assert np.all(np.abs(np.roots(reflected(p))) < 1)


def altered(name, change):
    record = simulated("arx", 0, n=300)
    signal = np.array(record[name])
    return Record({**record.channels, name: change(signal)}, record.units, 0.1)


def a_gap(x):
    x[17] = np.nan
    return x


@pytest.mark.parametrize(
    ("records", "order", "error", "rule"),
    [
        ([], 2, BadRecord, "no record"),
        (
            [simulated("arx", 0, n=15)],
            4,
            NotIdentifiable,
            "15 samples; 8 parameters need at least 40",
        ),
        ([altered("y", a_gap)], 2, BadRecord, "channel 'y': sample 17 is missing"),
        ([altered("u", np.zeros_like)], 2, NotIdentifiable, "'u': does not move"),
        (
            [altered("u", lambda u: np.sin(0.3 * np.arange(u.size)))],
            4,
            NotIdentifiable,
            r"excites [23] parameters",
        ),
    ],
)
def test_refusals(records, order, error, rule):
    with pytest.raises(error, match=rule):
        identify(STRUCTURES["arx"], records, "u", "y", order=order)


def test_a_model_that_hardly_knows_its_parameters_has_a_covariance_still(tmp_path):
    """A drift is no output error model: its poles lie at one, their gradients grow over 400 lags, and rounding with them."""
    rng = np.random.default_rng(0)
    u = np.cumsum(0.1 * rng.normal(size=1500))
    record = Record({"u": u, "y": np.cumsum(u) + rng.normal(size=1500)}, {"u": "V", "y": "m"}, 1.0)
    model = identify(STRUCTURES["oe"], [record], "u", "y", order=3)
    save_identified(model, tmp_path / "m.json")
    np.testing.assert_array_equal(load_identified(tmp_path / "m.json").covariance, model.covariance)
    np.testing.assert_array_equal(model.covariance, model.covariance.T)
    np.testing.assert_array_equal(model.parameter_covariance, model.parameter_covariance.T)


def test_a_channel_without_a_sample_is_not_sent_to_another_method():
    record = simulated("arx", 0, n=200)
    empty = Record({"u": record["u"], "y": np.full(200, np.nan)}, {"u": "V", "y": "m"}, 0.1)
    with pytest.raises(BadRecord, match="'y': has no sample; take a channel that was recorded"):
        identify(STRUCTURES["arx"], [empty], "u", "y", order=1)
