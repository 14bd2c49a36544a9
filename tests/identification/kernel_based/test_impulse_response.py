import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import optimize, signal

from residuum.identification.errors import BadInput, BadRecord, NotIdentifiable
from residuum.identification.kernel_based.delay import estimate_delay
from residuum.identification.kernel_based.impulse_response import (
    identify_impulse_response,
    maximise,
    scaled_sums,
)
from residuum.identification.kernel_based.kernels import KERNELS
from residuum.identification.kernel_based.lagged_data import lagged_data
from residuum.identification.kernel_based.marginal_likelihood import marginal_likelihood
from residuum.identification.linear_models.uncertainty import design_uncertainty_weight
from residuum.identification.record import Record

# (2.38)
NUMERATOR, DENOMINATOR = ([0, 0, 0, 0.28261, 0.50666], [1, -1.41833, 1.58939, -1.31608, 0.88642])
UNITS = {"u": "V", "y": "mm"}


def true_response(m):
    return signal.lfilter(NUMERATOR, DENOMINATOR, np.eye(1, m + 1)[0])[1:]


def resonant_record(n, seed, signal_to_noise=25.0):
    rng = np.random.default_rng(seed)
    u = rng.standard_normal(n + 1000)
    y = signal.lfilter(NUMERATOR, DENOMINATOR, u)
    y += rng.standard_normal(n + 1000) * math.sqrt(y.var() / signal_to_noise)
    return Record({"u": u[1000:], "y": y[1000:]}, UNITS, 0.01)


def first_order_record(n=400, seed=0, noise=0.1, level=0.0):
    rng = np.random.default_rng(seed)
    u = rng.standard_normal(n)
    y = signal.lfilter([0, 1.0], [1, -0.7], u) + noise * rng.standard_normal(n) + level
    return Record({"u": u, "y": y}, UNITS, 0.5)


def fit_percent(estimate, truth):
    return 100 * (1 - np.linalg.norm(estimate - truth) / np.linalg.norm(truth - truth.mean()))


@pytest.mark.parametrize(
    ("kernel", "least"), [("tc", 96.8), ("dc", 96.8), ("ss", 97.0), ("di", 96.7)]
)
def test_two_resonances_are_found(kernel, least):
    fits = [
        fit_percent(
            identify_impulse_response(
                resonant_record(5000, seed), "u", "y", kernel=kernel
            ).impulse_response,
            true_response(100),
        )
        for seed in range(4)
    ]
    assert np.median(fits) >= 97.0
    assert min(fits) >= least


@pytest.mark.parametrize("kernel", KERNELS)
def test_optimum_is_that_of_the_textbook_likelihood(kernel):
    rng = np.random.default_rng(5)
    drive = rng.standard_normal(60)
    swing = signal.lfilter([0, 1.0, -0.3], [1, -0.9, 0.6], drive) + 0.1 * rng.standard_normal(60)
    record = Record({"u": drive, "y": swing}, UNITS, 1.0)
    model = identify_impulse_response(
        record, "u", "y", kernel=kernel, order=8, offset=False, tail=0
    )
    u, y = record["u"], record["y"]
    Phi, target = np.array([[u[t - 1 - i] for i in range(8)] for t in range(8, 60)]), y[8:]

    def textbook(x):
        eta = [item.value(v) for item, v in zip(KERNELS[kernel].parameters, x, strict=False)]
        Z = math.exp(x[-2]) * Phi @ KERNELS[kernel].matrix(8, eta) @ Phi.T + math.exp(
            x[-1]
        ) * np.eye(52)
        return 0.5 * (target @ np.linalg.solve(Z, target) + np.linalg.slogdet(2 * math.pi * Z)[1])

    names = [item.name for item in KERNELS[kernel].parameters]
    found = [
        item.free(model.hyper_parameters[name])
        for item, name in zip(KERNELS[kernel].parameters, names, strict=True)
    ]
    x = [*found, math.log(model.hyper_parameters["scale"]), math.log(model.noise_variance)]
    assert model.negative_log_likelihood == pytest.approx(textbook(x), rel=1e-7)
    best = optimize.minimize(
        textbook, x, method="Nelder-Mead", options={"xatol": 1e-7, "fatol": 1e-10, "maxiter": 4000}
    )
    assert model.negative_log_likelihood == pytest.approx(best.fun, rel=1e-6)


@pytest.mark.parametrize("setting", ["marginal", "least-squares", 0.01])
def test_every_way_to_the_noise_variance(setting):
    model = identify_impulse_response(
        first_order_record(2000), "u", "y", order=30, noise_variance=setting
    )
    assert model.noise_variance == pytest.approx(0.01, rel=0.1)
    np.testing.assert_allclose(model.impulse_response[:4], 0.7 ** np.arange(4), atol=0.02)


def test_levels_are_eliminated_and_reported():
    flat = identify_impulse_response(first_order_record(), "u", "y", order=20)
    lifted = identify_impulse_response(first_order_record(level=1e4), "u", "y", order=20)
    np.testing.assert_allclose(lifted.impulse_response, flat.impulse_response, atol=1e-7)
    assert lifted.offset - flat.offset == pytest.approx(1e4, rel=1e-9)


def test_a_gap_costs_its_rows_only():
    record = first_order_record(600)
    u, y = np.array(record["u"]), np.array(record["y"])
    u[100], y[300:320] = np.nan, np.nan
    model = identify_impulse_response(
        Record({"u": u, "y": y}, UNITS, 0.5), "u", "y", order=20, tail=0
    )
    assert model.provenance["n"] == 600 - 20 - 20 - 20
    np.testing.assert_allclose(model.impulse_response[:3], [1, 0.7, 0.49], atol=0.05)


def test_records_join_without_a_row_across_the_seam():
    whole = first_order_record(900)
    parts = [whole.window(0, 400), whole.window(400, 900)]
    model = identify_impulse_response(parts, "u", "y", order=20, tail=0)
    assert model.provenance["n"] == 900 - 2 * 20
    swapped = identify_impulse_response(parts[::-1], "u", "y", order=20, tail=0)
    np.testing.assert_allclose(model.impulse_response, swapped.impulse_response, atol=1e-6)


def test_delay_is_found_and_certain():
    rng = np.random.default_rng(4)
    u = rng.standard_normal(500)
    y = signal.lfilter([0] * 7 + [0.5], [1, -0.8], u) + 0.2 * rng.standard_normal(500)
    estimate = estimate_delay(Record({"u": u, "y": y}, UNITS, 0.1), "u", "y", order=30, longest=15)
    assert estimate.delay == 7
    assert estimate.probability[7] > 0.95


@pytest.mark.parametrize("length", [1, 3, 280])
def test_of_a_gentle_beginning_that_one_pulse_or_step_tells_no_lag_is_left_out(length):
    b, a, _ = signal.cont2discrete(([1.0], [25.0, 10.0, 1.0]), 1.0, method="zoh")
    u = np.r_[np.zeros(20), np.ones(length), np.zeros(280)][:300]
    y = signal.lfilter(b.ravel(), a, u) + 0.02 * np.random.default_rng(33).standard_normal(300)
    assert estimate_delay(Record({"u": u, "y": y}, UNITS, 1.0), "u", "y").delay <= 1


class NoNumberBeyond:
    """A likelihood of one kernel that is no number for a signal-to-noise ratio κ above e."""

    def __init__(self, likelihood):
        self.likelihood = likelihood

    def __getattr__(self, name):
        return getattr(self.likelihood, name)

    def value(self, x):
        return np.nan if x[-1] > 1.0 else self.likelihood.value(x)

    def value_and_gradient(self, x):
        return (
            (np.nan, np.full(len(x), np.nan))
            if x[-1] > 1.0
            else self.likelihood.value_and_gradient(x)
        )


def test_the_search_neither_begins_nor_goes_where_the_likelihood_is_no_number():
    record = resonant_record(200, 0)
    sums = scaled_sums(lagged_data(record, ["u"], "y", 20, 1, offset=True).sums, 1)[0]
    likelihood = marginal_likelihood(sums, KERNELS["tc"])
    x, value = maximise(NoNumberBeyond(likelihood), np.array([0.0, 5.0]))
    assert np.isfinite(value) and np.all(np.isfinite(x)) and x[-1] <= 1.0
    nowhere = NoNumberBeyond(likelihood)
    nowhere.value = lambda x: np.nan
    with pytest.raises(NotIdentifiable, match=r"no number at any start.*moves"):
        maximise(nowhere)


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 10**6),
    n=st.integers(40, 400),
    order=st.integers(1, 60),
    pole=st.floats(-0.95, 0.999),
    log_scale=st.floats(-12, 12),
    noise=st.sampled_from([0.0, 1e-6, 0.1, 10.0]),
    kernel=st.sampled_from(list(KERNELS)),
    drive=st.sampled_from(["white", "sine", "steps", "constant", "walk"]),
)
def test_any_system_gives_a_finite_proper_posterior_or_a_refusal(
    seed, n, order, pole, log_scale, noise, kernel, drive
):
    rng = np.random.default_rng(seed)
    drives = {
        "white": rng.standard_normal(n),
        "sine": np.sin(0.3 * np.arange(n)),
        "steps": np.repeat(rng.choice([-1.0, 1.0], n), 9)[:n],
        "constant": np.ones(n),
        "walk": rng.standard_normal(n).cumsum(),
    }
    u = drives[drive] * 10.0**log_scale
    y = signal.lfilter([0, 1.0], [1, -pole], u)
    y = y + noise * (y.std() + 1e-12) * rng.standard_normal(n)
    try:
        model = identify_impulse_response(
            Record({"u": u, "y": y}, UNITS, 1.0), "u", "y", kernel=kernel, order=order
        )
    except NotIdentifiable:
        return
    assert np.isfinite(model.negative_log_likelihood)
    eigenvalues = np.linalg.eigvalsh(model.covariance)
    assert eigenvalues[0] >= -1e-9 * max(eigenvalues[-1], 1e-300)
    assert model.noise_variance >= 0


@pytest.mark.parametrize(
    ("u", "match"),
    [
        (np.full(200, 3.3), "channel 'u' is constant.*order 0"),
        (np.zeros(200), "order 0"),
        (np.full(200, np.nan), "'u' has no sample"),
    ],
)
def test_an_input_that_does_not_excite_is_refused(u, match):
    y = np.random.default_rng(0).standard_normal(200)
    with pytest.raises(NotIdentifiable, match=match):
        identify_impulse_response(Record({"u": u, "y": y}, UNITS, 1.0), "u", "y", order=5)


def test_a_sine_is_said_to_excite_two_coefficients_only():
    u = np.sin(0.4 * np.arange(500))
    y = signal.lfilter([0, 1], [1, -0.5], u) + 0.01 * np.random.default_rng(0).standard_normal(500)
    model = identify_impulse_response(
        Record({"u": u, "y": y}, UNITS, 1.0), "u", "y", order=30, tail=0
    )
    assert any("order 2 only; 30 coefficients" in warning for warning in model.warnings)


def test_results_that_need_care_carry_a_warning():
    rng = np.random.default_rng(3)
    u, noise = rng.standard_normal(300), rng.standard_normal(300)
    unrelated = identify_impulse_response(
        Record({"u": u, "y": noise}, UNITS, 1.0), "u", "y", order=20
    )
    assert any("no significant response" in warning for warning in unrelated.warnings)
    integrator = Record({"u": u, "y": np.cumsum(u) + 0.01 * noise}, UNITS, 1.0)
    assert any(
        "not decayed" in warning
        for warning in identify_impulse_response(integrator, "u", "y", order=20).warnings
    )


def test_tiny_amplitudes_scale_out():
    record = first_order_record()
    tiny = Record({"u": 1e-12 * record["u"], "y": 1e-12 * record["y"]}, UNITS, 0.5)
    normal = identify_impulse_response(record, "u", "y", order=20)
    np.testing.assert_allclose(
        identify_impulse_response(tiny, "u", "y", order=20).impulse_response,
        normal.impulse_response,
        rtol=1e-6,
        atol=1e-9,
    )


def test_bad_requests_are_refused_with_the_rule():
    record = first_order_record(50)
    for options, match in [
        ({"kernel": "rbf"}, "known are tc, dc, ss, di"),
        ({"order": 0}, "order 0: must lie between"),
        ({"delay": -1}, "delay -1"),
        ({"noise_variance": -2.0}, "noise variance -2.0: must be positive"),
        ({"noise_variance": "guess"}, "must be a number or one of marginal"),
        ({"order": 50}, "needs 51 samples in a row|complete rows"),
        ({"order": 40, "noise_variance": "least-squares"}, "more rows than coefficients"),
    ]:
        with pytest.raises(BadInput, match=match):
            identify_impulse_response(record, "u", "y", **options)
    with pytest.raises(BadRecord, match=r"sample time 1 s, others have 0\.5"):
        identify_impulse_response([record, Record(record.channels, UNITS, 1.0)], "u", "y", order=5)
    with pytest.raises(BadRecord, match="unit 'm', others have 'mm'"):
        identify_impulse_response(
            [record, Record(record.channels, {"u": "V", "y": "m"}, 0.5)], "u", "y", order=5
        )


def covers(model, omega=0.3):
    """Whether the 95 % ellipse at ω [rad/s] holds the response of `first_order_record`."""
    z = np.exp(1j * omega * model.sample_time)
    error = model.frequency_response([omega])[0] - 1 / (z - 0.7)
    parts = np.array([error.real, error.imag])
    return parts @ np.linalg.solve(model.frequency_covariance([omega])[0], parts) < 5.99


@pytest.mark.parametrize(("kernel", "least"), [("tc", 0.85), ("dc", 0.85), ("ss", 0.75)])
def test_bands_cover_the_truth_when_unknown_hyper_parameters_count(kernel, least):
    records = [first_order_record(300, seed, noise=0.5) for seed in range(40)]
    held = [
        covers(identify_impulse_response(record, "u", "y", kernel=kernel, order=40))
        for record in records
    ]
    assert np.mean(held) >= least


def test_a_prior_of_rank_one_is_not_believed():
    """DC turns ρ → 1 for a first-order response; its posterior alone then has one direction and misses the truth."""
    records = [first_order_record(300, seed, noise=0.5) for seed in range(40)]
    settings = {"kernel": "dc", "order": 40, "hyper_uncertainty": False}
    naive = [covers(identify_impulse_response(record, "u", "y", **settings)) for record in records]
    assert np.mean(naive) < 0.75


@pytest.mark.parametrize("seed", [1, 2])
def test_a_bound_covers_what_the_order_cuts_off(seed):
    """Two resonances that outlast 60 coefficients: drawn from those alone, the bound lies below the true error."""
    omega = np.linspace(1e-3, np.pi, 4001)
    z = np.exp(1j * omega)
    truth = np.polyval(NUMERATOR[3:], z) / np.polyval(DENOMINATOR, z)
    over = {}
    for covered in (True, False):
        model = identify_impulse_response(
            resonant_record(5000, seed), "u", "y", order=60, offset=False, cover_cut=covered
        )
        made = design_uncertainty_weight(model, order=2, seed=seed)
        error = np.abs(truth / model.frequency_response(omega / model.sample_time) - 1)
        over[covered] = float(
            np.max(error / np.abs(made.weight.frequency_response(omega / model.sample_time)))
        )
    assert over[True] < 1.0 < over[False]


def test_a_response_longer_than_the_records_can_tell_is_said_to_be_uncovered():
    u = np.random.default_rng(0).standard_normal(600)
    model = identify_impulse_response(
        Record({"u": u, "y": np.cumsum(u)}, UNITS, 1.0), "u", "y", order=40
    )
    assert any("do not cover what lies beyond lag" in text for text in model.warnings)


def test_random_models_of_a_cut_response_are_those_of_the_longer_one():
    model = identify_impulse_response(resonant_record(5000, 1), "u", "y", order=60, offset=False)
    omega, drawn = np.array([20.0, 150.0]), model.sample_longer(50, seed=3)
    lags = model.delay + np.arange(model.reach)
    expected = drawn @ np.exp(-1j * model.sample_time * np.outer(lags, omega))
    np.testing.assert_allclose(
        model.sample_frequency_responses(50, omega, seed=3), expected, rtol=1e-10
    )
    assert model.reach > model.order == 60


def test_a_decayed_response_needs_no_longer_one():
    assert (
        identify_impulse_response(first_order_record(), "u", "y", order=40).longer_response is None
    )
