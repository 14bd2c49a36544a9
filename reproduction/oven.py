"""Fig. 55 and 60–65: Algorithm 4 on the simulated oven, beside controllers from every manual weight of the grid."""

from collections.abc import Sequence

import numpy as np
import plotly.graph_objects as go

from reproduction.check import at_least, at_most, near, same, within
from reproduction.item import Item
from reproduction.oven_case import (
    AIM,
    DROPPED,
    DURATION,
    PLANTS,
    SEED,
    TS,
    N,
    Oven,
    algorithm_4,
    synthesised,
)
from reproduction.oven_grid import PAIRS, grid_items
from residuum.robust_control.certificates import StepResponse, assess, over_plants, step_response
from residuum.robust_control.control_problem import average_plant
from residuum.simulation.oven import OvenMachine

_LOG = {
    "xaxis_title": "ω [rad/s]",
    "yaxis_title": "magnitude",
    "xaxis_type": "log",
    "yaxis_type": "log",
}


def items(short: bool) -> list[Item]:
    """The configurations (Fig. 55), the experiment, the models, the design, and the manual grid."""
    oven = algorithm_4(60 if short else PLANTS)
    pairs = PAIRS[:: 11 if short else 1]
    return [
        _boundary(oven),
        _experiment(oven),
        _models(oven),
        _bounds(oven),
        _steps(oven),
        *grid_items(oven, pairs),
    ]


def _boundary(oven: Oven) -> Item:
    """The two configurations' models against what each gained over its record: quotient of steady means."""
    omega = oven.loop.omega
    figure = go.Figure(layout=_LOG)
    magnitude = {
        name: np.abs(oven.models[name].frequency_response(omega)) for name in ("best", "worst")
    }
    for name, values in magnitude.items():
        figure.add_scatter(x=omega, y=values, name=name)
    share = 100 * float(np.mean(magnitude["best"] > magnitude["worst"]))
    checks = [
        at_least(
            "frequencies at which the best lies above the worst configuration",
            share,
            90.0,
            "%",
            source="the highest condition",
        )
    ]
    checks += [
        at_least(
            f"of the output's variance explained on a second record, {name}",
            _explained(oven, name),
            85.0,
            "%",
        )
        for name in ("best", "worst")
    ]
    source = "the two boundary configurations, the highest and the lowest; the others lie between"
    return Item("Fig. 55", "Boundary configurations", source, checks, figures=[figure])


def _explained(oven: Oven, name: str) -> float:
    """Share [%] of a second run's variance that the configuration's model explains."""
    machine = OvenMachine(seed=SEED, configuration=name, sample_time_s=TS)
    signals = machine.simulate(2000 * TS).channels
    y, predicted = signals["temperature"][500:], oven.models[name].simulate(signals["duty"])[500:]
    return 100 * (1 - float(np.var(y - predicted) / np.var(y)))


def _experiment(oven: Oven) -> Item:
    y = oven.records["average"]["temperature"]
    middle = N - DROPPED
    figure = go.Figure(layout={"xaxis_title": "t [h]", "yaxis_title": "temperature [°C]"})
    figure.add_scatter(x=TS / 3600 * np.arange(len(y)), y=y, name="worst, then best")
    steps = np.abs(np.diff(y))
    jump, usual = float(steps[middle - 50 : middle + 50].max()), float(np.quantile(steps, 0.99))
    levels = [
        float(y[part].mean()) for part in (slice(200, middle - 500), slice(middle + 500, -200))
    ]
    checks = [
        same("samples of the joined record", 2 * (N - DROPPED), len(y)),
        at_most(
            "largest step where the configurations meet over what 99 % of all steps stay below",
            jump / usual,
            1.0,
            source="no discontinuity",
        ),
        at_least(
            "mean temperature of the best over the worst configuration",
            levels[1] / levels[0],
            1.2,
            source="drawn far apart",
        ),
    ]
    source = "worst, then best configuration, joined without a discontinuity"
    return Item("Fig. 60", "The general experiment", source, checks, figures=[figure])


def _models(oven: Oven) -> Item:
    omega = oven.loop.omega
    gains = {
        name: float(model.frequency_response([0.0])[0].real) for name, model in oven.models.items()
    }
    rows = [
        ("model", "static gain [°C per %]"),
        *((name, f"{gain:.3f}") for name, gain in gains.items()),
    ]
    figure, weight = go.Figure(layout=_LOG), go.Figure(layout=_LOG)
    for name, model in oven.models.items():
        figure.add_scatter(x=omega, y=np.abs(model.frequency_response(omega)), name=name)
    magnitude = np.abs(oven.W_T.frequency_response(omega))
    weight.add_scatter(x=omega, y=magnitude, name="Ŵ_T")
    weight.add_scatter(x=omega, y=oven.largest, mode="markers", marker={"size": 3}, name="Ω")
    rows += [
        ("largest Ω about the joined model", f"{oven.largest.max():.3f}"),
        ("largest Ω about the mean of the two", f"{oven.largest_about_mean:.3f}"),
    ]
    nominal = oven.models["average"].frequency_response(omega)
    fresh = np.concatenate(
        [
            oven.models[name].sample_frequency_responses(200, omega, SEED + 9)
            for name in ("worst", "best")
        ]
    )
    over = 100 * float(np.mean((np.abs(fresh / nominal - 1) > magnitude).any(axis=1)))
    mean = float(
        average_plant([oven.models["worst"], oven.models["best"]]).frequency_response([0.0])[0].real
    )
    middle, halfway = (
        (gain - gains["worst"]) / (gains["best"] - gains["worst"])
        for gain in (gains["average"], mean)
    )
    checks = [
        within(
            "where the joined model's static gain lies between the worst's (0) and the best's (1)",
            middle,
            0.0,
            1.0,
        ),
        near("where the mean of both models lies in the same way", 0.5, halfway, 1e-6),
        at_most(
            "largest Ω over Ŵ_T",
            float((oven.largest / magnitude).max()),
            1.0 + 1e-9,
            by_construction=True,
        ),
        at_least(
            "largest Ω over Ŵ_T: the weight touches the dots",
            float((oven.largest / magnitude).max()),
            0.8,
        ),
        at_most("new draws of both configurations above Ŵ_T anywhere", over, 5.0, "%"),
    ]
    source = "the average model lies between the boundary models; Ŵ_T covers both configurations"
    return Item(
        "Fig. 61",
        "Boundary models and the overall weight",
        source,
        checks,
        "",
        rows,
        [figure, weight],
    )


def _bounds(oven: Oven) -> Item:
    made, reference = oven.design.chosen.design, oven.design.reference
    L = oven.loop.G[0] * made.controller.frequency_response(oven.loop.omega)
    bound_T = (1 + AIM.slack) / np.abs(oven.W_T.frequency_response(oven.loop.omega))
    bound_S = (1 + AIM.slack) / reference.weight_magnitude(oven.loop.omega)
    curves = {"T": (np.abs(L / (1 + L)), bound_T), "S": (np.abs(1 / (1 + L)), bound_S)}
    figure = go.Figure(layout=_LOG)
    for name, (magnitude, bound) in curves.items():
        figure.add_scatter(x=oven.loop.omega, y=magnitude, name=name)
        figure.add_scatter(
            x=oven.loop.omega, y=bound, name=f"bound of {name}", line={"dash": "dash"}
        )
    beyond = _beyond(oven)
    faster = synthesised(oven, 0.9, np.abs(oven.W_T.frequency_response(oven.loop.omega)))
    checks = [
        *(
            at_most(
                f"largest |{n}| over its bound", float((m / b).max()), 1.0, by_construction=True
            )
            for n, (m, b) in curves.items()
        ),
        at_least("least cost at 0.9 ℓ̂", faster.certified, 1 + AIM.slack, source="ℓ̂ is the fastest"),
        at_most(
            "new draws with |T_p − T̂| above |Ŵ_T T̂ S_p| anywhere",
            beyond,
            5.0,
            "%",
            source="T_p − T̂ = T̂ ΔŴ_T S_p, |Δ| ≤ 1",
        ),
    ]
    title, source = "Constraints of the automatic design", "both constraints hold with γ = 0.15"
    return Item("Fig. 62", title, source, checks, figures=[figure])


def _beyond(oven: Oven) -> float:
    """Share [%] of new draws whose closed loop leaves what the nominal one and the weight allow."""
    omega, K = (
        oven.loop.omega,
        oven.design.chosen.design.controller.frequency_response(oven.loop.omega),
    )
    T, W_T = (
        oven.loop.G[0] * K / (1 + oven.loop.G[0] * K),
        np.abs(oven.W_T.frequency_response(omega)),
    )
    G = np.concatenate(
        [
            oven.models[name].sample_frequency_responses(100, omega, SEED + 5)
            for name in ("worst", "best")
        ]
    )
    S = 1 / (1 + G * K)
    return 100 * float(np.mean((np.abs(G * K * S - T) > np.abs(T * S) * W_T).any(axis=1)))


def _steps(oven: Oven) -> Item:
    made = oven.design.chosen.design
    figure = go.Figure(layout={"xaxis_title": "t [s]", "yaxis_title": "y"})
    rows = [
        (
            "plants",
            "unstable",
            "overshoot, median and largest",
            "settling time, median and largest [s]",
            "IAE, median [s]",
        )
    ]
    unstable, iae = 0, {}
    for name, colour in (("best", "orange"), ("worst", "lightblue")):
        responses = over_plants(oven.sampled[name], made.controller, DURATION)
        lost = sum(not np.isfinite(response.integral_absolute_error) for response in responses)
        unstable += lost
        iae[name] = [response.integral_absolute_error for response in responses]
        rows.append((f"{len(responses)} of {name}", str(lost), *_summary(responses)))
        for plant in oven.sampled[name][:20]:
            y = step_response(plant, made.controller, DURATION)
            figure.add_scatter(
                x=TS * np.arange(len(y)), y=y, line={"color": colour, "width": 1}, showlegend=False
            )
    nominal = step_response(oven.models["average"].transfer_function(), made.controller, DURATION)
    figure.add_scatter(
        x=TS * np.arange(len(nominal)),
        y=nominal,
        name="average",
        line={"color": "grey", "dash": "dash"},
    )
    before, promised = assess(nominal, TS), oven.design.chosen
    checks = [
        same("unstable sampled loops", 0, unstable),
        at_least(
            "least IAE of the worst configuration over the largest of the best",
            min(iae["worst"]) / max(iae["best"]),
            1.0,
            source="grouped by configuration",
        ),
        at_most(
            "overshoot of the average model's loop",
            100 * before.overshoot,
            100 * promised.first,
            "%",
            source="ô is respected",
        ),
        at_most(
            "settling time of the average model's loop",
            before.settling_time,
            promised.second,
            "s",
            source="ℓ̂ is respected",
        ),
    ]
    reason = (
        "overshoot and settling time follow from (2.31) for loops of second order alone; the slack γ spends "
        f"{100 * AIM.slack:g} % of |S|'s bound, and the weight bounds neither in time (control design --in-time does)"
    )
    source = "all stable, grouped by configuration; the average's loop respects ô and ℓ̂"
    return Item(
        "Fig. 63", "Step responses of the sampled plants", source, checks, reason, rows, [figure]
    )


def _summary(responses: Sequence[StepResponse]) -> tuple[str, str, str]:
    overshoot = [100 * response.overshoot for response in responses]
    settling = [response.settling_time for response in responses]
    iae = np.median([response.integral_absolute_error for response in responses])
    return (
        f"{np.median(overshoot):.1f} %, {max(overshoot):.1f} %",
        f"{np.median(settling):.0f}, {max(settling):.0f}",
        f"{iae:.0f}",
    )
