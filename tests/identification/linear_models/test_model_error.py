import numpy as np
import pytest
from scipy import signal

from residuum.identification.errors import BadInput, NotIdentifiable
from residuum.identification.linear_models.error_bounds.error_models import (
    laguerre_basis,
    stochastic_embedding,
)
from residuum.identification.linear_models.identified_model import IdentifiedModel
from residuum.identification.linear_models.validation import model_error_model
from residuum.identification.record import Record

UNITS = {"u": "V", "y": "mm"}
OMEGA = np.geomspace(0.01, 3.1, 40)


def first_order(pole, order=80):
    return IdentifiedModel(
        method="by hand",
        sample_time=1.0,
        impulse_response=pole ** np.arange(order),
        covariance=np.zeros((order, order)),
        noise_variance=0.0,
    )


def resonant_record(seed, n=2000, noise_pole=0.0):
    """A first-order lag plus a resonance at 1 rad/s, output noise coloured at will."""
    rng = np.random.default_rng(seed)
    u = rng.standard_normal(n)
    y = signal.lfilter([0, 1.0], [1, -0.8], u) + signal.lfilter(
        [0, 0.15], [1, -2 * 0.95 * np.cos(1.0), 0.95**2], u
    )
    return Record(
        {"u": u, "y": y + 0.4 * signal.lfilter([1.0], [1, -noise_pole], rng.standard_normal(n))},
        UNITS,
        1.0,
    )


def lag_record(seed, noise_pole=0.0, n=800):
    rng = np.random.default_rng(seed)
    u = rng.standard_normal(n)
    v = 0.5 * signal.lfilter([1.0], [1, -noise_pole], rng.standard_normal(n))
    return Record({"u": u, "y": signal.lfilter([0, 1.0], [1, -0.8], u) + v}, UNITS, 1.0)


@pytest.mark.parametrize("noise_pole", [0.0, 0.9])
def test_a_missing_resonance_is_falsified_at_its_frequency(noise_pole):
    error = model_error_model(first_order(0.8), resonant_record(0, noise_pole=noise_pole), order=60)
    assert error.falsified
    assert error.falsified_at.min() < 1.0 < error.falsified_at.max()
    assert error.omega[np.argmax(error.distance)] == pytest.approx(1.0, abs=0.1)
    assert not error.correlation[0].passed
    true_error = np.abs(
        signal.freqz([0, 0.15], [1, -2 * 0.95 * np.cos(1.0), 0.95**2], error.omega)[1]
    )
    assert np.mean(error.magnitude_bound >= true_error) > 0.97


@pytest.mark.parametrize("noise_pole", [0.0, 0.9])
def test_the_true_model_is_not_falsified(noise_pole):
    assert (
        sum(
            model_error_model(first_order(0.8), lag_record(seed, noise_pole), order=40).falsified
            for seed in range(12)
        )
        <= 1
    )


def test_several_records_with_gaps_join():
    first, second = lag_record(1), lag_record(2)
    y = np.array(first["y"])
    y[50:60] = np.nan
    error = model_error_model(
        first_order(0.6), [Record({"u": first["u"], "y": y}, UNITS, 1.0), second], order=40
    )
    assert error.falsified
    assert len(error.correlation) == 2


def test_stochastic_embedding_bands_cover_a_richer_truth():
    numerator, denominator = [0, 1, 0.4], np.convolve([1, -0.8], [1, 0.5])
    truth, inside = signal.freqz(numerator, denominator, OMEGA)[1], []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        u = rng.standard_normal(600)
        y = signal.lfilter(numerator, denominator, u) + 0.1 * rng.standard_normal(600)
        nominal = stochastic_embedding(
            Record({"u": u, "y": y}, UNITS, 1.0), "u", "y", basis=laguerre_basis(0.7, 2, 50)
        ).nominal
        error = nominal.frequency_response(OMEGA) - truth
        parts = np.stack([error.real, error.imag], axis=-1)
        inside.append(
            np.einsum(
                "ki,kij,kj->k", parts, np.linalg.inv(nominal.frequency_covariance(OMEGA)), parts
            )
            < 5.99
        )
    assert 0.85 <= np.mean(inside) <= 1.0


def test_parts_of_the_embedding_add_up_and_bias_stays_with_more_data():
    def parts(n):
        record = resonant_record(3, n=n)
        return stochastic_embedding(record, "u", "y", basis=laguerre_basis(0.8, 3, 60))

    short, long = parts(1000), parts(16_000)
    np.testing.assert_allclose(
        short.nominal.covariance, short.bias_covariance + short.variance_covariance
    )
    assert np.trace(long.variance_covariance) < 0.2 * np.trace(short.variance_covariance)
    assert np.trace(long.bias_covariance) > 0.3 * np.trace(short.bias_covariance)


def test_bad_requests_are_refused():
    with pytest.raises(BadInput, match="level: is 2"):
        model_error_model(first_order(0.8), lag_record(0), level=2)
    with pytest.raises(BadInput, match=r"pole 1\.5"):
        laguerre_basis(1.5, 2, 10)
    with pytest.raises(NotIdentifiable, match="do not excite the 2 basis"):
        stochastic_embedding(lag_record(0), "u", "y", basis=np.ones((10, 2)))
