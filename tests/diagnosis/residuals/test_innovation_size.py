"""What a chosen false-alarm rate rests on: σ without bias, the operating point's own error, alarms counted once."""

import numpy as np
import pytest
from scipy import signal, stats

from residuum.diagnosis.residuals.generators.residual_generator import ResidualSignals
from residuum.diagnosis.residuals.likelihood_ratio import LikelihoodRatioBank, bank_threshold
from residuum.diagnosis.residuals.noise_model import NoiseModel, with_unbiased_size
from residuum.diagnosis.residuals.residual_design import design_residual
from residuum.diagnosis.thresholds.false_alarm_rate import BLOCK, calibrated_threshold
from residuum.identification.kernel_based.impulse_response import identify_impulse_response
from residuum.identification.linear_models.state_space import StateSpace
from residuum.identification.record import Record

TS, STD = 0.1, 0.4
ZEROS, POLES = [0.5, 0.3], [1.0, -1.4, 0.8]


def record(rng, n, mean=0.0):
    u = mean + rng.standard_normal(n)
    y = 7.0 + signal.lfilter([0.0, *ZEROS], POLES, u) + STD * rng.standard_normal(n)
    return Record({"u": u, "y": y}, {"u": "V", "y": "m"}, TS)


@pytest.mark.parametrize("same", [True, False], ids=["the model's own record", "another record"])
def test_the_size_of_the_noise_is_not_flattered_by_the_fit(same):
    """As found, the residual is too small on the model's own record and too large on another."""
    rng, found, plain = np.random.default_rng(1), [], []
    for _ in range(40):
        own, other = record(rng, 400), record(rng, 400)
        model = identify_impulse_response(own, "u", "y", order=60)
        healthy = own if same else other
        residual = healthy["y"] - model.simulate(healthy["u"])
        residual[:60] = np.nan
        noise = NoiseModel(np.ones(1), float(np.nanstd(residual)), n=340)
        plain.append(noise.sigma / STD)
        found.append(with_unbiased_size(noise, [healthy["u"]], [residual], model))
    sizes = np.array([noise.sigma for noise in found]) / STD
    assert np.mean(plain) < 0.98 if same else np.mean(plain) > 1.02
    assert found[0].freedom == 340 - 60 - 1
    assert np.mean(sizes) == pytest.approx(1.0, abs=0.012)
    assert np.std(sizes) == pytest.approx(1.0 / np.sqrt(2.0 * found[0].freedom), rel=0.25)


def test_the_operating_point_is_that_of_the_healthy_records():
    rng = np.random.default_rng(2)
    model = identify_impulse_response(record(rng, 700), "u", "y", order=60)
    design = design_residual(model, None, [record(rng, 2000, mean=5.0)])
    true = 7.0 + 5.0 * sum(ZEROS) / sum(POLES)
    expected = true + (design.input_mean - 5.0) * sum(ZEROS) / sum(POLES)
    assert design.output_mean == pytest.approx(expected, abs=4.0 * STD / np.sqrt(1900))


def test_the_bank_allows_for_the_operating_points_error_but_not_for_faults():
    n, known = 3000, []
    rng = np.random.default_rng(3)
    for _ in range(20):
        scores = rng.standard_normal(n) + 0.15 * rng.standard_normal()
        signals = ResidualSignals(
            scores, scores, scores, np.zeros(n), np.zeros(n), np.ones(n, dtype=bool)
        )
        banks = [
            LikelihoodRatioBank(bank_threshold(1e-6), np.zeros((1, 1)), 1, level_variance=v)
            for v in (0.15**2, 0.0)
        ]
        known.append([bank.process(signals).alarm.any() for bank in banks])
    allowed, ignored = np.sum(known, axis=0)
    assert allowed == 0 and ignored >= 5
    scores[n // 2 :] += 2.0
    assert (
        LikelihoodRatioBank(bank_threshold(1e-6), np.zeros((1, 1)), 1, level_variance=0.15**2)
        .process(signals)
        .alarm[n // 2 : n // 2 + 30]
        .any()
    )


def test_the_limit_allows_for_a_size_that_was_estimated():
    """Scores by a σ̂ of 100 samples, drawn anew each time, cross the limit at the chosen rate; 4 σ they cross more often."""
    noise = NoiseModel(np.ones(1), 1.0, freedom=100.0)
    rng, n = np.random.default_rng(4), 4_000_000
    scores = np.abs(rng.standard_normal(n)) / np.sqrt(rng.chisquare(100.0, n) / 100.0)
    chosen = 2.0 * stats.norm.sf(4.0) * n
    assert np.count_nonzero(scores > noise.allowing_for_size(4.0)) == pytest.approx(
        chosen, rel=0.25
    )
    assert np.count_nonzero(scores > 4.0) > 1.5 * chosen


def test_an_excursion_over_two_blocks_is_one_alarm():
    rate = 2e-4
    peaks = np.abs(np.random.default_rng(5).standard_normal((2000, BLOCK))).max(axis=1)
    alone = calibrated_threshold(peaks, rate, TS)
    twice = calibrated_threshold(np.repeat(peaks, 2), rate, TS)
    assert alone.guaranteed and twice.guaranteed
    assert twice.value < alone.value  # the same number of alarms in twice the time


@pytest.mark.parametrize("q", [1, 2])
def test_a_system_by_modes_is_the_same_system(q):
    rng = np.random.default_rng(6)
    v = rng.standard_normal((400, q))
    for n in (0, 1, 5, 12):
        A = rng.standard_normal((n, n))
        A *= 0.95 / max(np.abs(np.linalg.eigvals(A)).max(initial=0.0), 0.1)
        system = StateSpace(
            A,
            rng.standard_normal((n, q)),
            rng.standard_normal((1, n)),
            rng.standard_normal((1, q)),
            TS,
        )
        w, by_modes = system.simulate(v)[0], system.modal.simulate(v)[0]
        assert np.abs(w - by_modes).max() < 1e-10 * np.abs(w).max()
        first, state = system.modal.simulate(v[:17])
        assert np.array_equal(
            np.concatenate([first, system.modal.simulate(v[17:], state)[0]]), by_modes
        )
    jordan = StateSpace(
        0.5 * np.eye(6) + np.eye(6, k=1), np.ones((6, 1)), np.ones((1, 6)), np.zeros((1, 1)), TS
    )
    assert jordan.modal.simulate(v[:, :1])[0] == pytest.approx(
        jordan.simulate(v[:, :1])[0], abs=1e-9
    )


def test_scores_of_bounded_noise_allow_for_the_models_error():
    noise = NoiseModel(np.ones(1), 1.0, shape=20.0, blur=0.1)
    rng, n = np.random.default_rng(7), 400_000
    epsilon = stats.gennorm(20.0, scale=20.0**0.05).rvs(
        n, random_state=rng
    ) + 0.1 * rng.standard_normal(n)
    chosen = 2.0 * stats.norm.sf(3.5) * n
    assert np.count_nonzero(np.abs(noise.normal_scores(epsilon)) > 3.5) == pytest.approx(
        chosen, rel=0.3
    )
    limit = float(noise.limit(1e-4, 0.1 / noise.innovation_std)) * noise.innovation_std
    assert np.count_nonzero(np.abs(epsilon) > limit) == pytest.approx(1e-4 * n, abs=25)
    without = NoiseModel(np.ones(1), 1.0, shape=20.0)
    assert np.count_nonzero(np.abs(without.normal_scores(epsilon)) > 3.5) > 5.0 * chosen
