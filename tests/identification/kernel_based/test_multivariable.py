import numpy as np
import pytest
from scipy import signal

from residuum.identification.errors import BadRecord, NotIdentifiable
from residuum.identification.kernel_based.multivariable import (
    identify_multivariable,
    load_multivariable,
    multivariable_text,
)
from residuum.identification.record import Record

UNITS = {"valve": "%", "heater": "kW", "level": "m", "temperature": "K"}


def plant(seed, n=1500, mixing=0.8):
    """Two correlated inputs, two outputs; the valve does not act on the temperature."""
    rng = np.random.default_rng(seed)
    valve = rng.standard_normal(n)
    heater = mixing * valve + np.sqrt(1 - mixing**2) * rng.standard_normal(n)
    level = signal.lfilter([0, 1.0], [1, -0.8], valve) + signal.lfilter(
        [0, -0.2], [1, -0.5], heater
    )
    temperature = 20 + signal.lfilter([0, 0.5], [1, -0.9], heater)
    noise = rng.standard_normal((2, n)) * [[0.2], [0.1]]
    channels = {
        "valve": valve,
        "heater": heater,
        "level": level + noise[0],
        "temperature": temperature + noise[1],
    }
    return Record(channels, UNITS, 2.0)


@pytest.mark.parametrize("kernel", ["tc", "dc"])
def test_correlated_inputs_are_told_apart(kernel):
    model = identify_multivariable(
        plant(0), ["valve", "heater"], ["level", "temperature"], kernel=kernel, order=40
    )
    k = np.arange(40)
    truth = [[0.8**k, -0.2 * 0.5**k], [0.0 * k, 0.5 * 0.9**k]]
    for row, responses in zip(model.models, truth, strict=True):
        for path, response in zip(row, responses, strict=True):
            assert np.abs(path.impulse_response - response).max() < 0.05
    assert model.models[1][1].offset == pytest.approx(20, abs=0.1)
    assert (model.inputs, model.outputs) == (("valve", "heater"), ("level", "temperature"))


def test_joint_samples_carry_the_correlation_between_paths():
    model = identify_multivariable(plant(1), ["valve", "heater"], ["level"], order=15)
    drawn = model.sample(6000, seed=2)[:, 0].reshape(6000, 30)
    np.testing.assert_allclose(
        np.cov(drawn.T), model.covariances[0], atol=0.06 * np.abs(model.covariances[0]).max()
    )
    # the inputs agree, so the paths trade off
    assert np.corrcoef(drawn[:, 0], drawn[:, 15])[0, 1] < -0.3


def test_simulation_adds_the_paths():
    record = plant(2)
    model = identify_multivariable(record, ["valve", "heater"], ["level", "temperature"], order=60)
    for name, simulated in model.simulate(record).items():
        residual = (record[name] - simulated)[60:]
        assert np.std(residual) < 0.3 * np.std(record[name])
        assert abs(residual.mean()) < 0.05


def test_response_has_one_entry_a_path():
    model = identify_multivariable(
        plant(3), ["valve", "heater"], ["level", "temperature"], order=40
    )
    response = model.frequency_response([0.0, 0.1])
    assert response.shape == (2, 2, 2)
    np.testing.assert_allclose(response[0].real, [[5.0, -0.4], [0.0, 5.0]], atol=0.4)


def test_a_channel_may_be_used_once():
    with pytest.raises(BadRecord, match="may be used once"):
        identify_multivariable(plant(4), ["valve", "valve"], ["level"])


def slow_plant(seed, n=3000):
    """Two paths of which one lasts far longer than 30 samples."""
    rng = np.random.default_rng(seed)
    valve, heater = rng.standard_normal((2, n))
    level = signal.lfilter([0, 0.3], [1, -0.97], valve) + signal.lfilter(
        [0, 1.0], [1, -0.4], heater
    )
    channels = {"valve": valve, "heater": heater, "level": level + 0.3 * rng.standard_normal(n)}
    return Record(channels, {name: UNITS[name] for name in channels}, 2.0)


def test_random_models_hold_what_the_order_cuts_off(tmp_path):
    """At the static gain the cut response misses 40 %; its own draws do not know of it, those of the longer one do."""
    model = identify_multivariable(slow_plant(4), ["valve", "heater"], ["level"], order=30)
    gains, longer = (
        drawn[:, 0].sum(axis=2) for drawn in (model.sample(400, 0), model.sample_longer(400, 0))
    )
    truth = np.array([10.0, 1.0 / 0.6])
    assert abs(gains[:, 0].mean() - truth[0]) > 5 * gains[:, 0].std()
    assert np.all(np.abs(longer.mean(axis=0) - truth) < 3 * longer.std(axis=0))
    path = model.models[0][0]
    np.testing.assert_allclose(
        path.sample_longer(4000, 1).std(axis=0), np.sqrt(np.diag(path.longer_covariance)), rtol=0.1
    )
    file = tmp_path / "plant.json"
    file.write_text(multivariable_text(model))
    read = load_multivariable(file)
    np.testing.assert_array_equal(read.sample_longer(5, 2), model.sample_longer(5, 2))
    file.write_text(multivariable_text(model).replace('"longer": [{', '"later": [{'))
    # as older files
    np.testing.assert_array_equal(load_multivariable(file).sample_longer(5, 2), read.sample(5, 2))


def test_nothing_is_added_where_all_paths_have_decayed():
    model = identify_multivariable(
        plant(5, mixing=0.0), ["valve", "heater"], ["level", "temperature"], order=100
    )
    assert model.longer == (None, None)
    np.testing.assert_array_equal(model.sample_longer(3, 0), model.sample(3, 0))


@pytest.mark.parametrize("third", [False, True])
def test_inputs_that_move_as_one_are_named_and_refused(third):
    record = plant(6, mixing=0.0)
    valve, heater = record["valve"], record["heater"]
    copied = {"copy": 2.0 * valve - (3.0 * heater if third else 0.0)}
    joined = Record({**record.channels, **copied}, {**record.units, "copy": "V"}, 2.0)
    named = "'valve' and 'heater' and 'copy'" if third else "'valve' and 'copy'"
    with pytest.raises(
        NotIdentifiable,
        match=f"inputs {named} move as one .* leave one out, or record them moving apart",
    ):
        identify_multivariable(joined, ["valve", "heater", "copy"], ["level"], order=10)
    nearly = joined.channels["copy"] + 0.01 * np.random.default_rng(0).standard_normal(record.n)
    apart = Record({**record.channels, "copy": nearly}, joined.units, 2.0)
    assert (
        identify_multivariable(apart, ["valve", "heater", "copy"], ["level"], order=10).inputs[2]
        == "copy"
    )
