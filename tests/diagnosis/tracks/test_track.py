"""A value over many windows: kinds of change are told apart, what it moves with is taken off, and the time to a limit holds."""

import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest

from residuum.diagnosis.tracks import track
from residuum.identification.errors import BadInput, NotIdentifiable

_file = Path(__file__).parents[3] / "benchmarks" / "time_to_limit.py"
_spec = importlib.util.spec_from_file_location("time_to_limit", _file)
benchmark = sys.modules.setdefault(_spec.name, importlib.util.module_from_spec(_spec))
_spec.loader.exec_module(benchmark)


def irregular(n, seed, scatter=0.1):
    rng = np.random.default_rng(seed)
    return (
        np.cumsum(rng.exponential(1.0, n)),
        scatter * rng.standard_normal(n),
        np.full(n, scatter),
        rng,
    )


def test_the_band_of_the_time_to_the_limit_holds_the_truth_as_often_as_it_says():
    told = [
        benchmark.linear_wear(seed, later=later) for seed in range(60) for later in (False, True)
    ]
    said = [each.side for each in told if each.said]
    assert len(said) > 0.8 * len(told)
    assert 0.85 <= said.count(0) / len(said) <= 0.95


@pytest.mark.parametrize("kind", ["steady", "sudden-change", "recovery"])
def test_kinds_are_told_apart(kind):
    called = [benchmark.unworn(seed, kind).kind for seed in range(25)]
    assert called.count(kind) >= 24


def test_without_a_trend_it_says_that_it_cannot_say():
    t, noise, std, _ = irregular(60, 1)
    left = track(t, noise, std, limit=1.0).remaining
    assert left.median is None and left.says == "cannot say: there is no trend"
    away = track(t, noise - 0.05 * t, std, limit=1.0).remaining
    assert away.median is None and "away from the limit" in away.says
    assert (
        track(t, noise + 0.05 * t, std, limit=float(0.05 * t[-1])).remaining.says
        == "the limit is reached"
    )


def test_what_it_moves_with_is_no_drift():
    t, noise, std, rng = irregular(80, 2)
    temperature = 20.0 + 0.1 * t + rng.standard_normal(80)
    y = 5.0 + 0.3 * temperature + noise
    assert track(t, y, std).kind == "drift"
    corrected = track(t, y, std, moves_with=temperature)
    assert corrected.kind == "steady" and np.std(corrected.corrected) < 0.2


def test_a_repair_ends_a_drift_and_its_time_is_found():
    t, noise, std, _ = irregular(90, 3)
    y = np.where(t < t[50], 0.04 * t, 0.0) + noise
    found = track(t, y, std, healthy=(-0.3, 0.3), limit=3.0)
    assert found.kind == "recovery" and abs(found.since - t[50]) < 3.0
    assert found.remaining.median is None


def test_a_limit_below_is_reached_from_above():
    t, noise, std, _ = irregular(60, 4)
    left = track(t, 10.0 - 0.05 * t + noise, std, limit=4.0).remaining
    truth = 6.0 / 0.05 - t[-1]
    assert left.low < truth < left.high


def test_bad_input_is_refused():
    with pytest.raises(BadInput, match="times rising"):
        track([1.0, 1.0, 2.0], [0.0, 0.0, 0.0])
    with pytest.raises(NotIdentifiable, match="at least 8"):
        track(np.arange(12.0), [np.nan] * 6 + [0.0] * 6)
