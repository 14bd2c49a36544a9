import numpy as np
import pytest
from scipy.signal import lfilter

from residuum.identification.errors import BadInput, BadModel
from residuum.identification.kernel_based.impulse_response import identify_impulse_response
from residuum.identification.linear_models.identified_model import IdentifiedModel
from residuum.identification.linear_models.transfer_function import TransferFunction
from residuum.identification.linear_models.uncertainty import (
    chernoff_samples,
    design_uncertainty_weight,
    drawn_errors,
    worst_case_accuracy,
    worst_case_samples,
)
from residuum.identification.record import Record

OMEGA = np.geomspace(1e-2, np.pi, 40)


def model(std=0.02):
    g = 0.7 ** np.arange(12)
    return IdentifiedModel(
        method="kernel-tc",
        sample_time=1.0,
        impulse_response=g,
        covariance=np.diag((std * g) ** 2),
        noise_variance=0.1,
    )


@pytest.mark.parametrize("form", ["multiplicative", "additive", "inverse-multiplicative"])
def test_weight_covers_the_very_models_it_was_drawn_from(form):
    weight = design_uncertainty_weight(
        model(), omega=OMEGA, rule="worst-case", form=form, order=2, seed=3
    )
    drawn = model().sample_frequency_responses(weight.n_samples, OMEGA, seed=3)
    nominal = model().frequency_response(OMEGA)
    bound = np.abs(weight.weight.frequency_response(OMEGA))
    delta = {
        "multiplicative": drawn / nominal - 1,
        "additive": drawn - nominal,
        "inverse-multiplicative": (drawn - nominal) / drawn,
    }[form]
    assert np.all(np.abs(delta) <= bound * (1 + 1e-9))
    np.testing.assert_allclose(weight.magnitude, np.abs(delta).max(axis=0), rtol=1e-9)


@pytest.mark.parametrize("repeat", range(3))
def test_worst_case_rule_keeps_its_promise(repeat):
    """Of many designs, the share in which a new model exceeds Ω with probability over ε is at most ζ."""
    frequency, broken = OMEGA[:1], 0
    judged = np.abs(
        model().sample_frequency_responses(20_000, frequency, seed=99)
        / model().frequency_response(frequency)
        - 1
    )
    for seed in range(100):
        envelope = drawn_errors(
            model(), worst_case_samples(0.05, 0.95), seed=1000 * repeat + seed
        ).envelope(frequency)
        broken += np.mean(judged > envelope) > 0.05
    assert broken <= 12  # binomial(100, 0.05) exceeds 12 with probability 0.1 %


def test_sample_sizes_of_the_source():
    assert (
        chernoff_samples(0.05, 0.95),
        chernoff_samples(0.01, 0.95),
        worst_case_samples(0.05, 0.95),
    ) == (738, 18445, 59)
    assert worst_case_accuracy(59, 0.95) <= 0.05 < worst_case_accuracy(58, 0.95)


def test_each_rule_says_what_it_promises():
    chernoff = design_uncertainty_weight(model(), omega=OMEGA, order=1)
    assert "fraction of random models" in chernoff.promise
    assert "at most 0.0041" in chernoff.promise  # 1 − 0.05^(1/738)
    assert chernoff.n_samples == 738


def test_critical_frequency_is_where_the_weight_crosses_one():
    weight = design_uncertainty_weight(model(0.6), omega=OMEGA, order=2)
    assert weight.critical_frequency is not None
    assert abs(weight.weight.frequency_response([weight.critical_frequency])[0]) >= 1
    assert design_uncertainty_weight(model(1e-3), omega=OMEGA, order=2).critical_frequency is None


def test_a_zero_of_the_nominal_model_is_named():
    differencing = IdentifiedModel(
        method="by hand",
        sample_time=1.0,
        impulse_response=[1.0, -1.0],
        covariance=0.01 * np.eye(2),
        noise_variance=0.1,
    )
    with pytest.raises(BadModel, match=r"zero at 0 rad/s.*use additive"):
        drawn_errors(differencing, 20).envelope([0.0, 1.0])


@pytest.mark.parametrize(("accuracy", "confidence"), [(0.0, 0.9), (0.1, 1.0)])
def test_impossible_levels_are_refused(accuracy, confidence):
    with pytest.raises(BadInput, match="between 0 and 1"):
        worst_case_samples(accuracy, confidence)


@pytest.mark.parametrize("seed", range(1, 4))
def test_the_weight_holds_at_frequencies_that_the_fit_never_saw(seed):
    """System (2.38): resonances, and near zeros of the identified response, lie between the points of any fixed grid."""
    sample_time, rng = 0.01, np.random.default_rng(seed)
    truth = TransferFunction(
        [0.28261, 0.50666], [1, -1.41833, 1.58939, -1.31608, 0.88642], sample_time
    )
    u = rng.normal(size=6000)
    y = lfilter(np.r_[np.zeros(3), truth.num], truth.den, u)
    y += np.std(y) / 5.0 * rng.normal(size=len(y))
    record = Record({"u": u[1000:], "y": y[1000:]}, {"u": "", "y": ""}, sample_time)
    identified = identify_impulse_response(record, "u", "y", order=100, offset=False)
    weight = design_uncertainty_weight(identified, order=2, seed=seed).weight
    omega = np.linspace(1e-3, np.pi / sample_time, 20_001)
    nominal, bound = identified.frequency_response(omega), np.abs(weight.frequency_response(omega))
    drawn = np.abs(identified.sample_frequency_responses(100, omega, seed=99) / nominal - 1)
    assert np.mean(np.any(drawn > bound, axis=1)) <= 0.05
    assert np.all(np.abs(truth.frequency_response(omega) / nominal - 1) <= bound)
