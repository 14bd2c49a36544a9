"""The .632+ bootstrap of blocks against a computation of its own, and against the error on data that were never seen."""

import numpy as np
import pytest
from scipy import signal

from residuum.identification.errors import NotIdentifiable
from residuum.identification.linear_models.prediction_error import STRUCTURES, Orders, identify
from residuum.identification.linear_models.validation import (
    block_bootstrap,
    cut_into_blocks,
    prediction_errors,
    weighed,
)
from residuum.identification.record import Record

LAGS = 30


def record(seed, n=800):
    rng = np.random.default_rng(seed)
    u = rng.standard_normal(n)
    y = signal.lfilter([0.0, 0.5], [1.0, -0.7], u) + rng.standard_normal(n)
    return Record({"u": u, "y": y}, {"u": "V", "y": "m"}, 1.0)


def fir(records):
    return identify(
        STRUCTURES["fir"], list(records), "u", "y", orders=Orders(nb=LAGS), offset=False
    )


def rows(one):
    u, y = one["u"], one["y"]
    past = np.lib.stride_tricks.sliding_window_view(u[:-1], LAGS)[:, ::-1]
    return past, y[LAGS:]


def test_it_is_what_least_squares_on_the_same_blocks_gives():
    data = record(0)
    model = fir([data])
    found = block_bootstrap(fir, model, [data], repeats=6, seed=3)
    blocks = [rows(block) for block in cut_into_blocks(model, [data])]

    def errors(theta, k):
        e = blocks[k][1] - blocks[k][0] @ theta
        return e - e.mean()

    def least_squares(numbers):
        return np.linalg.lstsq(
            np.vstack([blocks[k][0] for k in numbers]),
            np.concatenate([blocks[k][1] for k in numbers]),
            rcond=None,
        )[0]

    whole = np.linalg.lstsq(*rows(data), rcond=None)[0]
    own = [errors(whole, k) for k in range(len(blocks))]
    rng, left = np.random.default_rng(3), [[] for _ in blocks]
    for _ in range(6):
        drawn = rng.integers(0, len(blocks), len(blocks))
        theta = least_squares(drawn)
        for k in set(range(len(blocks))) - set(drawn):
            left[k].append(np.mean(errors(theta, k) ** 2))
    assert found.apparent == pytest.approx(np.mean([np.mean(e**2) for e in own]), rel=1e-6)
    assert found.out_of_bag == pytest.approx(
        np.mean([np.mean(each) for each in left if each]), rel=1e-6
    )
    ys = [target - target.mean() for _, target in blocks]
    pairs = [np.mean((y[:, None] - (y - e)[None, :]) ** 2) for y, e in zip(ys, own, strict=True)]
    assert found.no_information == pytest.approx(np.mean(pairs), rel=1e-6)


def test_the_error_on_new_data_lies_where_it_says_and_beyond_the_apparent_one():
    said, true, own = [], [], []
    fresh = record(999, 20_000)
    for seed in range(8):
        data = record(seed, 2400)
        model = fir([data])
        found = block_bootstrap(fir, model, [data])
        said.append(found.error)
        own.append(found.apparent)
        true.append(np.nanvar(prediction_errors(model, fresh)))
    assert np.mean(said) == pytest.approx(np.mean(true), rel=0.04)
    assert np.mean(own) < np.mean(said) - 0.02


def test_the_weight_grows_with_overfitting():
    assert weighed(0.1, 0.1, 0.5) == (pytest.approx(0.1), 0.0)  # none: nothing to weigh
    error, overfitting = weighed(0.0, 0.5, 0.5)
    # complete: the apparent error counts for nothing
    assert (error, overfitting) == (pytest.approx(0.5), 1.0)
    assert weighed(0.0, 0.2, 0.5)[0] == pytest.approx(0.2 * 0.632 / (1 - 0.368 * 0.4))


def test_too_few_blocks_are_refused_with_what_would_help():
    data = record(0, 400)
    with pytest.raises(NotIdentifiable, match="record longer, or take a smaller order"):
        block_bootstrap(fir, fir([data]), [data])
