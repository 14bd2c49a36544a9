"""`residuum control design`: identified models → a robust controller of fixed structure."""

import json
import math
from pathlib import Path
from typing import Annotated

import typer

from residuum.identification.errors import BadInput
from residuum.identification.kernel_based.multivariable_file import is_multivariable
from residuum.identification.linear_models.uncertainty import WEIGHT_ORDER
from residuum.library.answers.control_design import design_text
from residuum.library.answers.multivariable_control import design_text as multivariable_text
from residuum.library.control import design as design_controller
from residuum.library.multivariable_control import design_multivariable
from residuum.library.whole_file import write_whole
from residuum.nearest_names import known_names
from residuum.robust_control.control_problem import STRUCTURES, WeightChoice, Wishes
from residuum.robust_control.controller_export import LANGUAGES
from residuum.robust_control.weights.nominal_performance import Infeasible
from residuum.service.cli import ANSWER_IS_NO
from residuum.service.commands.output_file import check_output_file
from residuum.service.commands.plot_option import Plot, check_plot, drawn
from residuum.service.commands.report import AsJson, report
from residuum.service.commands.weight_options import (
    EPSILON,
    ZETA,
    Epsilon,
    Lowest,
    Rule,
    WeightOrder,
    Zeta,
)

app = typer.Typer(add_completion=False)

_NO_LIMITS = (-math.inf, math.inf)
_NOT_OF_SEVERAL = (
    "control of several inputs and outputs: takes one model, and no --joined, --fix, --within, --plot, --export or --limits"
)


@app.callback()
def control() -> None:
    """Robust controllers from identified models."""


@app.command()
def design(
    identified: Annotated[
        list[Path],
        typer.Argument(
            metavar="IDENTIFIED…",
            help="Identified models, one per operating point; or one model of as many outputs as inputs.",
        ),
    ],
    out: Annotated[Path, typer.Option(help="File for the controller (JSON).")],
    aim: Annotated[str, typer.Option(help="nominal (Algorithm 2) or robust (Algorithm 3).")] = "nominal",
    structure: Annotated[str, typer.Option(help=f"One of {', '.join(STRUCTURES)}.")] = "pidn",
    overshoot: Annotated[float, typer.Option(help="nominal: overshoot below which less brings no benefit (0.01 = 1 %).")] = 0.01,
    settling_time: Annotated[float | None, typer.Option(help="nominal: longest settling time \\[s].")] = None,
    slack: Annotated[float, typer.Option(help="nominal: the slack of the mixed-sensitivity bound.")] = 0.1,
    only: Annotated[
        str | None,
        typer.Option(help="Meet one wish alone: overshoot or settling-time; with --aim robust high-gain or critical-frequency."),
    ] = None,
    in_time: Annotated[
        bool,
        typer.Option(help="nominal: hold overshoot and settling time in the nominal loop and in 95 % of random plants."),
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
    seed: Annotated[int, typer.Option(help="Seed of the random plants.")] = 0,
    export: Annotated[
        tuple[str, Path] | None, typer.Option(metavar="c|st FILE", help="Also write the controller as C or structured text.")
    ] = None,
    limits: Annotated[
        tuple[float, float],
        typer.Option(metavar="LOW HIGH", help="Limits of the actuator in the exported code, in the unit of the plant's input."),
    ] = _NO_LIMITS,
    plot: Plot = None,
    as_json: AsJson = False,
) -> None:
    """Design a controller; exit status 1 when no controller of the structure meets the aim."""
    check_output_file(out)
    _check_export(export, limits)
    check_plot(plot)
    described = {"aim": aim, "structure": structure, "models": [str(file) for file in identified]}
    choice = WeightChoice(epsilon, zeta, rule, weight_order, points, lowest)
    try:
        if any(is_multivariable(file) for file in identified):
            if len(identified) > 1 or joined or plot or fix or within or export or limits != _NO_LIMITS:
                raise BadInput(_NOT_OF_SEVERAL)
            wishes = Wishes(aim, overshoot, settling_time, slack, only, in_time)
            several = design_multivariable(identified[0], structure=structure, wishes=wishes, weight=choice, seed=seed)
            several |= {"file": str(out)}
            write_whole(out, json.dumps(several, indent=1))
            return report(several, multivariable_text(several), as_json=as_json)
        controller = design_controller(
            identified,
            aim=aim,
            structure=structure,
            overshoot=overshoot,
            settling_time=settling_time,
            slack=slack,
            only=only,
            in_time=in_time,
            low_gain=low_gain,
            high_gain=high_gain,
            critical_frequency=critical_frequency,
            joined=joined,
            weight=choice,
            fix={name: _number(value, text) for text in fix or [] for name, value in [_split(text, "=", "--fix", "NAME=VALUE")]},
            within=dict(map(_limits, within or [])),
            seed=seed,
        )
    except Infeasible as no:
        report(described | {"feasible": False, "reason": str(no)}, f"infeasible: {no}", as_json=as_json)
        raise typer.Exit(ANSWER_IS_NO) from None
    equation = controller.difference_equation(limits)
    result = controller.to_dict() | {"file": str(out), "difference_equation": equation.text()}
    if export is not None:
        write_whole(export[1], LANGUAGES[export[0]](equation))
        result["exported"] = str(export[1])
    write_whole(out, json.dumps(result, indent=1))
    result |= drawn(plot, [controller], f"{structure} controller")
    report(result, design_text(result), as_json=as_json)


def _check_export(export: tuple[str, Path] | None, limits: tuple[float, float]) -> None:
    if not limits[0] < limits[1]:
        raise BadInput(f"--limits {limits[0]:g} {limits[1]:g}: write the lower one first")
    if export is None:
        return
    if export[0] not in LANGUAGES:
        raise BadInput(f"--export {export[0]!r}: there is no such language; {known_names(export[0], LANGUAGES)}")
    check_output_file(export[1])


def _limits(text: str) -> tuple[str, tuple[float, float]]:
    name, values = _split(text, "=", "--within", "NAME=LOW:HIGH")
    low, high = _split(values, ":", "--within", "NAME=LOW:HIGH")
    return name, (_number(low, text), _number(high, text))


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
