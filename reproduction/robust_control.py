"""Fig. 50–54: robust performance for (2.38) from three identifications, by Algorithm 3."""

from collections.abc import Mapping, Sequence

import numpy as np
import plotly.graph_objects as go

from reproduction.benchmark import FULL, KERNEL, LOW, TRUE, TS, identified
from reproduction.check import Check, at_least, at_most, same, within
from reproduction.control_cases import (
    DURATION,
    LOG,
    NAMES,
    PLANTS,
    Case,
    case,
    robust,
    sensitivities,
)
from reproduction.item import Item
from residuum.identification.linear_models.transfer_function import TransferFunction
from residuum.robust_control.certificates import (
    RobustAim,
    StepResponse,
    assess,
    over_plants,
    step_response,
)
from residuum.robust_control.loop import Weights
from residuum.robust_control.synthesis.constrained_structure import PIDN
from residuum.robust_control.synthesis.structured_synthesis import synthesise
from residuum.robust_control.weights.performance_weight import MonotoneWeight

_MEASURES = {
    "integral_absolute_error": "IAE",
    "settling_time": "settling time",
    "overshoot": "overshoot",
}
_PHASES = np.exp(2j * np.pi * np.arange(72) / 72)
_FRESH = 77
Steps = Mapping[str, tuple[Sequence[StepResponse], StepResponse]]


def items(short: bool) -> list[Item]:
    """Fig. 50 (the sum), 51 (sampled sensitivities), 52 and 53 (in time), 54 (both tests)."""
    plants = 60 if short else PLANTS
    steps = {}
    for name in NAMES:
        K = _controller(name)
        steps[name] = (
            over_plants(case(name).sampled[:plants], K, DURATION),
            assess(step_response(TRUE, K, DURATION), TS),
        )
    return [
        _sum(),
        _sampled(plants),
        _in_time(steps, "Fig. 52", ["integral_absolute_error"]),
        _in_time(steps, "Fig. 53", ["settling_time", "overshoot"]),
        _tests(plants),
    ]


def _controller(name: str) -> TransferFunction:
    return robust(name).chosen.design.controller


def _parts(name: str) -> tuple[Case, np.ndarray, np.ndarray, np.ndarray]:
    """Case, |T|, |S| and |W_S| of a design."""
    one = case(name)
    T, S = sensitivities(one.loop, _controller(name))
    return one, T, S, robust(name).weight.magnitude(one.loop.omega)


def _sum() -> Item:
    rows = [("identification", "chosen h_g [dB]", "chosen ω_c [rad/s]", "max |Ŵ_S S| + |Ŵ_T T|")]
    figure = go.Figure(layout=LOG)
    checks, tried = [], []
    for name in NAMES:
        one, T, S, W_S = _parts(name)
        chosen = robust(name).chosen
        total = W_S * S + one.W_T * T
        rows.append((name, f"{chosen.first:.1f}", f"{chosen.second:.2f}", f"{total.max():.4f}"))
        figure.add_scatter(x=one.loop.omega, y=total, name=name)
        faster = _least_sum(one, chosen.first, 1.1 * chosen.second)
        checks += [
            at_most(
                f"max |Ŵ_S S| + |Ŵ_T T|, {name}", float(total.max()), 1.0, by_construction=True
            ),
            at_most(
                f"|Ŵ_S S_p| of the worst plant G(1 + ΔŴ_T), |Δ| = 1, {name}",
                _worst_of_phases(one, W_S),
                1.0,
                source="what the sum promises",
            ),
            at_least(
                f"least sum at 1.1 ω̂_c and the same h_g, {name}",
                faster,
                1.0,
                source="the front's end",
            ),
        ]
        tried.append(f"{name} {faster:.3f}")
    checks.append(_weight_check())
    source = "‖H‖₁ < 1 for all three identifications"
    return Item(
        "Fig. 50",
        "The robust-performance test",
        source,
        checks,
        f"tried: 1.1 ω̂_c gives {', '.join(tried)}",
        rows,
        [figure],
    )


def _worst_of_phases(one: Case, W_S: np.ndarray) -> float:
    L = one.loop.G[0] * _controller(one.name).frequency_response(one.loop.omega)
    perturbed = L * (1 + one.W_T * _PHASES[:, None])
    return float((W_S / np.abs(1 + perturbed)).max())


def _least_sum(one: Case, high_gain: float, frequency: float) -> float:
    W_S = MonotoneWeight(RobustAim().low_gain_db, high_gain, frequency).magnitude(one.loop.omega)
    return synthesise(one.loop, Weights(W_S, one.W_T, "1"), PIDN(TS)).certified


def _weight_check() -> Check:
    """l_g at low and h_g at high frequency, 0 dB at ω_c."""
    weight = robust(KERNEL).weight
    gains = 20 * np.log10(
        weight.magnitude(
            [
                1e-9 * weight.critical_frequency,
                weight.critical_frequency,
                1e9 * weight.critical_frequency,
            ]
        )
    )
    off = float(np.abs(gains - [weight.low_gain_db, 0.0, weight.high_gain_db]).max())
    return at_most(
        "gains of Ŵ_S at 0, ω̂_c, ∞ against l_g, 0 dB, ĥ_g",
        off,
        0.01,
        "dB",
        source="Algorithm 3, step 4",
    )


def _sampled(plants: int) -> Item:
    figures, checks = [], []
    for name in NAMES:
        one, model = case(name), identified()[name]
        W_S, K = (
            robust(name).weight.magnitude(one.loop.omega),
            _controller(name).frequency_response(one.loop.omega),
        )
        S = 1 / np.abs(1 + model.sample_frequency_responses(plants, one.loop.omega, _FRESH) * K)
        over = int(np.sum((W_S * S > 1.0).any(axis=1)))
        checks.append(
            at_most(
                f"fresh plants with |S_p| above 1/|Ŵ_S| anywhere, {name}",
                over,
                0.05 * plants,
                f"of {plants}",
                source="none is drawn; ε = 0.05",
            )
        )
        true = float((W_S / np.abs(1 + TRUE.frequency_response(one.loop.omega) * K)).max())
        if name != LOW:
            checks.append(
                at_most(f"the true plant's largest |Ŵ_S S|, {name}", true, 1.0, source="inside")
            )
        figure = go.Figure(layout=LOG | {"title": name, "showlegend": False})
        for row in S[:40]:
            figure.add_scatter(
                x=one.loop.omega[::3], y=row[::3], line={"color": "#8a97a6", "width": 0.6}
            )
        figure.add_scatter(
            x=one.loop.omega, y=1 / W_S, line={"color": "#b3541e", "dash": "dash"}, name="1/|Ŵ_S|"
        )
        figures.append(figure)
    source = "every sampled sensitivity lies below 1/|Ŵ_S|"
    return Item("Fig. 51", "Sensitivities of sampled plants", source, checks, figures=figures)


def _in_time(steps: Steps, where: str, measures: Sequence[str]) -> Item:
    rows = [
        (
            "identification",
            *(f"{_MEASURES[m]}, range of the samples, and of the true plant" for m in measures),
        )
    ]
    figures, checks = [], []
    for name in NAMES:
        drawn, true = steps[name]
        cells = []
        for measure in measures:
            values = [getattr(one, measure) for one in drawn]
            star = getattr(true, measure)
            inside, far = min(values) <= star <= max(values), not star <= 2 * max(values)
            cells.append(f"{min(values):.4g} … {max(values):.4g}; {star:.4g}")
            wanted, holds = (
                ("out of scale (twice beyond)", far) if name == LOW else ("inside", inside)
            )
            shown = f"{'inside' if inside else 'outside'} ({star:.4g} in {min(values):.4g} … {max(values):.4g})"
            checks.append(
                Check(f"the true plant's {_MEASURES[measure]}, {name}", wanted, shown, holds)
            )
            figures.append(_box(name, measure, values, star))
        rows.append((name, *cells))
    source = "the true plant lies within the sampled distribution for kernel and full order, and far outside for the low order"
    return Item(
        where,
        "Robust performance in time",
        source,
        checks,
        _why_outside(steps, measures),
        rows,
        figures,
    )


def _why_outside(steps: Steps, measures: Sequence[str]) -> str:
    """What plants drawn about the truth itself, cut after the model's lags, give; the low order's true loop."""
    one, K = case(KERNEL), _controller(KERNEL)
    g = TRUE.simulate(np.r_[1.0, np.zeros(len(one.plant.den) - 1)])[1:]
    drawn = [
        TransferFunction(g + p.num[-len(g) :] - one.plant.num[-len(g) :], one.plant.den, TS)
        for p in one.sampled[:60]
    ]
    about = over_plants(drawn, K, DURATION)
    cut = assess(step_response(TransferFunction(g, one.plant.den, TS), K, DURATION), TS)
    said = "; ".join(
        f"{_MEASURES[m]} {min(getattr(a, m) for a in about):.4g} … {max(getattr(a, m) for a in about):.4g}, "
        "of the truth so cut "
        f"{getattr(cut, m):.4g}, of the truth {getattr(steps[KERNEL][1], m):.4g}"
        for m in measures
    )
    low = steps[LOW][1]
    return (
        f"tried for the kernel: plants drawn about the truth cut after {len(g)} lags, with the posterior's "
        f"scatter: {said}. The lost "
        "tail and errors in the lags add to the response, so the range lies beside the truth. The low order's loop is "
        f"{'unstable' if not np.isfinite(low.integral_absolute_error) else 'stable'} on the true plant (Fig. 49): IAE "
        f"{low.integral_absolute_error:.3g} s"
    )


def _box(name: str, measure: str, values: Sequence[float], star: float) -> go.Figure:
    figure = go.Figure(
        layout={
            "title": name,
            "yaxis_title": _MEASURES[measure],
            "showlegend": False,
            "height": 320,
        }
    )
    figure.add_box(y=list(values), name="sampled")
    figure.add_scatter(
        x=["sampled"],
        y=[star],
        mode="markers",
        marker={"symbol": "star", "size": 14, "color": "#2e7d4f"},
    )
    return figure


def _tests(plants: int) -> Item:
    figures, checks = [], []
    for name in NAMES:
        one, T, S, W_S = _parts(name)
        uncertain = S / np.maximum(1 - one.W_T * T, 1e-12)
        printed = S / (1 + one.W_T * T)
        fresh = identified()[name].sample_frequency_responses(plants, one.loop.omega, _FRESH)
        K = _controller(name).frequency_response(one.loop.omega)
        largest = (1 / np.abs(1 + fresh * K)).max(axis=0)
        checks += [
            at_most(f"max |Ŵ_T T|, {name}", float((one.W_T * T).max()), 1.0, by_construction=True),
            at_most(
                f"max |Ŵ_S| |S|/(1 − |Ŵ_T T|), {name}",
                float((W_S * uncertain).max()),
                1.0,
                by_construction=True,
            ),
            at_most(
                f"largest sampled |S_p| over |S|/(1 − |Ŵ_T T|), {name}",
                float((largest / uncertain).max()),
                1.0,
                source="the uncertain sensitivity bounds it",
            ),
        ]
        figure = go.Figure(layout=LOG | {"title": name})
        for label, y, dash in (
            ("T", T, None),
            ("1/|Ŵ_T|", 1 / one.W_T, "dash"),
            ("S/(1 + |Ŵ_T T|), as printed", printed, None),
            ("S/(1 − |Ŵ_T T|)", uncertain, None),
            ("1/|Ŵ_S|", 1 / W_S, "dash"),
        ):
            figure.add_scatter(x=one.loop.omega, y=y, name=label, line={"dash": dash})
        figures.append(figure)
    order = [robust(name).chosen.second for name in (LOW, FULL, KERNEL)]
    checks += [
        same("unstable sampled plants of kernel and full order", 0, _unstable(plants)),
        within(
            "ω̂_c of the kernel over the full order's",
            order[2] / order[1],
            0.0,
            1.0,
            source="it knows less",
        ),
    ]
    source = "T below 1/|Ŵ_T|, and the uncertain sensitivity below 1/|Ŵ_S| (the worst case has 1 − |Ŵ_T T|, printed 1 + Ŵ_T T)"
    return Item("Fig. 54", "The two tests of robust performance", source, checks, figures=figures)


def _unstable(plants: int) -> int:
    lost = 0
    for name in (FULL, KERNEL):
        responses = over_plants(case(name).sampled[:plants], _controller(name), DURATION)
        lost += sum(not np.isfinite(response.integral_absolute_error) for response in responses)
    return lost
