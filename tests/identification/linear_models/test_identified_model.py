import json

import numpy as np
import pytest
from scipy import signal

from residuum.identification.errors import BadInput, BadModel
from residuum.identification.linear_models.identified_model import IdentifiedModel
from residuum.identification.linear_models.identified_model_file import (
    load_identified,
    save_identified,
)

OMEGA = np.geomspace(0.05, np.pi / 0.5, 30)


def fir_model(**changes):
    rng = np.random.default_rng(0)
    root = 0.02 * rng.standard_normal((6, 6))
    fields = {
        "method": "kernel-tc",
        "sample_time": 0.5,
        "impulse_response": 0.8 ** np.arange(6),
        "covariance": root @ root.T,
        "noise_variance": 0.1,
    }
    return IdentifiedModel(
        **(fields | {"delay": 2, "offset": 3.0, "provenance": {"n": 100}} | changes)
    )


def parametric_model():
    """0.6 z⁻¹/(1 + 0.4 z⁻¹), Example 1.2, with the covariance of (b, a)."""
    covariance = np.zeros((3, 3))
    covariance[np.ix_([1, 2], [1, 2])] = [[4e-4, 1e-4], [1e-4, 9e-4]]
    g = signal.lfilter([0.6], [1, 0.4], np.eye(1, 30)[0])
    return IdentifiedModel(
        method="arx",
        sample_time=0.5,
        impulse_response=g,
        covariance=np.zeros((30, 30)),
        noise_variance=0.4,
        numerator=[0.0, 0.6],
        denominator=[1.0, 0.4],
        parameter_covariance=covariance,
        noise_numerator=[1.0, 0.0],
        noise_denominator=[1.0, 0.4],
    )


@pytest.mark.parametrize("model", [fir_model(), parametric_model()], ids=["fir", "parametric"])
def test_covariances_are_those_of_the_samples(model):
    drawn = model.sample_frequency_responses(20_000, OMEGA, seed=1)
    parts = np.stack([drawn.real, drawn.imag], axis=1)
    sampled = np.einsum(
        "nik,njk->kij", parts - parts.mean(axis=0), parts - parts.mean(axis=0)
    ) / len(drawn)
    expected = model.frequency_covariance(OMEGA)
    np.testing.assert_allclose(sampled, expected, atol=0.06 * np.abs(expected).max())


def test_ellipses_hold_their_share_of_the_samples():
    model = fir_model()
    drawn = model.sample_frequency_responses(4000, OMEGA[:1], seed=2)[
        :, 0
    ] - model.frequency_response(OMEGA[:1])
    edge = model.confidence_ellipses(OMEGA[:1], 0.9, points=400)[0] - model.frequency_response(
        OMEGA[:1]
    )
    nearest = np.argmin(np.abs(np.angle(drawn[:, None] / edge[None])), axis=1)
    assert np.mean(np.abs(drawn) < np.abs(edge[nearest])) == pytest.approx(0.9, abs=0.02)


def test_simulation_equals_the_convolution_and_its_std_that_of_samples():
    model, u = fir_model(), np.random.default_rng(3).standard_normal(50)
    expected = np.convolve(u, [0, 0, *model.impulse_response])[:50] + 3.0
    np.testing.assert_allclose(model.simulate(u), expected, atol=1e-12)
    spread = np.std([np.convolve(u, [0, 0, *g])[:50] for g in model.sample(4000, seed=4)], axis=0)
    np.testing.assert_allclose(model.simulation_std(u), spread, rtol=0.08, atol=1e-9)


def test_one_step_prediction_uses_the_noise_model():
    model, rng = parametric_model(), np.random.default_rng(5)
    u, e = rng.standard_normal((2, 300))
    y = signal.lfilter([0, 0.6], [1, 0.4], u) + signal.lfilter([1], [1, 0.4], e)
    np.testing.assert_allclose(y - model.predict(u, y), e, atol=1e-10)  # the innovation comes back


def test_file_keeps_every_number(tmp_path):
    for number, model in enumerate([fir_model(), parametric_model()]):
        save_identified(model, tmp_path / f"{number}.json")
        back = load_identified(tmp_path / f"{number}.json")
        np.testing.assert_array_equal(back.sample(3, seed=1), model.sample(3, seed=1))
        assert (back.method, back.delay, back.offset, dict(back.provenance)) == (
            model.method,
            model.delay,
            model.offset,
            dict(model.provenance),
        )


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"format": "other"}, "is not an identified model"),
        ({"version": 9}, "version 9"),
        ({"surprise": 1}, "unknown field 'surprise'"),
        ({"covariance": [[1.0]]}, "covariance: has shape"),
        ({"covariance": (-np.eye(6)).tolist()}, "negative eigenvalue"),
        ({"impulse_response": [None] * 6}, "impulse_response"),
        ({"delay": "two"}, "delay"),
        ({"noise_variance": -1}, "noise_variance"),
        ({"impulse_response": "text"}, "not an array"),
    ],
)
def test_a_spoilt_file_is_refused_by_name(change, match, tmp_path):
    path = tmp_path / "model.json"
    save_identified(fir_model(), path)
    path.write_text(json.dumps(json.loads(path.read_text()) | change))
    with pytest.raises(BadInput, match=match) as refusal:
        load_identified(path)
    assert str(path) in str(refusal.value)


@pytest.mark.parametrize("content", ["", "[1, 2]", "{}", "\x00\x01", "[" * 100_000])
def test_anything_else_is_refused(content, tmp_path):
    path = tmp_path / "not.json"
    path.write_text(content)
    with pytest.raises(BadModel, match=r"not\.json"):
        load_identified(path)


def test_a_covariance_that_says_nothing_is_not_sampled():
    model = parametric_model()
    wild = IdentifiedModel(
        method="arx",
        sample_time=1.0,
        impulse_response=model.impulse_response,
        covariance=model.covariance,
        noise_variance=0.1,
        numerator=[0.6],
        denominator=[1.0, 0.4],
        parameter_covariance=np.diag([0.0, 1e6]),
    )
    with pytest.raises(BadModel, match="random models are unstable"):
        wild.sample(10, seed=0)


def test_to_control_has_the_same_response():
    control = pytest.importorskip("control")
    model = fir_model()
    np.testing.assert_allclose(
        control.frequency_response(model.to_control(), OMEGA[:-1]).complex,
        model.frequency_response(OMEGA[:-1]),
        atol=1e-10,
    )


def test_rounding_in_a_small_covariance_entry_is_not_taken_for_asymmetry(tmp_path):
    covariance = np.diag([1.0, 1.0, 0, 0, 0, 0]) + 0.0
    covariance[0, 1], covariance[1, 0] = 3e-17, 1e-17
    save_identified(fir_model(covariance=covariance), tmp_path / "m.json")
    assert load_identified(tmp_path / "m.json").covariance[0, 1] == 3e-17


def test_simulation_std_is_the_quadratic_form_of_the_last_inputs():
    model, rng = fir_model(), np.random.default_rng(4)
    m = model.order
    for n in (1, m - 1, 5 * m + 3):
        u = 1e6 * rng.standard_normal(n)
        padded = np.concatenate([np.zeros(m - 1 + model.delay), u])
        phi = np.array([padded[t : t + m][::-1] for t in range(n)])
        spread = np.sqrt(np.einsum("ti,ij,tj->t", phi, model.covariance, phi))
        np.testing.assert_allclose(model.simulation_std(u), spread, rtol=1e-6)
