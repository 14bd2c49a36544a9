"""`residuum control design`: identified models → a robust controller of fixed structure."""

import json
import math
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from residuum.identification.errors import BadInput
from residuum.identification.linear_models.identified_model_file import load_identified
from residuum.robust_control.certificates.h_infinity_norm import h_infinity_norm
from residuum.robust_control.certificates.time_domain import StepResponse
from residuum.robust_control.controller_export import LANGUAGES, DifferenceEquation
from residuum.robust_control.state_space import weighted_loop
from residuum.robust_control.synthesis.constrained_structure import Constrained
from residuum.robust_control.synthesis.controller_structure import ControllerStructure
from residuum.robust_control.weights.nominal_performance import Infeasible
from residuum.service.commands.output_file import check_output_file
from residuum.service.commands.report import AsJson, report, to_plain
from residuum.service.commands.weight_options import (
    EPSILON,
    WEIGHT_ORDER,
    ZETA,
    Epsilon,
    Lowest,
    Rule,
    WeightOrder,
    Zeta,
)
from residuum.service.views.control_problem import STRUCTURES, ControlProblem, Solution, WeightChoice, Wishes
from residuum.service.views.control_promise import promise_and_measurement, says

app = typer.Typer(add_completion=False)

_ANSWER_IS_NO = 1
_NO_LIMITS = (-math.inf, math.inf)


@app.callback()
def control() -> None:
    """Robust controllers from identified models."""


@app.command()
def design(
    identified: Annotated[list[Path], typer.Argument(metavar="IDENTIFIED…", help="Identified models, one an operating point.")],
    out: Annotated[Path, typer.Option(help="File for the controller (JSON).")],
    aim: Annotated[str, typer.Option(help="nominal (Algorithm 2) or robust (Algorithm 3).")] = "nominal",
    structure: Annotated[str, typer.Option(help=f"One of {', '.join(STRUCTURES)}.")] = "pidn",
    overshoot: Annotated[float, typer.Option(help="nominal: least overshoot worth having (0.01 = 1 %).")] = 0.01,
    settling_time: Annotated[float | None, typer.Option(help="nominal: longest settling time \\[s].")] = None,
    slack: Annotated[float, typer.Option(help="nominal: the slack of the mixed-sensitivity bound.")] = 0.1,
    only: Annotated[
        str | None,
        typer.Option(help="One wish alone: overshoot or settling-time; with --aim robust high-gain or critical-frequency."),
    ] = None,
    in_time: Annotated[
        bool,
        typer.Option(help="nominal: keep overshoot and settling time in time, on the nominal loop and 95 % of random plants."),
    ] = False,
    low_gain: Annotated[float, typer.Option(help="robust: l_g, gain of W_S at low frequency \\[dB].")] = 120.0,
    high_gain: Annotated[float, typer.Option(help="robust: smallest h_g, gain of W_S at high frequency \\[dB].")] = -50.0,
    critical_frequency: Annotated[
        float | None, typer.Option(help="robust: lowest ω_c \\[rad/s]; default: a thousandth of where W_T reaches 1.")
    ] = None,
    joined: Annotated[
        Path | None, typer.Option(help="The nominal plant: a model of all operating points' records (default: the models' mean).")
    ] = None,
    epsilon: Epsilon = EPSILON,
    zeta: Zeta = ZETA,
    rule: Rule = "chernoff",
    weight_order: WeightOrder = WEIGHT_ORDER,
    points: Annotated[int, typer.Option(help="Frequencies of the grid, logarithmic up to π/Ts.", min=50, max=5000)] = 600,
    lowest: Lowest = None,
    fix: Annotated[list[str] | None, typer.Option(metavar="NAME=VALUE", help="Hold a parameter of the controller.")] = None,
    within: Annotated[
        list[str] | None, typer.Option(metavar="NAME=LOW:HIGH", help="Keep a parameter of the controller between limits.")
    ] = None,
    seed: Annotated[int, typer.Option(help="Of the random plants.")] = 0,
    export: Annotated[
        tuple[str, Path] | None, typer.Option(metavar="c|st FILE", help="Also write the controller as C or structured text.")
    ] = None,
    limits: Annotated[
        tuple[float, float], typer.Option(metavar="LOW HIGH", help="Of the actuator, in the exported code.")
    ] = _NO_LIMITS,
    as_json: AsJson = False,
) -> None:
    """Design a controller; exit status 1 when no controller of the structure meets the aim."""
    wishes = Wishes(aim, overshoot, settling_time, slack, only, in_time, low_gain, high_gain, critical_frequency)
    if structure not in STRUCTURES:
        raise BadInput(f"--structure {structure!r}: there is none of this name; known are {', '.join(STRUCTURES)}")
    check_output_file(out)
    _check_export(export, limits)
    choice = WeightChoice(epsilon, zeta, rule, weight_order, points, lowest)
    middle = None if joined is None else load_identified(joined)
    problem = ControlProblem([load_identified(file) for file in identified], seed, joined=middle, weight=choice)
    law = _constrained(STRUCTURES[structure](problem.loop.sample_time), fix or [], within or [])
    described = {"aim": aim, "structure": structure, "models": [str(file) for file in identified]}
    try:
        found = problem.solve(law, wishes)
    except Infeasible as no:
        report(described | {"feasible": False, "reason": str(no)}, f"infeasible: {no}", as_json=as_json)
        raise typer.Exit(_ANSWER_IS_NO) from None
    controller = found.chosen.design.controller
    seen = problem.measured(found, wishes)
    result = described | _json(found, wishes.names, list(seen.drawn), problem, out)
    result |= problem.nominal_plants() | {"samples": choice.samples}
    result |= promise_and_measurement(found, wishes, seen)
    equation = DifferenceEquation(controller, *limits)
    result["difference_equation"] = equation.text()
    if export is not None:
        export[1].write_text(LANGUAGES[export[0]](equation), encoding="utf-8")
        result["exported"] = str(export[1])
    out.write_text(json.dumps(to_plain(result), indent=1), encoding="utf-8")
    report(result, _human(result), as_json=as_json)


def _check_export(export: tuple[str, Path] | None, limits: tuple[float, float]) -> None:
    if not limits[0] < limits[1]:
        raise BadInput(f"--limits {limits[0]:g} {limits[1]:g}: the lower must be below the upper")
    if export is None:
        return
    if export[0] not in LANGUAGES:
        raise BadInput(f"--export {export[0]!r}: there is no such language; known are {', '.join(LANGUAGES)}")
    check_output_file(export[1])


def _constrained(law: ControllerStructure, fix: list[str], within: list[str]) -> ControllerStructure:
    if not fix and not within:
        return law
    fixed = {name: _number(value, text) for text in fix for name, value in [_split(text, "=", "--fix", "NAME=VALUE")]}
    limits = {}
    for text in within:
        name, values = _split(text, "=", "--within", "NAME=LOW:HIGH")
        low, high = _split(values, ":", "--within", "NAME=LOW:HIGH")
        limits[name] = (_number(low, text), _number(high, text))
    return Constrained(law, fixed=fixed, within=limits)


def _split(text: str, mark: str, option: str, form: str) -> tuple[str, str]:
    before, found, after = text.partition(mark)
    if not found:
        raise BadInput(f"{option} {text!r}: must have the form {form}")
    return before, after


def _number(text: str, whole: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise BadInput(f"{whole!r}: {text!r} is not a number") from None


def _json(
    found: Solution, names: tuple[str, str], figures: list[StepResponse], problem: ControlProblem, out: Path
) -> dict[str, Any]:
    chosen, W_T = found.chosen, problem.W_T
    made = chosen.design
    return {
        "feasible": True,
        "parameters": dict(zip(made.structure.names, made.rho.tolist(), strict=True)),
        "equation": made.structure.equation,
        "controller": {
            "numerator": made.controller.num,
            "denominator": made.controller.den,
            "sample_time": made.controller.sample_time,
        },
        "cost": made.cost,
        "certified_cost": made.certified,
        "worst_frequency_rad_s": made.worst_frequency,
        "stable": made.stable,
        "robust_stability_norm": h_infinity_norm(weighted_loop(problem.plant, made.controller, W_T=W_T))[0]
        if made.stable
        else None,
        "chosen": {names[0]: chosen.first, names[1]: chosen.second},
        "pareto_front": [{names[0]: point.first, names[1]: point.second} for point in found.front],
        "uncertainty_weight": {"numerator": W_T.num, "denominator": W_T.den, "critical_frequency_rad_s": problem.crossing},
        "largest_uncertainty": float(problem.largest.max()),
        "random_plants": {
            "count": len(figures),
            "unstable": sum(not math.isfinite(figure.integral_absolute_error) for figure in figures),
            "overshoot_median": float(np.median([figure.overshoot for figure in figures])),
            "settling_time_median_s": float(np.median([figure.settling_time for figure in figures])),
            "integral_absolute_error_median_s": float(np.median([figure.integral_absolute_error for figure in figures])),
        },
        "file": str(out),
    }


def _about(result: dict[str, Any]) -> list[str]:
    about = result["largest_uncertainty_about"]
    if about["joined"] is None:
        return []
    return [f"  largest uncertainty about the joined model {about['joined']:.4g}, about the models' mean {about['mean']:.4g}"]


def _human(result: dict[str, Any]) -> str:
    plants, control_law = result["random_plants"], result["parameters"]
    wishes = ", ".join(f"{name} = {value:.4g}" for name, value in result["chosen"].items())
    return "\n".join(
        [
            f"{result['structure']}: K = {result['equation']}",
            "  " + ", ".join(f"{name} = {value:.5g}" for name, value in control_law.items()),
            *_about(result),
            f"  aim {result['aim']}: {wishes}",
            f"  cost {result['certified_cost']:.4g}, largest at {result['worst_frequency_rad_s']:.4g} rad/s; "
            f"robust stability ‖W_T T‖∞ = {result['robust_stability_norm'] or math.inf:.6g}",
            f"  nominal loop {'stable' if result['stable'] else 'UNSTABLE'}; {plants['count']} random plants: "
            f"{plants['unstable']} unstable, median overshoot {100 * plants['overshoot_median']:.2g} %, "
            f"settling {plants['settling_time_median_s']:.3g} s",
            *says(result),
            f"  written to {result['file']}" + (f" and {result['exported']}" if "exported" in result else ""),
        ]
    )
