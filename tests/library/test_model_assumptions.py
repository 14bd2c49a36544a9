"""What `identify` says against its own model, and that no controller is promised for it."""

import numpy as np
import pytest
from scipy import signal

import residuum as rs
from benchmarks.plant_tests import dead_time_plant, feedback_plant, integrating_plant, plain_plant
from residuum.identification.errors import BadInput, BadRecord
from residuum.identification.record import Record


def identified(plant, **options):
    record = Record({"u": plant.u, "y": plant.y}, {"u": "V", "y": "m"}, 0.1)
    return rs.identify(record, input="u", output="y", **options)


def refused(plant):
    with pytest.raises(BadInput, match="no controller is promised for it") as error:
        rs.control.design(plant, structure="pi")
    return str(error.value)


@pytest.mark.parametrize("seed", [0, 1])
def test_an_integrating_plant_is_identified_after_the_remedy(seed):
    plant = integrating_plant(seed)
    found = identified(plant, method="bj", integrator=True, delay=plant.delay)
    assert found.identified.integrates
    u = np.ones(60)
    truth = plant.response(u)
    assert np.max(np.abs(found.identified.simulate(u) - truth)) < 0.1 * np.max(np.abs(truth))
    assert "none: the model integrates" in str(found)
    assert "set point" in refused(found)
    kernel = identified(plant, order=60)
    assert any("the plant integrates" in text for text in kernel.identified.warnings)
    assert "record steps of the set point" in refused(kernel)


def test_spread_of_an_integrating_model_grows_with_the_sum(tmp_path):
    plant = integrating_plant(0)
    found = identified(plant, order=40, integrator=True)
    model, n = found.identified, 200
    drawn, _ = model.sample_polynomials(2000, 1)
    steps = np.array([signal.lfilter(num, [1.0, -1.0], np.ones(n)) for num in drawn])
    np.testing.assert_allclose(
        model.simulation_std(np.ones(n))[20:], steps.std(axis=0)[20:], rtol=0.1
    )
    numerators, _ = model.sample_polynomials(5, 2)
    at_z = (
        numerators @ np.exp(-0.03j * np.arange(numerators.shape[1]))[:, None] / (1 - np.exp(-0.03j))
    )
    np.testing.assert_allclose(model.sample_frequency_responses(5, [0.3], 2), at_z)
    found.save(tmp_path / "m.json")
    assert rs.load_plant(tmp_path / "m.json").identified.integrates
    assert "no controller is promised" in refused(rs.load_plant(tmp_path / "m.json"))
    holed = Record(
        {"u": np.r_[plant.u[:99], np.nan, plant.u[100:]], "y": plant.y}, {"u": "V", "y": "m"}, 0.1
    )
    with pytest.raises(BadRecord, match="sample 99 is missing"):
        rs.identify(holed, input="u", output="y", integrator=True)
    with pytest.raises(BadInput, match="errors that decay"):
        identified(plant, integrator=True, uncertainty="model-error")


def test_feedback_forbids_methods_without_a_noise_model_alone():
    plant = feedback_plant(2)
    assert any("feedback" in text for text in identified(plant).identified.unfit)
    direct = identified(plant, method="bj", delay=None).identified
    assert direct.unfit == ()
    assert any("as right as its noise model" in text for text in direct.warnings)
    assert any("delay 0 was left out" in text for text in direct.warnings)
    # the kernel's likelihood would take the controller's answer for a plant without delay
    assert direct.delay >= 1
    step = np.ones(60)
    truth = plant.response(step)
    assert np.max(np.abs(direct.simulate(step) - direct.offset - truth)) < 0.1 * np.max(
        np.abs(truth)
    )


def test_dead_time_beyond_the_order_is_told_and_estimated():
    plant = dead_time_plant(1)
    found = identified(plant, method="arx", delay=1)
    assert found.assumptions.late
    assert "later than the model's last input lag" in refused(found)
    again = identified(plant, method="arx")
    assert again.identified.unfit == ()
    assert again.assumptions.aside[0].missing < 0.1 * found.assumptions.aside[0].missing


def test_a_noisy_plain_plant_is_told_its_fit_and_stays_fit_for_control():
    plant = plain_plant(0)
    noisy = plant.y + 1.5 * np.std(plant.y) * np.random.default_rng(0).standard_normal(len(plant.y))
    record = Record({"u": plant.u, "y": noisy}, {"u": "V", "y": "m"}, 0.1)
    found = rs.identify(record, input="u", output="y", order=60)
    assert found.identified.unfit == ()
    assert any("the rest is noise" in text for text in found.identified.warnings)


def test_a_model_of_too_low_an_order_fails_on_data_kept_aside():
    rng = np.random.default_rng(4)
    u = rng.standard_normal(2000)
    y = signal.lfilter(
        [0, 1.0], np.real(np.poly([0.95 * np.exp(0.4j), 0.95 * np.exp(-0.4j)])), u
    ) + 0.1 * rng.standard_normal(2000)
    record = Record({"u": u, "y": y}, {"u": "V", "y": "m"}, 0.1)
    found = rs.identify(record, input="u", output="y", method="oe", order=1)
    assert found.assumptions.aside[0].fails
    assert "what the model misses" in refused(found)
    assert rs.identify(record, input="u", output="y", method="oe", order=2).identified.unfit == ()


def _unstable_in_its_loop(seed, pole):
    rng, n = np.random.default_rng(seed), 2000
    y, u, (e, r) = np.zeros(n), np.zeros(n), rng.standard_normal((2, n))
    for t in range(1, n):
        y[t] = pole * y[t - 1] + 0.5 * u[t - 1] + 0.1 * e[t]
        u[t] = 2 * (pole - 0.6) * (np.sign(r[t // 7]) - y[t])
    return Record({"u": u, "y": y}, {"u": "V", "y": "m"}, 0.1)


@pytest.mark.parametrize(("seed", "pole"), [(0, 1.05), (1, 1.16)])
def test_an_unstable_plant_has_no_stable_model(seed, pole):
    record = _unstable_in_its_loop(seed, pole)
    for method in ("kernel", "oe", "bj"):
        with pytest.raises(
            BadInput, match=r"the plant is unstable \(pole at 1\.\d+ ± .* method arx or armax"
        ):
            rs.identify(record, input="u", output="y", method=method)
    found = rs.identify(record, input="u", output="y", method="arx")
    assert found.assumptions.unstable.unstable
    gain = found.identified.frequency_response(0.0).real
    assert gain == pytest.approx(0.5 / (1 - pole), rel=0.15)
    assert "by one-step predictions" in str(found)
    assert max(map(len, str(found).split())) < 30  # no number of a hundred digits
    assert "the plant is unstable" in refused(found)


@pytest.mark.parametrize("method", ["kernel", "arx", "oe"])
@pytest.mark.parametrize("kind", ["step", "pulse"])
def test_one_step_or_pulse_near_the_begin_tells_the_gain(method, kind):
    rng, k = np.random.default_rng(5), np.arange(300)
    u = (k >= 20) * 1.0 if kind == "step" else 3.0 * ((k >= 20) & (k < 26))
    y = signal.lfilter([0.0, 0.15], [1.0, -0.85], u) + 0.02 * rng.standard_normal(300)
    found = rs.identify(
        Record({"u": u, "y": y}, {"u": "", "y": ""}, 1.0), input="u", output="y", method=method
    )
    spread = np.sqrt(found.identified.frequency_covariance(0.0)[0, 0, 0])
    assert abs(found.identified.frequency_response(0.0).real - 1.0) < 4 * spread < 0.6
    assert found.to_dict()["fit_percent"][0] > 60
    assert not found.identified.warnings


@pytest.mark.parametrize("method", ["kernel", "arx", "oe"])
def test_one_sine_tells_no_gain(method):
    rng, k = np.random.default_rng(5), np.arange(600)
    u = np.sin(2 * np.pi * k / 13).round(6)
    y = signal.lfilter([0.0, 0.15], [1.0, -0.85], u) + 0.02 * rng.standard_normal(600)
    found = rs.identify(
        Record({"u": u, "y": y}, {"u": "", "y": ""}, 1.0), input="u", output="y", method=method
    )
    assert "static gain       the record does not tell it" in str(found)
    assert "the record does not tell them" in str(found)  # no coefficient with a narrow band
    assert any(
        "persistently exciting of order 2 only" in text for text in found.identified.warnings
    )
    assert "persistently exciting" in refused(found)


def test_a_record_that_ends_before_its_step_is_answered_says_so():
    rng, k = np.random.default_rng(5), np.arange(60)
    u = (k >= 20) * 1.0
    y = signal.lfilter([0.0, 0.05], [1.0, -0.95], u) + 0.005 * rng.standard_normal(60)
    found = rs.identify(
        Record({"u": u, "y": y}, {"u": "", "y": ""}, 1.0), input="u", output="y", method="arx"
    )
    assert any("the records end before the response" in text for text in found.identified.warnings)


def test_a_step_too_short_to_compare_delays_is_identified_with_a_warning():
    rng, k = np.random.default_rng(5), np.arange(35)
    u = (k >= 20) * 1.0
    y = signal.lfilter([0.0, 0.15], [1.0, -0.85], u) + 0.02 * rng.standard_normal(35)
    found = rs.identify(
        Record({"u": u, "y": y}, {"u": "", "y": ""}, 1.0), input="u", output="y", method="arx"
    )
    spread = np.sqrt(found.identified.frequency_covariance(0.0)[0, 0, 0])
    assert abs(found.identified.frequency_response(0.0).real - 1.0) < 3 * spread
    assert any("the records end before the response" in text for text in found.identified.warnings)
