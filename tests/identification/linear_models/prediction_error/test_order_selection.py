"""Order selection: (A.7) equals its plain form, known orders are found, an odd item is seen, refusals."""

import numpy as np
import pytest
from scipy.signal import lfilter

from residuum.identification.errors import BadInput, NotIdentifiable
from residuum.identification.linear_models.prediction_error import STRUCTURES, identify
from residuum.identification.record import Record


def arx_record(seed, n=600, b=(0.8, -0.3), noise=0.3, gain=1.0):
    rng = np.random.default_rng(seed)
    u, e = rng.normal(size=n), noise * rng.normal(size=n)
    y = lfilter([0, *b], [1, -1.2, 0.5], u) + lfilter([1], [1, -1.2, 0.5], e)
    return Record({"u": u, "y": gain * y}, {"u": "V", "y": "m"}, 0.1)


def rows(u, y, order):
    lagged = [-y[order - k : len(y) - k] for k in range(1, order + 1)] + [
        u[order - k : len(u) - k] for k in range(1, order + 1)
    ]
    return np.stack(lagged, axis=1), y[order:]


def plain_error(training, judged, order):
    """Σ e² by scikit-learn's way: fit on the training pieces, sum over the last samples of each judged piece."""
    phi, target = (
        np.concatenate(parts)
        for parts in zip(*(rows(u, y, order) for u, y in training), strict=True)
    )
    theta = np.linalg.lstsq(phi, target, rcond=None)[0]
    errors = [
        (y - phi @ theta)[start - order :]
        for (phi, y), start in ((rows(u, y, order), s) for u, y, s in judged)
    ]
    return sum(e @ e for e in errors), sum(map(len, errors))


def test_block_error_is_that_of_the_plain_form():
    record = arx_record(0)
    u, y = record["u"], record["y"]
    model = identify(
        STRUCTURES["arx"],
        [record],
        "u",
        "y",
        candidates=(1, 2, 3),
        criterion="k-fold",
        folds=4,
        offset=False,
    )
    for order, value in zip((1, 2, 3), model.provenance["k-fold"], strict=True):
        parts = []
        for k in range(4):
            start, stop = 150 * k, 150 * (k + 1)
            training = [(u[a:b], y[a:b]) for a, b in ((0, start), (stop, 600)) if b > a]
            parts.append(plain_error(training, [(u[:stop], y[:stop], start or stop // 4)], order))
        assert value == pytest.approx(sum(p[0] for p in parts) / sum(p[1] for p in parts), rel=1e-9)


def test_record_error_is_that_of_the_plain_form():
    records = [arx_record(seed, n=200 + 100 * seed) for seed in range(3)]
    model = identify(
        STRUCTURES["arx"],
        records,
        "u",
        "y",
        candidates=(1, 2),
        criterion="record-wise",
        offset=False,
    )
    pairs = [(r["u"], r["y"]) for r in records]
    for order, value in zip((1, 2), model.provenance["record-wise"], strict=True):
        parts = [
            plain_error(pairs[:k] + pairs[k + 1 :], [(*pairs[k], len(pairs[k][1]) // 4)], order)
            for k in range(3)
        ]
        assert value == pytest.approx(sum(p[0] for p in parts) / sum(p[1] for p in parts), rel=1e-9)


@pytest.mark.parametrize(("criterion", "penalty"), [("aic", 2.0), ("bic", np.log(600))])
def test_a_coefficient_costs_what_its_criterion_says(criterion, penalty):
    """−2 log p of 600 Gaussian innovations of the variance that is left, and the penalty of two coefficients an order."""
    record = arx_record(0)
    model = identify(
        STRUCTURES["arx"],
        [record],
        "u",
        "y",
        candidates=(1, 2, 3),
        criterion=criterion,
        offset=False,
    )
    u, y = record["u"], record["y"]
    errors = [plain_error([(u, y)], [(u, y, order)], order) for order in (1, 2, 3)]
    variance = np.array([squares / count for squares, count in errors])
    expected = 600 * np.log(variance / variance[0]) + 2 * penalty * np.arange(3)
    found = np.array(model.provenance[criterion])
    assert found - found[0] == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("criterion", ["bic", "k-fold", "record-wise"])
def test_known_order_of_output_error_is_found(criterion):
    """Two records that begin in motion, at levels far from zero: state and level must not be taken for dynamics."""
    rng = np.random.default_rng(3)
    u = rng.normal(size=2000)
    w = lfilter([0, 1.0, 0.5], [1, -1.5, 0.9], u) + 50.0
    y = w + 0.5 * rng.normal(size=2000)
    records = [
        Record({"u": u[a:b], "y": y[a:b]}, {"u": "", "y": ""}, 1.0)
        for a, b in ((30, 1000), (1010, 2000))
    ]
    model = identify(
        STRUCTURES["oe"], records, "u", "y", criterion=criterion, candidates=range(1, 6)
    )
    scores = model.provenance[criterion]
    if criterion == "bic":
        assert model.provenance["orders"] == "nb = 2, nf = 2, nk = 1"
    else:  # a superfluous coefficient costs held-out data next to nothing, a missing one much
        assert scores[0] > 2 * scores[1] and scores[1] < 1.005 * min(scores)
        # the noise variance: no excess from state or level
        assert scores[1] == pytest.approx(0.25, rel=0.15)


def test_record_wise_error_shows_an_odd_item_that_blocks_hide():
    """Item 3 has 1.5 times the gain (an ARX model cannot tell by its past outputs): blocks of it are in every training set."""
    records = [
        arx_record(seed, n=400, noise=0.05, gain=3.0 if seed == 3 else 1.0) for seed in range(4)
    ]
    by_block, by_record = (
        identify(STRUCTURES["fir"], records, "u", "y", candidates=(10, 20), criterion=c).provenance[
            c
        ][1]
        for c in ("k-fold", "record-wise")
    )
    assert by_record > 1.3 * by_block


def test_candidates_are_compared_over_equal_numbers_of_samples():
    """A third coefficient worth 17 in −2 log p. Sums over one sample fewer would cost it another 20, the noise being small."""
    rng = np.random.default_rng(1)
    u = rng.normal(size=300)
    y = lfilter([0, 1.0, 0.5, 2.4e-6], [1], u) + 1e-5 * rng.normal(size=300)
    record = Record({"u": u, "y": y}, {"u": "", "y": ""}, 1.0)
    assert (
        identify(STRUCTURES["fir"], [record], "u", "y", candidates=(2, 3)).provenance["orders"]
        == "nb = 3, nk = 1"
    )


@pytest.mark.parametrize(
    ("criterion", "folds", "error", "rule"),
    [
        ("cv", 5, BadInput, "criterion 'cv': must be one of bic, aic, k-fold, record-wise"),
        ("record-wise", 5, NotIdentifiable, "record-wise: has one record"),
        ("k-fold", 1, NotIdentifiable, "k-fold: 1 blocks"),
        ("k-fold", 100, NotIdentifiable, "100 blocks of a record of 600 samples"),
    ],
)
def test_refusals(criterion, folds, error, rule):
    with pytest.raises(error, match=rule):
        identify(STRUCTURES["arx"], [arx_record(0)], "u", "y", criterion=criterion, folds=folds)
