"""The residual detector as it runs: stream and batch, false alarms, thresholds, estimates, refusals."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import signal, stats

from residuum.diagnosis.diagnosers.robust_residual import RobustResidual
from residuum.diagnosis.residuals.fault_isolation import FaultEstimator
from residuum.diagnosis.residuals.generators.physical_prediction import with_prediction
from residuum.diagnosis.residuals.generators.residual_generator import ResidualSignals
from residuum.diagnosis.residuals.likelihood_ratio import LikelihoodRatioBank, bank_threshold
from residuum.diagnosis.residuals.noise_model import NoiseModel, fit_noise_model
from residuum.diagnosis.residuals.residual_design import ResidualDesign, design_residual
from residuum.diagnosis.residuals.residual_detection import detect
from residuum.diagnosis.thresholds.false_alarm_rate import (
    BLOCK,
    calibrated_threshold,
    cusum,
    cusum_threshold,
    scan_rate,
    scan_threshold,
)
from residuum.diagnosis.thresholds.threshold import bounds, peak_threshold
from residuum.identification.errors import BadInput, BadRecord, BadUnit
from residuum.identification.kernel_based.impulse_response import identify_impulse_response
from residuum.identification.linear_models.transfer_function import TransferFunction
from residuum.identification.linear_models.uncertainty import design_uncertainty_weight
from residuum.identification.physics import estimate, load_model, match
from residuum.identification.record import Record
from residuum.simulation import MACHINES
from residuum.simulation.process import Process

TS = 0.1
PROCESS = TransferFunction([47619.0], [1.0, 234.0136, 6857.1, 5442.2]).discretise(TS)
# of the noise at a variance ratio of 9
STD = float(np.sqrt(np.sum(PROCESS.simulate(np.eye(1, 2000)[0]) ** 2) / 9.0))


def record(seed, n, *, mean=0.0, noise=None):
    rng = np.random.default_rng(seed)
    u = mean + rng.standard_normal(n)
    e = STD * (rng.standard_normal(n) if noise is None else noise(rng, n))
    return Record({"u": u, "y": PROCESS.simulate(u) + e}, {"u": "V", "y": "m"}, TS)


def faulty(healthy, change):
    return replace(healthy, channels={"u": healthy["u"], "y": change(np.array(healthy["y"]))})


@pytest.fixture(scope="module")
def model():
    return identify_impulse_response(record(1, 5000).window(1000, 5000), "u", "y", order=100)


@pytest.fixture(scope="module")
def design(model):
    weight = design_uncertainty_weight(model, order=2).weight
    return design_residual(model, weight, [record(2, 20000).window(1000, 20000)])


@pytest.fixture(scope="module")
def diagnoser(design):
    return RobustResidual()._use(design)


def blocks(n, seed):
    cuts = np.sort(np.random.default_rng(seed).integers(0, n, 40))
    return zip([0, *cuts], [*cuts, n], strict=True)


def test_stream_equals_batch_and_can_be_resumed(diagnoser):
    data = faulty(record(3, 3000), lambda y: y + 1.0 * (np.arange(3000) > 2000))
    whole_signals, whole_bank = diagnoser.stream().process(data["u"], data["y"])
    monitor, parts = diagnoser.stream(), []
    for start, stop in blocks(3000, 4):
        state, monitor = monitor.state, diagnoser.stream()
        monitor.resume(state)
        parts.append(monitor.process(data["u"][start:stop], data["y"][start:stop]))
    for name in ResidualSignals._fields:
        assert np.array_equal(
            np.concatenate([getattr(part, name) for part, _ in parts]), getattr(whole_signals, name)
        ), name
    assert np.array_equal(
        np.concatenate([part.statistic for _, part in parts]), whole_bank.statistic
    )
    assert whole_bank.alarm.any()


def test_a_gap_starts_anew_and_is_counted(diagnoser):
    data = record(5, 2000)
    y = np.array(data["y"])
    y[700:705] = np.nan
    monitor = diagnoser.stream()
    signals, bank = monitor.process(data["u"], y)
    memory = diagnoser.design.generator.warm_up
    assert monitor.gaps == 1 and not bank.alarm.any()
    assert not signals.valid[700 : 705 + memory].any() and signals.valid[705 + memory :].all()
    with pytest.raises(BadInput, match="another design"):
        diagnoser.stream().resume({"residual": {}, "bank": {}})


def test_step_of_three_within_a_second_and_of_one_within_ten(design):
    for size, limit in ((3.0, 10), (1.0, 100)):
        data = faulty(record(6, 6000), lambda y, size=size: y + size * (np.arange(6000) >= 4000))
        found = detect(design, data, false_alarms_per_day=1.0)
        assert 4000 <= found.first_alarm <= 4000 + limit
        assert (
            found.estimate.kind == "sensor-offset"
            and abs(found.estimate.value - size) < 4 * found.estimate.std
        )


@pytest.mark.parametrize(
    ("noise", "slack"),
    [
        (None, (0.5, 2.0)),
        (lambda rng, n: signal.lfilter([0.8], [1.0, -0.6], rng.standard_normal(n)), (0.5, 2.0)),
        (lambda rng, n: rng.standard_t(3, n) / np.sqrt(3), (0.5, 2.0)),
        (lambda rng, n: rng.uniform(-1, 1, n) * np.sqrt(3), (0.5, 2.0)),
    ],
    ids=["gaussian", "coloured", "heavy-tailed", "bounded"],
)
def test_chosen_false_alarm_rate_is_met(noise, slack):
    rng = np.random.default_rng(7)
    white = rng.standard_normal if noise is None else lambda n: noise(rng, n)
    fitted = fit_noise_model([white(200_000)])
    n, rate = 600_000, 1e-4  # some sixty alarms
    scores = fitted.normal_scores(np.nan_to_num(fitted.whiten(white(n))))
    template = signal.lfilter([1.0], [1.0, -0.9], rng.standard_normal(n))
    bank = LikelihoodRatioBank(bank_threshold(rate), np.zeros((1, 1)), 1)
    alarms = bank.process(
        ResidualSignals(scores, scores, scores, template, template, np.ones(n, dtype=bool))
    ).alarm.sum()
    assert slack[0] < alarms / (rate * n) < slack[1]


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_residual_a_million_times_too_large_alarms_and_no_more(sign):
    scores, zero = np.random.default_rng(31).standard_normal(400), np.zeros(400)
    scores[200:] += sign * 1e6
    signals = ResidualSignals(scores, scores, scores, zero, zero, np.ones(400, dtype=bool))
    bank = LikelihoodRatioBank(bank_threshold(1e-6), np.zeros((1, 1)), 1)
    assert int(np.argmax(bank.process(signals).alarm)) == 200


def test_the_bank_allows_for_model_error_but_not_for_faults():
    """A wrong gain within its own variance must not alarm although the input is large; the same residual alone must."""
    n, m = 2000, 5
    rng = np.random.default_rng(8)
    u = 20.0 + rng.standard_normal(n)
    covariance = 1e-3 * np.eye(m)
    alarms = []
    for _ in range(20):
        error = rng.multivariate_normal(np.zeros(m), covariance)
        e = rng.standard_normal(n) + signal.lfilter(np.concatenate([[0.0], error]), 1.0, u)
        valid = np.arange(n) > m
        signals = ResidualSignals(e, e, np.where(valid, e, 0.0), np.zeros(n), u, valid)
        alarms.append(
            [
                LikelihoodRatioBank(bank_threshold(1e-6), c, 1).process(signals).alarm.any()
                for c in (covariance, 0 * covariance)
            ]
        )
    known, ignored = np.array(alarms).sum(axis=0)
    assert known == 0 and ignored >= 15


def test_cusum_rate_and_single_window_rate_are_the_closed_forms():
    x = np.random.default_rng(9).standard_normal(2_000_000)
    h = cusum_threshold(1e-4, 0.5)
    assert np.count_nonzero(
        cusum(x, np.ones(len(x), dtype=bool), 0.5, h).alarm
    ) / 200 == pytest.approx(1.0, abs=0.3)
    b = scan_threshold(1e-5, [(2, [1])])
    assert 2 * scan_rate(b, [1]) == pytest.approx(1e-5, rel=1e-6)
    assert 2 * stats.norm.sf(b) == pytest.approx(1e-5, rel=0.1)
    assert bank_threshold(1e-6, 1024) > bank_threshold(1e-4, 1024)


def test_peak_threshold_is_never_exceeded_and_is_nearly_reached(design):
    """Worst signals within the bounds: those that match the sign of each impulse response, and a million random ones."""
    input_bound, noise_bound = 2.0, 0.7
    tau = peak_threshold(design, input_bound, noise_bound).level
    path = design.generator.taps
    n = 3000
    impulse = np.eye(1, n)[0]
    from_noise = design.post_filter.Q.simulate(impulse[:, None])[0][:, 0]
    from_error = design.post_filter.Q.simulate(
        design.W_T.simulate(np.convolve(impulse, path)[:n])[:, None]
    )[0][:, 0]
    worst = noise_bound * np.abs(from_noise).sum() + input_bound * np.abs(from_error).sum()
    assert 0.999 * tau < worst <= tau * (1 + 1e-9)
    rng = np.random.default_rng(10)
    for _ in range(20):
        e = noise_bound * np.sign(
            signal.lfilter([1.0], [1.0, -rng.uniform(-0.99, 0.99)], rng.standard_normal(50_000))
        )
        error = input_bound * np.sign(
            signal.lfilter([1.0], [1.0, -rng.uniform(-0.99, 0.99)], rng.standard_normal(50_000))
        )
        y = e + design.W_T.simulate(np.convolve(error, path)[:50_000])
        assert np.abs(design.post_filter.Q.simulate(y[:, None])[0]).max() <= tau


def test_source_threshold_has_no_healthy_exceedance_and_sees_thirty_at_once(design):
    healthy = record(11, 2600)
    assert detect(design, healthy, threshold="source").first_alarm is None
    found = detect(
        design, faulty(healthy, lambda y: y + 30.0 * (np.arange(2600) >= 1500)), threshold="source"
    )
    assert found.first_alarm == 1500
    with pytest.raises(BadInput, match="point"):
        detect(design, healthy, threshold="peak", evaluation="glr")


def test_posterior_point_threshold_follows_the_input(design):
    data = record(12, 3000)
    u = np.array(data["u"])
    u[1500:] += 60.0
    y = PROCESS.simulate(u) + np.array(data["y"]) - PROCESS.simulate(data["u"])
    found = detect(design, replace(data, channels={"u": u, "y": y}), evaluation="point")
    assert np.median(found.threshold.level[2000:]) > 1.5 * np.median(
        found.threshold.level[500:1400]
    )


def test_calibrated_threshold_promises_only_what_its_data_bear():
    rng = np.random.default_rng(13)
    rate = 1e-5
    plenty = calibrated_threshold(np.abs(rng.standard_normal((4000, BLOCK))).max(axis=1), rate, TS)
    little = calibrated_threshold(np.abs(rng.standard_normal((200, BLOCK))).max(axis=1), rate, TS)
    truth = -np.sqrt(2) * float(__import__("scipy.special").special.erfcinv(rate)) * -1
    assert plenty.guaranteed and not little.guaranteed and little.days < little.days_needed
    assert plenty.value == pytest.approx(truth, rel=0.12) and little.value == pytest.approx(
        truth, rel=0.2
    )
    with pytest.raises(BadInput, match="blocks"):
        calibrated_threshold(np.ones(3), rate, TS)


def test_size_is_unbiased_and_its_band_covers():
    """Over 100 faults of known size, at operating points off the origin; the model is drawn anew from its covariance."""
    rng = np.random.default_rng(14)
    model = identify_impulse_response(record(15, 4000), "u", "y", order=100)
    base = design_residual(model, None, [record(16, 4000, mean=3.0)])
    errors = []
    for drawn in model.sample(100, seed=17):
        u = 3.0 + rng.standard_normal(600)
        offset = rng.choice([-1.0, 1.0]) * rng.uniform(1.0, 4.0)
        moved = np.convolve(np.concatenate([[0.0], drawn]), u - base.input_mean)[:600]
        y = base.output_mean + moved + base.noise.sigma * rng.standard_normal(600)
        y += offset * (np.arange(600) >= 300)
        found = FaultEstimator(base.generator, model.covariance, model.delay).estimate(u, y, 310)
        errors.append(((found.value - offset) / found.std, found.kind))
    # another kind's size has another unit
    z = np.array([error for error, kind in errors if kind == "sensor-offset"])
    assert sum(kind == "sensor-offset" for _, kind in errors) >= 95
    assert abs(z.mean()) < 0.35
    assert 0.90 <= np.mean(np.abs(z) < 1.96) <= 0.99


@pytest.mark.parametrize(
    "fault", ["sensor-offset", "sensor-drift", "actuator-gain", "stuck-sensor"]
)
def test_finds_and_names_every_fault_of_the_process_machine(fault):
    def window(machine, seconds):
        part = next(iter(machine.advance(seconds).values()))
        return Record(dict(part.channels), dict(part.units), part.sample_time)

    diagnoser = RobustResidual().fit([window(Process(seed=21), 400.0)])
    machine = Process(seed=22)
    assert diagnoser.score(window(machine, 60.0)).verdict == "healthy"
    machine.set_fault(fault)
    for _ in range(2):
        finding = diagnoser.score(window(machine, 60.0))
        assert (finding.verdict, finding.fault_class) == ("faulty", fault), finding.reason
    machine.clear_fault(fault)
    window(machine, 20.0)
    assert diagnoser.score(window(machine, 60.0)).verdict == "healthy"


def test_structured_error_in_healthy_records_is_said_not_hidden():
    """A plant with a square in it, modelled as linear: the threshold widens and says why; with the effect it is narrow."""
    rng = np.random.default_rng(23)
    u = signal.lfilter([0.3], [1.0, -0.95], rng.standard_normal(5000))
    y = PROCESS.simulate(u + 0.3 * u**2) + 0.2 * rng.standard_normal(5000)
    crude = RobustResidual().fit([Record({"u": u, "y": y}, {"u": "", "y": ""}, TS)])
    informed = RobustResidual().fit([Record({"u": u + 0.3 * u**2, "y": y}, {"u": "", "y": ""}, TS)])
    assert crude.design.structured_p < 1e-3 <= informed.design.structured_p
    finding = crude.score(Record({"u": u[:600], "y": y[:600]}, {"u": "", "y": ""}, TS))
    assert "explain" in finding.reason and finding.evidence["model_explains_healthy_data"] is False
    assert finding.verdict == "healthy"
    assert (
        crude._threshold * crude.design.noise.sigma
        > 1.5 * informed._threshold * informed.design.noise.sigma
    )


def test_with_the_missing_effect_added_a_far_smaller_fault_is_found():
    """Dry friction that the model lacks hides an offset of 1 rad/s; the prediction with friction lets a tenth of that be seen."""
    machine = MACHINES["gate-drive"](
        seed=3, effects={"coulomb-friction": {}}, profile="rich", rate=50.0
    )
    training, window = drive_record(machine, 60.0), drive_record(machine, 20.0)
    found = {}
    for effects in ((), ("coulomb-friction",)):
        model = load_model("gate-drive")
        for effect in effects:
            model = model.with_effect(effect, "shaft", {"tau_c": 0.05})
        matched, experiments = match(model, [training])
        fitted = estimate(matched, experiments).model
        diagnoser = RobustResidual(input="prediction", output="speed").fit(
            [with_prediction(fitted, training, "speed")]
        )
        predicted = with_prediction(fitted, window, "speed")
        assert diagnoser.score(predicted).verdict == "healthy"
        after = np.arange(window.n) > window.n // 2
        offset = {
            size: diagnoser.score(
                replace(
                    predicted,
                    channels={**predicted.channels, "speed": predicted["speed"] + size * after},
                )
            )
            for size in (0.3, 1.0)
        }
        found[effects] = [offset[size].verdict for size in (0.3, 1.0)]
        if not effects:
            assert "residuum improve" in offset[1.0].reason
    assert found == {(): ["healthy", "healthy"], ("coulomb-friction",): ["faulty", "faulty"]}
    with pytest.raises(BadInput, match="no output 'torque'"):
        with_prediction(load_model("gate-drive"), window, "torque")


def drive_record(machine, seconds):
    signals = machine.simulate(seconds)
    names = ("voltage", "speed")
    channels, units = (
        {name: of[name] for name in names} for of in (signals.channels, signals.units)
    )
    return Record(channels, units, signals.sample_time)


def test_an_offset_of_one_sigma_is_found_as_fast_as_by_a_cusum_made_for_it():
    rate, n, onset = 1.0 / 864_000.0, 400, 100
    h, delays = cusum_threshold(rate, 0.5), []
    for seed in range(150):
        scores = np.random.default_rng([seed, 13]).standard_normal(n) + (np.arange(n) >= onset)
        nothing, valid = np.zeros(n), np.ones(n, dtype=bool)
        bank = LikelihoodRatioBank(bank_threshold(rate), np.zeros((1, 1)), 1)
        ours = bank.process(ResidualSignals(scores, scores, scores, nothing, nothing, valid)).alarm
        theirs = cusum(scores, valid, 0.5, h).alarm != 0
        delays.append([np.argmax(ours[onset:]), np.argmax(theirs[onset:])])
    ours, theirs = np.mean(delays, axis=0)
    assert ours < theirs + 0.5


def test_few_structured_healthy_peaks_widen_the_threshold_without_extrapolation(design):
    fields = {name: getattr(design, name) for name in design.__dataclass_fields__}
    short = ResidualDesign(
        **fields | {"peaks": {"glr": np.array([4.0, 9.0, 6.0])}, "structured_p": 1e-6}
    )
    assert RobustResidual()._use(short)._threshold == pytest.approx(13.5)


def test_unfit_records_are_refused(design):
    good = record(24, 1000)
    with pytest.raises(BadRecord, match="sample time"):
        detect(design, replace(good, sample_time=0.2))
    with pytest.raises(BadUnit, match="cannot be converted"):
        detect(design, replace(good, units={"u": "V", "y": "K"}))
    with pytest.raises(BadRecord, match="look swapped"):
        detect(design, replace(good, channels={"u": good["y"], "y": good["u"]}))
    with pytest.raises(BadInput, match="memory"):
        detect(design, good.window(0, 60))
    with pytest.raises(BadInput, match="false alarms per day"):
        detect(design, good, false_alarms_per_day=-1.0)
    centimetres = detect(
        design,
        replace(
            good,
            channels={"u": good["u"], "y": 100 * np.array(good["y"])},
            units={"u": "V", "y": "cm"},
        ),
    )
    assert centimetres.first_alarm is None


def test_an_output_that_stands_still_from_the_start_is_stuck_and_not_swapped(design):
    still = record(26, 1000)
    y = np.array(still["y"])
    y[20:] = y[20]
    found = detect(design, replace(still, channels={"u": still["u"], "y": y}))
    assert found.estimate.kind == "stuck-sensor" and found.estimate.onset == 20


def test_an_absurd_reading_is_an_alarm_and_no_failure(design):
    data = record(27, 1500)
    y = np.array(data["y"])
    y[1000] = np.finfo(np.float32).max
    found = detect(design, replace(data, channels={"u": data["u"], "y": y}))
    assert found.first_alarm == 1000


def test_stored_design_is_the_same_design(design, tmp_path):
    design.save(tmp_path / "d")
    loaded = ResidualDesign.load(tmp_path / "d")
    data = record(25, 1500)
    for kind in ("posterior", "peak", "source", "calibrated"):
        one, other = (detect(part, data, threshold=kind) for part in (design, loaded))
        assert (
            np.array_equal(one.statistic, other.statistic)
            and one.threshold.typical == other.threshold.typical
        )
    assert bounds(loaded, np.zeros(3)) == bounds(design, np.zeros(3))


def test_a_dead_residual_is_refused():
    with pytest.raises(BadInput, match="does not vary"):
        fit_noise_model([np.zeros(500)])
    with pytest.raises(BadInput, match="sigma"):
        NoiseModel(np.ones(1), 0.0)


def test_a_window_with_input_and_output_exchanged_is_not_called_faulty():
    healthy = record(30, 3000)
    diagnoser = RobustResidual().fit([healthy])
    exchanged = replace(healthy, channels={"u": healthy["y"], "y": healthy["u"]})
    finding = diagnoser.score(exchanged)
    assert finding.verdict == "not-assessable" and "look swapped" in finding.reason


def test_bounded_noise_gives_away_no_power():
    """Scores of uniform noise are normal, so a small offset is found sooner than under Gaussian noise of the same size."""
    rng = np.random.default_rng(21)
    delays = {}
    for name, draw in (
        ("gaussian", rng.standard_normal),
        ("uniform", lambda n: np.sqrt(3) * rng.uniform(-1, 1, n)),
    ):
        fitted = fit_noise_model([draw(50_000)])
        found = []
        for _ in range(40):
            scores = fitted.normal_scores(
                np.nan_to_num(fitted.whiten(draw(600) + 0.7 * (np.arange(600) >= 200)))
            )
            zero, valid = np.zeros(600), np.ones(600, dtype=bool)
            bank = LikelihoodRatioBank(bank_threshold(1e-6), np.zeros((1, 1)), 1)
            found.append(
                int(
                    np.argmax(
                        bank.process(
                            ResidualSignals(scores, scores, scores, zero, zero, valid)
                        ).alarm[200:]
                    )
                )
            )
        delays[name] = np.mean(found)
    assert delays["uniform"] < 0.5 * delays["gaussian"]


@pytest.mark.parametrize("shape", [2.0, 3.0, 8.0])
def test_light_tails_are_recovered_and_bounds_hold(shape):
    rng = np.random.default_rng(22)
    e = 3.0 * stats.gennorm.rvs(shape, scale=shape ** (1 / shape), size=100_000, random_state=rng)
    fitted = fit_noise_model([e])
    assert fitted.shape == pytest.approx(shape, rel=0.1) and fitted.innovation_std == pytest.approx(
        e.std(), rel=0.02
    )
    assert np.mean(np.abs(e) / fitted.innovation_std > fitted.limit(1e-3)) == pytest.approx(
        1e-3, rel=0.5
    )
    assert (
        fitted.normal_scores(np.array([-1e9, 0.0, 1e9]))
        == pytest.approx([-141.0, 0.0, 141.0], abs=1.0)
        or shape == 2.0
    )
