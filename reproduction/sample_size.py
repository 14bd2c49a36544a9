"""Fig. 39 and 41: what the two tests of robust performance admit, and how many random plants Algorithm 1 draws."""

import math

import numpy as np
import plotly.graph_objects as go

from reproduction.check import Check, at_least, at_most, near, same
from reproduction.item import Item
from residuum.identification.linear_models.transfer_function import TransferFunction
from residuum.identification.linear_models.uncertainty import chernoff_samples, worst_case_samples
from residuum.robust_control.loop import Loop, Weights

LEVELS = np.arange(1, 51) / 1000
CHOSEN = 0.05


def items(short: bool) -> list[Item]:
    """Fig. 39 and 41."""
    return [_norms(2_000 if short else 20_000), _samples(400 if short else 4_000)]


def _norms(count: int) -> Item:
    """Random pairs |W_S S|, |W_T T|: with G = 1 and K = 1 the loop's cost is that of the pair itself."""
    rng = np.random.default_rng(0)
    pairs = rng.uniform(0, 1.2, (2, count))
    loop = Loop([TransferFunction([1.0], [1.0], 1.0)], np.linspace(0.01, 3.0, count))
    ones = np.ones(count, dtype=complex)
    added, euclidean = (
        loop.cost(ones, Weights(2 * pairs[0], 2 * pairs[1], entries))[0] for entries in ("1", "2")
    )
    meets, passes = added < 1.0, euclidean < 1 / np.sqrt(2)
    checks = [
        same(
            "pairs that pass the Euclidean test and fail the sum", 0, int(np.sum(passes & ~meets))
        ),
        near(
            "share of the pairs with |a| + |b| < 1 that the Euclidean test admits",
            np.pi / 4,
            float(passes[meets].mean()),
            0.06,
        ),
    ]
    figure = go.Figure(layout={"xaxis_title": "|W_S S|", "yaxis_title": "|W_T T|"})
    for name, kept in (("both tests", passes & meets), ("the sum alone", meets & ~passes)):
        figure.add_scatter(
            x=pairs[0, kept][:600],
            y=pairs[1, kept][:600],
            mode="markers",
            marker={"size": 4},
            name=name,
        )
    source = "‖d‖₂ < 1/√2 is sufficient for ‖d‖₁ < 1 and not necessary"
    return Item("Fig. 39", "The two tests of robust performance", source, checks, figures=[figure])


def _samples(experiments: int) -> Item:
    curve = np.array([chernoff_samples(level, 1 - level) for level in LEVELS])
    least = np.array([_least_by_hoeffding(level, level) for level in LEVELS])
    n = chernoff_samples(CHOSEN, 1 - CHOSEN)
    rng = np.random.default_rng(0)
    off = {
        p: float(np.mean(np.abs(rng.binomial(n, p, experiments) / n - p) >= CHOSEN))
        for p in (0.05, 0.5, 0.9)
    }
    worst = worst_case_samples(CHOSEN, 1 - CHOSEN)
    beyond = float(np.mean(1.0 - rng.uniform(size=(experiments, worst)).max(axis=1) > CHOSEN))
    tolerance = 3 * math.sqrt(CHOSEN * (1 - CHOSEN) / experiments)
    checks = [
        same("n_p at ε = ζ = 0.05", 738, n),
        same("n_p at ε = 0.01, ζ = 0.05", 18445, chernoff_samples(0.01, 0.95)),
        same(
            "points of the curve that are the least n of 2 exp(−2ε²n) ≤ ζ",
            len(LEVELS),
            int(np.sum(curve == least)),
        ),
        at_most(
            "how often a fraction of 738 is off by ε or more",
            max(off.values()),
            CHOSEN,
            source="ζ of (2.24)",
        ),
        Check(
            "how often one more draw exceeds the largest of 59 with more than ε",
            "ζ of Tempo, Bai, Dabbene (1997)",
            f"{beyond:.4f}",
            abs(beyond - CHOSEN) <= tolerance,
            f"± {tolerance:.2g} allowed",
        ),
        at_least(
            "n_p of the least level, 0.001, over that of 0.05",
            curve[0] / curve[-1],
            1000.0,
            source="the curve falls steeply",
        ),
    ]
    figure = go.Figure(layout={"xaxis_title": "ε = ζ", "yaxis_title": "n_p", "yaxis_type": "log"})
    figure.add_scatter(x=LEVELS, y=curve, name="lower bound of n_p")
    figure.add_scatter(
        x=[CHOSEN],
        y=[n],
        mode="markers",
        marker={"color": "red", "size": 10},
        name="chosen in section 2.3",
    )
    return Item(
        "Fig. 41",
        "Number of random plants",
        "738 at ε = ζ = 0.05 (red point)",
        checks,
        figures=[figure],
    )


def _least_by_hoeffding(epsilon: float, zeta: float) -> int:
    """The least n with 2 exp(−2ε²n) ≤ ζ, found by halving."""
    low, high = 0, 1
    while 2 * math.exp(-2 * epsilon**2 * high) > zeta:
        low, high = high, 2 * high
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (
            (low, middle) if 2 * math.exp(-2 * epsilon**2 * middle) <= zeta else (middle, high)
        )
    return high
