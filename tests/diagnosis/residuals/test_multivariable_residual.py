"""Residuals of plants with several inputs and outputs: rate of false alarms, the right sensor or actuator, unknown inputs."""

import numpy as np
import pytest
from scipy import signal

from residuum.diagnosis.residuals.multivariable import (
    MultivariableResidual,
    design_multivariable_residual,
    fit_whitener,
    unknown_input_decoupling,
)
from residuum.diagnosis.residuals.multivariable_detection import detect_multivariable, threshold_of
from residuum.identification.errors import BadInput, BadModel, BadRecord
from residuum.identification.kernel_based.multivariable import identify_multivariable
from residuum.identification.record import Record

N, ONSET, NOISE = 2000, 1000, 0.3
PATHS = [  # outputs by inputs: numerator, denominator
    [([0, 1.0], [1, -0.5]), ([0, -0.6], [1, -0.8])],
    [([0, 0.3], [1, -0.7]), ([0, 0.5], [1, -0.6])],
    [([0, 0.2], [1, -0.9]), ([0, 0.4], [1, -0.5])],
]


def plant(seed, outputs=2, sensor=None, actuator=None, sizes=(1.0, 1.0), n=N, without=()):
    """Around levels that are not zero; a fault of the sensor or actuator (index, size) begins in the middle."""
    rng = np.random.default_rng(seed)
    u = rng.standard_normal((2, n)) * np.array(sizes)[:, None]
    acting = u.copy()
    if actuator:
        acting[actuator[0], ONSET:] += actuator[1]
    channels = {"valve": u[0] + 2.0, "heater": u[1] - 1.0}
    for i, paths in enumerate(PATHS[:outputs]):
        y = (
            sum(signal.lfilter(b, a, v) for (b, a), v in zip(paths, acting, strict=True))
            + NOISE * rng.standard_normal(n)
            + 5.0
            + i
        )
        if sensor and sensor[0] == i:
            y[ONSET:] += sensor[1]
        channels[f"y{i}"] = y
    kept = {name: values for name, values in channels.items() if name not in without}
    return Record(kept, dict.fromkeys(kept, "V"), 0.5, source=f"plant {seed}")


def identified(seed, outputs):
    names = [f"y{i}" for i in range(outputs)]
    return identify_multivariable(plant(seed, outputs), ["valve", "heater"], names, order=40)


@pytest.fixture(scope="module")
def two_by_two():
    return design_multivariable_residual(identified(0, 2), [plant(0)])


@pytest.fixture(scope="module")
def three_outputs():
    return identified(1, 3)


@pytest.fixture(scope="module")
def blind(three_outputs):
    healthy = [plant(1, 3, without=("heater",))]
    return design_multivariable_residual(
        three_outputs, healthy, method="unknown-input-observer", unknown=["heater"]
    )


def test_healthy_records_alarm_no_more_often_than_asked(two_by_two):
    # one alarm in 10 000 samples: 4 of 20 records of 2000 may alarm, 9 with a chance of a hundredth
    a_day = 1e-4 * 86400 / 0.5
    found = [
        detect_multivariable(two_by_two, plant(100 + k), false_alarms_per_day=a_day)
        for k in range(20)
    ]
    assert sum(one.alarm.any() for one in found) <= 8
    assert min(one.statistic.max() for one in found) > 2.5  # and the statistic is not idle
    scores = np.concatenate([one.residual.scores[one.residual.valid] for one in found])
    np.testing.assert_allclose(np.cov(scores.T), np.eye(2), atol=0.06)


@pytest.mark.parametrize("place", [0, 1])
def test_the_faulty_sensor_is_named_with_its_size(two_by_two, place):
    found = detect_multivariable(two_by_two, plant(200, sensor=(place, 0.4)))
    fault = found.fault
    assert found.first_alarm is not None and ONSET <= found.first_alarm < ONSET + 150
    assert (fault.hypothesis.kind, fault.hypothesis.name, fault.hypothesis.unit) == (
        "sensor",
        f"y{place}",
        "V",
    )
    assert abs(fault.value - 0.4) < 3 * fault.std < 0.1 and abs(fault.onset - ONSET) < 40
    assert fault.probability > 0.95 and not fault.indistinguishable_from


@pytest.mark.parametrize(("place", "name"), [(0, "valve"), (1, "heater")])
def test_the_faulty_actuator_is_named_with_its_size(two_by_two, place, name):
    fault = detect_multivariable(two_by_two, plant(201, actuator=(place, 0.3))).fault
    assert (fault.hypothesis.kind, fault.hypothesis.name) == ("actuator", name)
    assert abs(fault.value - 0.3) < 3 * fault.std and abs(fault.onset - ONSET) < 20


def test_a_model_from_little_data_does_not_alarm_for_its_own_error():
    short = plant(3, n=220)
    model = identify_multivariable(short, ["valve", "heater"], ["y0", "y1"], order=30)
    design = design_multivariable_residual(model, [short])
    a_day = 1e-4 * 86400 / 0.5
    loud = [
        detect_multivariable(design, plant(300 + k, sizes=(5.0, 5.0)), false_alarms_per_day=a_day)
        for k in range(5)
    ]
    assert sum(one.alarm.any() for one in loud) <= 4
    spread = np.std(np.concatenate([one.residual.scores[one.residual.valid] for one in loud]))
    assert spread > 1.3  # the residual itself has grown by the model's error


def test_an_unknown_input_is_decoupled_and_sensors_are_still_told_apart(blind, three_outputs):
    omega = np.linspace(0.01, np.pi / 0.5, 200)
    through = np.linalg.norm(
        blind.Q.frequency_response(omega) @ three_outputs.frequency_response(omega)[:, :, 1:],
        axis=(1, 2),
    )
    direct = np.linalg.norm(three_outputs.frequency_response(omega)[:, :, 1], axis=1)
    assert np.max(through / direct) < 0.01 and blind.Q.D.shape == (2, 3)
    # it moves three times as much as in the healthy record
    watched = {"outputs": 3, "sizes": (1.0, 3.0), "without": ("heater",)}
    a_day = 1e-4 * 86400 / 0.5
    assert (
        sum(
            detect_multivariable(
                blind, plant(400 + k, **watched), false_alarms_per_day=a_day
            ).alarm.any()
            for k in range(10)
        )
        <= 6
    )
    for place in range(3):
        fault = detect_multivariable(blind, plant(500, sensor=(place, 0.4), **watched)).fault
        assert (fault.hypothesis.kind, fault.hypothesis.name) == ("sensor", f"y{place}")
        assert abs(fault.value - 0.4) < 3 * fault.std
    fault = detect_multivariable(blind, plant(501, actuator=(0, 0.5), **watched)).fault
    assert (fault.hypothesis.kind, fault.hypothesis.name) == ("actuator", "valve")


def test_with_one_residual_left_faults_cannot_be_told_apart():
    design = design_multivariable_residual(
        identified(2, 2), [plant(2)], method="unknown-input-observer", unknown=["heater"]
    )
    found = detect_multivariable(design, plant(502, sensor=(0, 1.0)))
    assert found.fault is not None and found.fault.probability < 0.7
    assert found.fault.indistinguishable_from


def test_gaps_start_the_residual_anew(two_by_two):
    record = plant(600, sensor=(0, 0.5))
    y = record["y0"].copy()
    y[900:905] = np.nan
    found = detect_multivariable(
        two_by_two, Record({**record.channels, "y0": y}, record.units, 0.5)
    )
    assert not found.residual.valid[900 : 905 + two_by_two.warm_up - 1].any()
    assert found.fault.hypothesis.name == "y0" and found.first_alarm >= ONSET


def test_a_stored_design_says_the_same(two_by_two, blind, tmp_path):
    for design, record in (
        (two_by_two, plant(700, sensor=(1, 0.4))),
        (blind, plant(701, 3, without=("heater",))),
    ):
        design.save(tmp_path / "d")
        read = MultivariableResidual.load(tmp_path / "d")
        np.testing.assert_array_equal(
            detect_multivariable(read, record).statistic,
            detect_multivariable(design, record).statistic,
        )
        assert read.method == design.method
    with pytest.raises(BadInput, match="no such file"):
        MultivariableResidual.load(tmp_path / "none")


def test_what_cannot_be_made_is_refused(three_outputs, two_by_two):
    healthy = [plant(1, 3)]
    with pytest.raises(BadInput, match="must be robust or unknown-input-observer"):
        design_multivariable_residual(three_outputs, healthy, method="parity")
    with pytest.raises(BadInput, match="needs at least one"):
        design_multivariable_residual(three_outputs, healthy, method="unknown-input-observer")
    with pytest.raises(BadInput, match="there are valve, heater"):
        design_multivariable_residual(
            three_outputs, healthy, method="unknown-input-observer", unknown=["y0"]
        )
    with pytest.raises(BadInput, match="needs healthy records"):
        design_multivariable_residual(three_outputs, [])
    with pytest.raises(BadModel, match="2 unknown inputs use up all 2 outputs"):
        unknown_input_decoupling(two_by_two.model, ["valve", "heater"])
    with pytest.raises(BadRecord, match="sample time"):
        detect_multivariable(
            two_by_two, Record(dict(plant(1).channels), dict(plant(1).units), 0.25)
        )
    with pytest.raises(BadInput, match="no stretch without a gap"):
        detect_multivariable(two_by_two, plant(1, n=30))
    with pytest.raises(BadRecord, match="too short"):
        fit_whitener([np.ones((10, 2))])


def test_more_hypotheses_need_a_higher_threshold():
    assert threshold_of(8, 1e-6) > threshold_of(2, 1e-6) > threshold_of(2, 1e-4) > 4.0


def test_the_size_of_an_actuator_s_fault_is_as_uncertain_as_the_gain_that_tells_it():
    held, wide = 0, 0
    for seed in range(6):
        short = plant(800 + seed, n=300)
        model = identify_multivariable(short, ["valve", "heater"], ["y0", "y1"], order=30)
        fault = detect_multivariable(
            design_multivariable_residual(model, [short]), plant(900 + seed, actuator=(0, 3.0))
        ).fault
        assert (fault.hypothesis.kind, fault.hypothesis.name) == ("actuator", "valve")
        held += abs(fault.value - 3.0) < 1.96 * fault.std
        wide += fault.std > 0.02 * fault.value
    assert held >= 5 and wide == 6


def test_a_plant_whose_only_input_is_not_measured_is_watched_by_its_sensors():
    model = identify_multivariable(plant(4), ["heater"], ["y0", "y1"], order=40)
    healthy = [plant(4, without=("valve", "heater"))]
    design = design_multivariable_residual(
        model, healthy, method="unknown-input-observer", unknown=["heater"]
    )
    found = detect_multivariable(design, plant(5, sensor=(1, 6.0), without=("valve", "heater")))
    assert found.alarm[ONSET:].any() and not found.alarm[:ONSET].any()


@pytest.mark.parametrize("unit", [1e-6, 1.0, 1e6])
def test_the_order_of_the_noise_does_not_hang_on_units_or_gaps(unit):
    rng = np.random.default_rng(12)
    white = [unit * rng.standard_normal((300, 2)) for _ in range(5)]
    assert len(fit_whitener(white).past) == 0
    coloured = [signal.lfilter([1], [1, -0.8], part, axis=0) for part in white]
    for part in coloured:
        part[::60] = np.nan
    assert len(fit_whitener(coloured).past) == 1
