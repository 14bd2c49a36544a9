"""Estimation recovers known truth, says what the data cannot tell, and survives what diverges."""

from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

from residuum.identification.errors import BadRecord, NotIdentifiable
from residuum.identification.physics import (
    Experiment,
    Settings,
    Simulator,
    estimate,
    estimate_by_likelihood,
    load_model,
    match,
    missing_terms,
    windows,
    with_coloured_noise,
)
from residuum.identification.physics.estimation.least_squares import covariance_of, solve_scaled
from residuum.identification.physics.simulate.kalman import Noise
from residuum.identification.record import Record

SILVERBOX = Path(__file__).parents[4] / "shared/data/silverbox/SNLS80mV.mat"


def movement(n=2000, sample_time=0.005, seed=0):
    """A voltage that goes to and fro with pauses, different for every seed."""
    rng = np.random.default_rng(seed)
    t = np.arange(n) * sample_time
    shape = np.clip(1.6 * np.sin(2 * np.pi * (0.3 + 0.1 * seed) * t + rng.uniform(0, 6)), -1, 1)
    return 20 * shape * (np.abs(shape) > 0.3)


def drive_record(model, noise=(0.3, 0.02), *, seed=0, start=(0.0, 0.0), colour=0.0):
    u = movement(seed=seed)
    e = Experiment(u[:, None], np.full((u.size, 2), np.nan), np.ones(1), 0.005)
    y = Simulator(model).run(e, dict(zip(("theta", "omega"), start, strict=True))).Y
    white = np.random.default_rng(seed + 100).normal(size=y.shape) * noise
    y = y + lfilter([np.sqrt(1 - colour**2)], [1, -colour], white, axis=0)
    units = {"voltage": "V", "speed": "rad/s", "current": "A"}
    return Record({"voltage": u, "speed": y[:, 0], "current": y[:, 1]}, units, sample_time=0.005)


@pytest.fixture(scope="module")
def truth():
    model = load_model("gate-drive").with_values({"R": 0.8, "K": 0.066, "m": 560.0})
    return model.with_effect("coulomb-friction", "shaft", {"tau_c": 0.05})


@pytest.fixture(scope="module")
def records(truth):
    return [
        drive_record(truth, seed=1, start=(0.0, 30.0)),
        drive_record(truth, seed=2, start=(0.0, -80.0)),
    ]


def structure():
    return load_model("gate-drive").with_effect("coulomb-friction", "shaft", {"tau_c": 0.01})


def test_two_records_with_their_own_initial_states(truth, records):
    model, experiments = match(structure(), records)
    result = estimate(model, experiments)
    errors = (result.theta - [truth.values[name] for name in result.parameters]) / result.std
    assert np.all(np.abs(errors) < 4.0), errors
    assert result.converged
    assert [round(x[1], -1) for x in result.initial] == [30.0, -80.0]
    np.testing.assert_allclose(result.rmse, [0.3, 0.02], rtol=0.06)
    assert result.flat == ()


def test_bands_cover_the_truth_at_their_nominal_rate():
    """95 % intervals over 30 noise draws of a linear plant, off its nominal values."""
    truth = (
        load_model("linear-axis")
        .with_values({"M": 70.0})
        .with_effect("viscous-friction", "axis", {"d": 40.0})
    )
    u = movement(600)[:, None] * 5
    e = Experiment(u, np.full((600, 2), np.nan), np.zeros(1), 0.005)
    y = Simulator(truth).run(e).Y
    inside = 0
    for seed in range(30):
        noisy = Experiment(
            u,
            y + np.random.default_rng(seed).normal(size=y.shape) * [1e-4, 1e-3],
            np.zeros(1),
            0.005,
        )
        result = estimate(
            load_model("linear-axis").with_effect("viscous-friction", "axis", {"d": 10.0}), [noisy]
        )
        inside += int(np.sum(np.abs(result.theta - [70.0, 40.0]) < 1.96 * result.std))
    assert 50 <= inside <= 60


def test_speed_alone_cannot_tell_resistance_from_mass(records):
    without_current = [r.select(["voltage", "speed"]) for r in records]
    model, experiments = match(load_model("gate-drive"), without_current)
    result = estimate(model, experiments)
    assert [set(flat.parameters) for flat in result.flat] == [{"R", "m"}] or {"R", "m"} <= set(
        result.flat[0].parameters
    )
    assert np.isinf(result.std[list(result.parameters).index("m")])
    assert np.isfinite(result.std[list(result.parameters).index("K")])


def test_prediction_over_windows_and_likelihood_agree_with_simulation(truth, records):
    model, experiments = match(structure().with_values({"R": 0.8, "m": 560.0}), records[:1])
    cut = estimate(model, [w for e in experiments for w in windows(e, 100)])
    filtered = estimate_by_likelihood(
        model, experiments, free=["K", "coulomb-friction@shaft.tau_c"]
    )
    for result in (cut, filtered):
        assert result.model.values["K"] == pytest.approx(0.066, rel=0.01)
        assert result.model.values["coulomb-friction@shaft.tau_c"] == pytest.approx(0.05, rel=0.25)


def test_coloured_noise_needs_its_filter_for_honest_bands(truth):
    record = drive_record(truth, seed=3, colour=0.95)
    model, experiments = match(structure(), [record])
    plain = estimate(model, experiments)
    filters = [np.array([1.0, -0.95])] * 2
    whitened = estimate(model, experiments, settings=Settings(filters=filters))
    K = list(plain.parameters).index("K")
    assert whitened.std[K] > 2.0 * plain.std[K]
    assert abs(whitened.theta[K] - 0.066) < 4.0 * whitened.std[K]


def test_missing_samples_are_left_out_and_missing_inputs_refused(truth, records):
    speed = np.array(records[0]["speed"])
    speed[200:700] = np.nan
    record = Record({**records[0].channels, "speed": speed}, records[0].units, sample_time=0.005)
    model, experiments = match(structure(), [record])
    result = estimate(model, experiments)
    assert result.model.values["K"] == pytest.approx(0.066, rel=0.01)
    voltage = np.array(record["voltage"])
    voltage[7] = np.nan
    with pytest.raises(BadRecord, match="has no value at sample 7"):
        match(
            structure(),
            [Record({**record.channels, "voltage": voltage}, record.units, sample_time=0.005)],
        )
    with pytest.raises(BadRecord, match="input 'voltage' is missing"):
        match(structure(), [record.select(["speed"])])
    with pytest.raises(
        BadRecord,
        match=r"input 'voltage' is mapped to 'u', which is not there; the columns are .*map={'voltage': 'COLUMN'}",
    ):
        match(structure(), [record], {"voltage": "u"})


def test_columns_are_mapped_and_converted(records):
    rpm = Record(
        {"u": records[0]["voltage"], "n": records[0]["speed"] * 30 / np.pi},
        {"u": "V", "n": "rpm"},
        sample_time=0.005,
    )
    _, [mapped] = match(load_model("gate-drive"), [rpm], {"voltage": "u", "speed": "n"})
    np.testing.assert_allclose(mapped.Y[:, 0], records[0]["speed"], rtol=1e-12)
    assert not mapped.measured[1]


def test_the_missing_term_draws_the_friction_curve(truth, records):
    """Simulated without friction, the smoothed missing torque is −τ_c·sign(v), on each side of standstill."""
    model = truth.without_effect("coulomb-friction")
    model, experiments = match(model, records[:1])
    start = estimate(model, experiments, free=())
    [smoothed] = missing_terms(model, experiments, start.initial)
    term, speed = smoothed.missing["shaft"], smoothed.X[:, 1]
    fast = np.abs(speed) > 60
    assert np.mean(-term.value[fast] * np.sign(speed[fast])) == pytest.approx(0.05, rel=0.05)
    inside = np.abs(term.value[fast] + 0.05 * np.sign(speed[fast])) < 3 * term.std[fast]
    assert np.mean(inside) > 0.9


def test_an_integrating_plant_is_followed_where_simulation_drifts():
    truth = load_model("linear-axis").with_effect("coulomb-friction", "axis", {"tau_c": 20.0})
    n = 2500
    u = 100 * np.sin(np.arange(n) * 0.02) + 10 * np.random.default_rng(0).normal(size=n)
    e = Experiment(u[:, None], np.full((n, 2), np.nan), np.zeros(1), 0.005)
    y = Simulator(truth).run(e).Y + np.random.default_rng(1).normal(size=(n, 2)) * [1e-5, np.nan]
    mass = load_model("linear-axis")
    e = Experiment(u[:, None], y, np.zeros(1), 0.005)
    [smoothed] = missing_terms(mass, [e], [np.zeros(2)])
    v, term = smoothed.X[:, 1], smoothed.missing["axis"].value
    moving = np.abs(v) > 0.3 * np.abs(v).max()
    assert np.mean(-term[moving] * np.sign(v[moving])) == pytest.approx(20.0, rel=0.1)


def test_a_model_that_diverges_at_its_start_is_refused_in_one_line(records):
    model, experiments = match(
        load_model("gate-drive").with_effect("linear-spring", "shaft"), records
    )
    bad = model.with_values({"linear-spring@shaft.k": -1e4})
    with pytest.raises(NotIdentifiable, match="diverges at its starting values"):
        estimate(bad, experiments)


@pytest.mark.skipif(not SILVERBOX.exists(), reason="skipped: no real recordings here")
def test_silverbox_with_a_cubic_spring():
    from scipy.io import loadmat

    data = loadmat(SILVERBOX)
    u, y = (data[name].ravel().astype(float) for name in ("V1", "V2"))
    cut = slice(40650, 40650 + 12000)
    units = {"force": "V", "position": "V"}
    record = Record({"force": u[cut], "position": y[cut]}, units, sample_time=1 / 610.35)
    model, experiments = match(
        load_model("oscillator").with_effect("cubic-spring", "mass"), [record]
    )
    result = estimate(model, experiments)
    assert result.rmse[0] < 1.1e-3
    later = slice(115000, 127400)
    held_out = Record({"force": u[later], "position": y[later]}, units, sample_time=1 / 610.35)
    residual = estimate(result.model, match(result.model, [held_out])[1], free=()).residuals[0][50:]
    assert np.sqrt(np.mean(residual**2)) < 1.1e-3


def test_bands_hold_the_truth_where_the_noise_is_coloured():
    """Of 30 records with noise of ρ = 0.95 nearly all estimates lie within three standard deviations, and these are no larger
    than they must be."""
    model = load_model("gate-drive").with_values({"R": 0.8, "K": 0.066, "m": 560.0})
    scores = []
    for seed in range(30):
        matched, experiments = match(
            model, [drive_record(model, seed=seed, colour=0.95)], hold="linear"
        )
        found = with_coloured_noise(estimate(matched, experiments), experiments)
        known = np.isfinite(found.std)
        truth = np.array([model.values[name] for name in found.parameters])
        scores.append((found.theta[known] - truth[known]) / found.std[known])
    size = np.abs(np.concatenate(scores))
    assert np.mean(size < 3.0) > 0.95 and 0.7 < np.sqrt(np.mean(size**2)) < 1.5


def test_curvature_that_overflows_says_nothing_of_any_parameter():
    covariance, flat = covariance_of(
        np.array([[1e300, 1e308], [1e308, np.inf]]), 1.0, ("a", "b"), np.ones(2)
    )
    assert np.all(np.isinf(np.diag(covariance))) and flat == ()


def test_a_drive_switched_on_with_its_record_begins_without_current():
    """Settled, its current would begin at u/R; the winding's inductance would be sought in an error that is not there."""
    truth = load_model("gate-drive").with_effect("inductance", "winding", {"L": 8e-3})
    u, rng = np.repeat([20.0, -12.0, 20.0, 5.0], 100), np.random.default_rng(3)
    e = Experiment(u[:, None], np.full((u.size, 2), np.nan), np.zeros(1), 1e-3)
    Y = Simulator(truth).run(e, {"i": -20.0 / truth.values["R"]}).Y
    assert Y[0] == pytest.approx([0.0, 0.0])
    e = Experiment(e.U, Y + rng.normal(size=Y.shape) * [0.3, 0.05], e.hold, e.sample_time)
    found = estimate(truth.with_values({"inductance@winding.L": 3e-3, "R": 0.7}), [e])
    assert (
        abs(found.model.values["inductance@winding.L"] - 8e-3)
        < 4 * found.std[found.parameters.index("inductance@winding.L")]
    )
    np.testing.assert_allclose(found.rmse, [0.3, 0.05], rtol=0.1)


def test_curvature_that_underflows_is_scaled_without_overflow():
    H = np.diag([4.0, 1e-320])
    covariance, _ = covariance_of(H, 1.0, ("a", "b"), np.ones(2))
    assert covariance[0, 0] == pytest.approx(0.25)
    np.testing.assert_allclose(
        solve_scaled(H, np.array([[8.0], [1e-320]]))[:, 0], [2.0, 1.0], rtol=1e-3
    )
    # no Gram matrix has it; a sum that overflowed may
    alike = np.array([[4.0, 1e300], [1e300, 1e-320]])
    assert np.all(np.isinf(np.diag(covariance_of(alike, 1.0, ("a", "b"), np.ones(2))[0])))
    assert not solve_scaled(alike, np.ones((2, 1))).any()


def test_readings_whose_predicted_variance_is_none_are_infinitely_unlikely(records):
    drive, experiments = match(load_model("gate-drive"), records[:1])
    noise = Noise(np.full(2, -1.0), {"shaft": 0.0, "winding": 0.0})
    (smoothed,) = missing_terms(drive, experiments, [Simulator(drive).x0({})], noise)
    assert smoothed.log_likelihood == -np.inf
