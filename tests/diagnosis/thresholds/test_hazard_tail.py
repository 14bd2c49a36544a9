"""Tails taken from healthy samples: found where the noise's form is contradicted, left alone where it is not, rates met."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import signal, stats

from residuum.diagnosis.residuals.noise_model import (
    NoiseModel,
    fit_noise_model,
    single_sample_law,
    with_healthy_tail,
)
from residuum.diagnosis.residuals.residual_design import ResidualDesign, design_residual
from residuum.diagnosis.residuals.residual_detection import detect
from residuum.diagnosis.thresholds.tails import HazardTail, differing_tail, fit_hazard_tail
from residuum.identification.kernel_based.impulse_response import identify_impulse_response
from residuum.identification.record import Record

ERROR = 0.1
RATE = 1e-3


def uniform(rng, n):
    return np.sqrt(3.0) * rng.uniform(-1.0, 1.0, n)


def clipped(rng, n):
    return np.clip(rng.standard_normal(n), -3.0, 3.0)


def truncated(rng, n):
    drawn = rng.standard_normal(int(1.01 * n) + 100)
    return drawn[np.abs(drawn) < 3.0][:n]


def laplace(rng, n):
    return rng.laplace(size=n) / np.sqrt(2.0)


def normal_tail(x):
    return np.log(2.0) + stats.norm.logsf(x)


def test_a_level_and_its_probability_are_inverse():
    for tail in (
        HazardTail(2.0, 0.01, 3.0, 0.0),
        HazardTail(1.5, 0.02, 0.0, 50.0),
        HazardTail(1.5, 0.02, 2.0, 10.0),
    ):
        probabilities = np.array([0.01, 1e-4, 1e-9])
        assert np.exp(tail.log_probability(tail.level(probabilities))) == pytest.approx(
            probabilities, rel=1e-9
        )


@pytest.mark.parametrize(("hazard", "growth"), [(2.0, 0.0), (1.0, 5.0), (0.0, 3.0)])
def test_hazard_and_its_growth_are_recovered(hazard, growth):
    nats = np.random.default_rng(1).exponential(size=100_000)
    excess = 2.0 * nats / (hazard + np.sqrt(hazard**2 + 2.0 * growth * nats))
    found = fit_hazard_tail(excess)
    assert found == pytest.approx((hazard, growth), abs=0.1)


@pytest.mark.parametrize("seed", range(5))
def test_samples_that_follow_their_law_keep_it(seed):
    assert differing_tail(np.random.default_rng(seed).standard_normal(20_000), normal_tail) is None


@pytest.mark.parametrize("draw", [clipped, laplace, uniform])
def test_a_tail_that_differs_is_found_and_its_rate_met(draw):
    rng = np.random.default_rng(2)
    tail = differing_tail(draw(rng, 20_000) + ERROR * rng.standard_normal(20_000), normal_tail)
    fresh = np.abs(draw(rng, 1_000_000) + ERROR * rng.standard_normal(1_000_000))
    assert 0.5 < np.mean(fresh > tail.level(RATE)) / RATE < 2.0


def test_a_tail_that_is_cut_off_far_out_is_not_fitted_from_where_it_still_looks_whole():
    """Of 50 000 truncated Gaussian samples the 1000 largest fit a hazard that misses the cut; their far end says so."""
    rng = np.random.default_rng(10)
    fresh, ratios = np.abs(truncated(rng, 2_000_000) + ERROR * rng.standard_normal(2_000_000)), []
    for _ in range(5):
        tail = differing_tail(
            truncated(rng, 50_000) + ERROR * rng.standard_normal(50_000), normal_tail
        )
        ratios.append(np.mean(fresh > tail.level(1e-4)) / 1e-4)
    assert 0.5 < np.mean(ratios) < 2.0


def test_too_few_samples_show_no_tail():
    assert differing_tail(uniform(np.random.default_rng(3), 900), normal_tail) is None


@pytest.mark.parametrize("draw", [clipped, uniform])
@pytest.mark.parametrize(("error", "least"), [(0.03, 0.25), (ERROR, 0.5), (0.3, 0.5), (1.0, 0.5)])
def test_the_limit_of_bounded_noise_follows_the_model_error(draw, error, least):
    """A single sample's limit from records whose model error is 0.1 σ: where it grows the rate is met, where it shrinks kept."""
    rng = np.random.default_rng(4)
    healthy = draw(rng, 50_000) + ERROR * rng.standard_normal(50_000)
    law = single_sample_law([healthy], 1.0, np.full(50_000, ERROR))
    fresh = np.abs(draw(rng, 2_000_000) + error * rng.standard_normal(2_000_000))
    level = law.innovation_std * float(law.limit(RATE, error / law.innovation_std))
    assert least < np.mean(fresh > level) / RATE < 2.0


def test_scores_of_clipped_noise_are_normal_beyond_its_bound():
    rng = np.random.default_rng(5)
    e = clipped(rng, 50_000) + ERROR * rng.standard_normal(50_000)
    plain = replace(fit_noise_model([e]), blur=ERROR)
    scores = with_healthy_tail(plain, [e]).normal_scores(
        clipped(rng, 2_000_000) + ERROR * rng.standard_normal(2_000_000)
    )
    chosen = 2.0 * stats.norm.sf(3.5)
    assert 0.5 < np.mean(np.abs(scores) > 3.5) / chosen < 2.0
    assert np.mean(np.abs(plain.normal_scores(e)) > 3.5) < 0.1 * chosen


@pytest.fixture(scope="module")
def bounded_design():
    rng = np.random.default_rng(6)

    def record(n):
        u = rng.standard_normal(n)
        y = signal.lfilter([0.0, 0.5, 0.3], [1.0, -1.4, 0.8], u) + 0.4 * clipped(rng, n)
        return Record({"u": u, "y": y}, {"u": "V", "y": "m"}, 0.1)

    healthy = record(40_000)
    model = identify_impulse_response(healthy.window(0, 4000), "u", "y", order=60)
    return design_residual(model, None, [healthy]), record(400_000)


@pytest.mark.parametrize("evaluation", ["point", "rms"])
def test_single_samples_and_short_windows_of_bounded_noise_alarm_as_often_as_chosen(
    bounded_design, evaluation
):
    design, fresh = bounded_design
    per_day = 300.0
    alarm = np.flatnonzero(
        detect(design, fresh, evaluation=evaluation, false_alarms_per_day=per_day).alarm
    )
    alarms = len(alarm) - int(np.sum(np.diff(alarm) <= 50))
    assert 0.5 < alarms / (per_day * fresh.n * 0.1 / 86400.0) < 2.0


def test_a_stored_design_keeps_its_tails(bounded_design, tmp_path):
    design, fresh = bounded_design
    assert design.noise.tail is not None and design.robust_noise.tail is not None
    design.save(tmp_path / "bounded.design")
    again = ResidualDesign.load(tmp_path / "bounded.design")
    assert (
        again.noise.tail == design.noise.tail
        and again.robust_noise.tail == design.robust_noise.tail
    )
    part = fresh.window(0, 2000)
    levels = [detect(item, part, evaluation="point").threshold.level for item in (design, again)]
    assert np.array_equal(*levels)


def test_without_healthy_records_the_limit_is_that_of_the_noise_model(bounded_design):
    model = bounded_design[0].model
    design = design_residual(model, None)
    noise = design.single_sample_noise
    assert isinstance(noise, NoiseModel) and noise.is_gaussian
    assert noise.innovation_std == pytest.approx(design.robust_spread)
