"""Examples 1.2–1.4: scatter of least-squares estimates, and whether their ellipses cover the truth."""

from collections.abc import Mapping, Sequence

import numpy as np
import plotly.graph_objects as go
from scipy.signal import lfilter
from scipy.stats import binom, chi2

from reproduction.check import Check, near, within
from reproduction.item import Item
from residuum.identification.linear_models.identified_model import IdentifiedModel
from residuum.identification.linear_models.prediction_error import (
    STRUCTURES,
    Orders,
    identify,
    in_confidence_ellipsoid,
)
from residuum.identification.record import Record

A, B, INPUT_VARIANCE = 0.4, 0.6, 0.4
CASES = ((200, 0.4), (200, 1.0), (1300, 0.4), (1300, 1.0))
SHOWN = 50
LEVEL = 0.95
SHORT_RECORD = 0.02
"""(1.107) and (1.113) are first order: so far below its level the coverage of 200 samples may lie."""
FREQUENCIES = np.linspace(0.05, 3.1, 12)
Runs = Mapping[tuple[int, float], Sequence[IdentifiedModel]]


def items(short: bool) -> list[Item]:
    """Fig. 25–28 (scatter), 29–30 (parameter ellipses), 31–32 (Nyquist ellipses)."""
    runs = {
        case: [_estimate(*case, seed) for seed in range(150 if short else 1000)] for case in CASES
    }
    return [_scatter(runs), _parameter_ellipses(runs), _nyquist_ellipses(runs)]


def _estimate(n: int, noise_variance: float, seed: int) -> IdentifiedModel:
    rng = np.random.default_rng([seed, n, int(10 * noise_variance)])
    u = np.sqrt(INPUT_VARIANCE) * rng.normal(size=n)
    y = lfilter([0, B], [1, A], u) + lfilter(
        [1], [1, A], np.sqrt(noise_variance) * rng.normal(size=n)
    )
    record = Record({"u": u, "y": y}, {"u": "", "y": ""}, 1.0)
    return identify(STRUCTURES["arx"], [record], "u", "y", orders=Orders(na=1, nb=1), offset=False)


def _theta(model: IdentifiedModel) -> np.ndarray:
    return np.array([model.denominator[1], model.numerator[0]])


def _scatter(runs: Runs) -> Item:
    rows = [("n", "σe²", "mean â", "std â", "mean b̂", "std b̂")]
    figure = go.Figure(
        layout={"xaxis_title": "â", "yaxis_title": "b̂", "title": f"{SHOWN} estimates a case"}
    )
    stds, bias = {}, []
    for (n, variance), models in runs.items():
        theta = np.array([_theta(model) for model in models])
        mean, std = theta.mean(axis=0), theta.std(axis=0, ddof=1)
        stds[n, variance] = std
        bias.append(np.abs(mean - [A, B]) / std * np.sqrt(n / 200))
        rows.append(
            (
                str(n),
                f"{variance:g}",
                f"{mean[0]:.4f}",
                f"{std[0]:.4f}",
                f"{mean[1]:.4f}",
                f"{std[1]:.4f}",
            )
        )
        figure.add_scatter(
            x=theta[:SHOWN, 0],
            y=theta[:SHOWN, 1],
            mode="markers",
            name=f"n = {n}, σe² = {variance:g}",
        )
    checks = [
        *(
            near(
                f"std of b̂ at σe² = 1 over that at 0.4, n = {n} (theory √2.5)",
                2.5**0.5,
                stds[n, 1.0][1] / stds[n, 0.4][1],
                0.25,
            )
            for n in (200, 1300)
        ),
        *(
            near(
                f"std of {name} at n = 200 over that at 1300, σe² = {v:g} (theory √6.5)",
                6.5**0.5,
                stds[200, v][k] / stds[1300, v][k],
                0.25,
            )
            for k, name in enumerate(("â", "b̂"))
            for v in (0.4, 1.0)
        ),
        within(
            "largest |mean − truth| in standard deviations of one estimate",
            float(np.max(bias)),
            0.0,
            0.5,
            source="no bias is drawn",
        ),
    ]
    source = "the scatter of (â, b̂) grows with σe² and shrinks with n"
    reason = "â scarcely depends on σe², whose share of y grows with it; only b̂ is checked for that"
    return Item(
        "Fig. 25–28", "Scatter of ARX(1,1,1) estimates", source, checks, reason, rows, [figure]
    )


def _covered(name: str, inside: int, of: int, n: int) -> Check:
    """Whether so many inside are what 95 % gives, short records allowed to fall a little short."""
    low = binom.ppf(0.001, of, LEVEL - (SHORT_RECORD if n == 200 else 0.0)) / of
    high = binom.ppf(0.999, of, LEVEL) / of
    return within(
        name, 100 * inside / of, 100 * low, 100 * high, "%", "95 % ± the count's own scatter"
    )


def _parameter_ellipses(runs: Runs) -> Item:
    limit = chi2.ppf(LEVEL, df=2)
    checks = []
    figure = go.Figure(
        layout={
            "xaxis_title": "â",
            "yaxis_title": "b̂",
            "title": "95 % ellipses of the first estimate",
        }
    )
    for (n, variance), models in runs.items():
        inside = sum(in_confidence_ellipsoid(model, [B, A], LEVEL) for model in models)
        checks.append(
            _covered(
                f"ellipses that hold the truth, n = {n}, σe² = {variance:g}", inside, len(models), n
            )
        )
        ellipse = _ellipse(models[0], limit)
        figure.add_scatter(
            x=ellipse[:, 1], y=ellipse[:, 0], mode="lines", name=f"n = {n}, σe² = {variance:g}"
        )
    figure.add_scatter(x=[A], y=[B], mode="markers", name="true")
    return Item(
        "Fig. 29–30",
        "Ellipses in the parameter space",
        "95 % confidence ellipses",
        checks,
        figures=[figure],
    )


def _ellipse(model: IdentifiedModel, limit: float) -> np.ndarray:
    angle = np.linspace(0, 2 * np.pi, 100)
    root = np.linalg.cholesky(model.parameter_covariance)
    centre = np.array([model.numerator[0], model.denominator[1]])
    return centre + np.sqrt(limit) * np.stack([np.cos(angle), np.sin(angle)], axis=1) @ root.T


def _nyquist_ellipses(runs: Runs) -> Item:
    truth = B / (np.exp(1j * FREQUENCIES) + A)
    limit = chi2.ppf(LEVEL, df=2)
    rows = [("n", "σe²", "lowest rate over 12 frequencies", "mean rate")]
    checks = []
    for (n, variance), models in runs.items():
        inside = np.zeros(len(truth))
        for model in models:
            error = model.frequency_response(FREQUENCIES) - truth
            pair = np.stack([error.real, error.imag], axis=1)
            covariance = model.frequency_covariance(FREQUENCIES) + 1e-15 * np.eye(2)
            inside += np.einsum("fi,fij,fj->f", pair, np.linalg.inv(covariance), pair) <= limit
        rate = inside / len(models)
        name = f"least covered of {len(truth)} frequencies, n = {n}, σe² = {variance:g}"
        checks.append(_covered(name, int(inside.min()), len(models), n))
        rows.append(
            (str(n), f"{variance:g}", f"{100 * rate.min():.1f} %", f"{100 * rate.mean():.1f} %")
        )
    figure = go.Figure(
        layout={
            "xaxis_title": "Re G",
            "yaxis_title": "Im G",
            "title": "Nyquist ellipses, n = 200, σe² = 1",
        }
    )
    shown = runs[200, 1.0][0]
    ellipses = shown.confidence_ellipses(FREQUENCIES)
    checks.append(
        near(
            "squared distance of drawn ellipses from their centres over χ² of two degrees, the farthest off",
            1.0,
            _off(shown, ellipses, limit),
            0.01,
        )
    )
    for ellipse in ellipses:
        figure.add_scatter(
            x=ellipse.real,
            y=ellipse.imag,
            mode="lines",
            line={"color": "#8a97a6"},
            showlegend=False,
        )
    figure.add_scatter(x=truth.real, y=truth.imag, mode="lines+markers", name="true")
    return Item(
        "Fig. 31–32",
        "Nyquist ellipses (1.113)",
        "95 % regions in the frequency domain",
        checks,
        "",
        rows,
        [figure],
    )


def _off(model: IdentifiedModel, ellipses: np.ndarray, limit: float) -> float:
    """Squared Mahalanobis distance of drawn points from the estimate over the limit, of the point where it is farthest from 1."""
    off = ellipses - model.frequency_response(FREQUENCIES)[:, None]
    pair = np.stack([off.real, off.imag], axis=-1)
    ratio = (
        np.einsum(
            "fki,fij,fkj->fk", pair, np.linalg.inv(model.frequency_covariance(FREQUENCIES)), pair
        )
        / limit
    )
    return float(ratio.ravel()[np.argmax(np.abs(ratio - 1.0))])
