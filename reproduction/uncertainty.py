"""Fig. 43–45: the benchmark (2.38) identified three ways, and the uncertainty weight of each."""

import numpy as np
import plotly.graph_objects as go
from scipy.signal import lfilter

from reproduction.item import Item
from residuum.identification.kernel_based.impulse_response import identify_impulse_response
from residuum.identification.linear_models.identified_model import IdentifiedModel
from residuum.identification.linear_models.prediction_error import STRUCTURES, identify
from residuum.identification.linear_models.transfer_function import TransferFunction
from residuum.identification.linear_models.uncertainty import UncertaintyWeight, design_uncertainty_weight
from residuum.identification.record import Record

TS = 0.01
TRUE = TransferFunction([0.28261, 0.50666], [1, -1.41833, 1.58939, -1.31608, 0.88642], TS)
OMEGA = np.geomspace(1e-3, np.pi / TS, 600)
UNSEEN = np.linspace(1e-3, np.pi / TS, 20_001)
N, DROPPED, SNR, SEED = 5000, 1000, 25.0, 1


def benchmark_record(seed: int = SEED) -> Record:
    """5000 samples of (2.38) with white input and bounded white noise; 1000 before them are dropped."""
    rng = np.random.default_rng(seed)
    u = rng.normal(size=N + DROPPED)
    y = lfilter(np.r_[np.zeros(3), TRUE.num], TRUE.den, u)
    e = np.clip(rng.normal(size=len(y)), -3, 3)
    e *= np.std(y) / np.sqrt(SNR) / np.std(e)
    return Record({"u": u[DROPPED:], "y": (y + e)[DROPPED:]}, {"u": "", "y": ""}, TS, source=f"benchmark (2.38), seed {seed}")


def identified(record: Record) -> dict[str, IdentifiedModel]:
    """The three identifications of section 2.3: too low an order, full order, kernel."""
    return {
        "PEM under-modelled": identify(
            STRUCTURES["oe"], [record], "u", "y", offset=False, criterion="aic", candidates=range(1, 4)
        ),
        "PEM full": identify(STRUCTURES["oe"], [record], "u", "y", offset=False, criterion="aic"),
        "kernel": identify_impulse_response(record, "u", "y", order=100, offset=False),
    }


def weights(models: dict[str, IdentifiedModel]) -> dict[str, UncertaintyWeight]:
    """Algorithm 1 on each, second-order weights, n_p = 738."""
    return {name: design_uncertainty_weight(model, omega=OMEGA, order=2, seed=SEED) for name, model in models.items()}


def items() -> list[Item]:
    """Fig. 43 (responses), 44 and 45 (random models and weights)."""
    models = identified(benchmark_record())
    return [_responses(models), _weights(models, weights(models))]


def _responses(models: dict[str, IdentifiedModel]) -> Item:
    truth = np.abs(TRUE.frequency_response(OMEGA))
    peaks = [k for k in range(1, len(OMEGA) - 1) if truth[k - 1] < truth[k] > truth[k + 1]]
    rows = [("identification", "order", *(f"|Ĝ|/|G| at {OMEGA[k]:.0f} rad/s" for k in peaks), "fit of the first 100 lags")]
    figure = go.Figure(layout={"xaxis_title": "ω [rad/s]", "yaxis_title": "magnitude", "xaxis_type": "log", "yaxis_type": "log"})
    figure.add_scatter(x=OMEGA, y=truth, name="true")
    g0 = TRUE.simulate(np.r_[1.0, np.zeros(100)])
    ratios = {}
    for name, model in models.items():
        magnitude = np.abs(model.frequency_response(OMEGA))
        ratios[name] = [float(magnitude[k] / truth[k]) for k in peaks]
        g = model.simulate(np.r_[1.0, np.zeros(100)]) - model.offset
        fit = 100 * (1 - np.linalg.norm(g - g0) / np.linalg.norm(g0))
        order = str(len(model.denominator) - 1) if model.is_parametric else "FIR 100"
        rows.append((name, order, *(f"{ratio:.3f}" for ratio in ratios[name]), f"{fit:.2f} %"))
        figure.add_scatter(x=OMEGA, y=magnitude, name=name)
    good = (
        all(abs(r - 1) < 0.1 for name in ("kernel", "PEM full") for r in ratios[name]) and ratios["PEM under-modelled"][1] < 0.5
    )
    says = "|Ĝ|/|G| at the resonances: " + "; ".join(
        f"{name} " + " and ".join(f"{ratio:.2f}" for ratio in found) for name, found in ratios.items()
    )
    source = "kernel ≈ truth at both resonances; orders 1–3 fit only the first"
    return Item("Fig. 43", "Identification of (2.38)", source, says, good, rows, [figure])


def _weights(models: dict[str, IdentifiedModel], found: dict[str, UncertaintyWeight]) -> Item:
    rows = [("identification", "largest Ω", "crosses 0 dB at [rad/s]", "largest true error over the weight")]
    figure = go.Figure(layout={"xaxis_title": "ω [rad/s]", "yaxis_title": "magnitude", "xaxis_type": "log", "yaxis_type": "log"})
    above = {}
    for name, weight in found.items():
        magnitude = np.abs(weight.weight.frequency_response(OMEGA))
        error = np.abs(TRUE.frequency_response(UNSEEN) / models[name].frequency_response(UNSEEN) - 1)
        above[name] = float(np.max(error / np.abs(weight.weight.frequency_response(UNSEEN))))
        crossing = weight.critical_frequency
        rows.append(
            (name, f"{weight.magnitude.max():.3f}", "never" if crossing is None else f"{crossing:.1f}", f"{above[name]:.2f}")
        )
        figure.add_scatter(x=OMEGA, y=magnitude, name=f"{name}: Ŵ_T")
        figure.add_scatter(x=OMEGA, y=weight.magnitude, mode="markers", marker={"size": 3}, name=f"{name}: Ω")
    widest = max(found, key=lambda name: float(np.median(found[name].magnitude)))
    says = (
        f"the {widest} identification has the largest median uncertainty; true error over Ŵ_T at {len(UNSEEN)} frequencies "
        "that no fit saw: " + ", ".join(f"{name} {ratio:.2f}" for name, ratio in above.items())
    )
    good = widest == "kernel" and above["kernel"] <= 1 and above["PEM full"] <= 1 < above["PEM under-modelled"]
    source = "Ŵ_T lies above Ω; the kernel identification has the highest uncertainty, under-modelling hides its bias"
    return Item("Fig. 44–45", "Uncertainty weights", source, says, good, rows, [figure])
