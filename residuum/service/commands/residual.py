"""`residuum residual design` and `residuum residual run`: a detector from an identified model, and what it says of a record."""

from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from residuum.diagnosis.learning.stored import stored_kind
from residuum.diagnosis.residuals.generators.classical_filters import CLASSICAL_METHODS
from residuum.diagnosis.residuals.multivariable.multivariable_detection import detect_multivariable
from residuum.diagnosis.residuals.multivariable.multivariable_residual import (
    KIND,
    UNKNOWN_INPUT,
    MultivariableResidual,
    design_multivariable_residual,
)
from residuum.diagnosis.residuals.residual_design import ROBUST, ResidualDesign, design_residual
from residuum.diagnosis.residuals.residual_detection import detect
from residuum.diagnosis.thresholds.threshold import EvaluationName, ThresholdKind
from residuum.identification.errors import BadInput
from residuum.identification.kernel_based.multivariable_file import is_multivariable, load_multivariable
from residuum.identification.linear_models.error_bounds.error_grid import asked_grid
from residuum.identification.linear_models.identified_model_file import load_identified
from residuum.identification.linear_models.uncertainty import WEIGHT_ORDER, design_uncertainty_weight
from residuum.identification.record import Record
from residuum.library.answers import multivariable_residual as several
from residuum.library.answers.residual import design_json, design_text, run_json, run_text
from residuum.service.commands.output_file import check_output_file
from residuum.service.commands.records import ChannelMap, DbcFile, MappingFile, Resample, SampleTime, Units, load_records
from residuum.service.commands.report import AsJson, progress, report
from residuum.service.commands.weight_options import (
    EPSILON,
    ZETA,
    Epsilon,
    Lowest,
    Points,
    Rule,
    WeightOrder,
    Zeta,
)

app = typer.Typer(add_completion=False)


@app.command()
def design(
    identified: Annotated[Path, typer.Argument(help="Model file, as `residuum identify` writes it.")],
    out: Annotated[Path, typer.Option(help="File for the design.")],
    fault: Annotated[Literal["sensor", "actuator"], typer.Option(help="Kind of fault to be most sensitive to.")] = "sensor",
    method: Annotated[
        str,
        typer.Option(
            help=f"Method for the post-filter: {ROBUST}, {', '.join(CLASSICAL_METHODS)}; of a model with several inputs and "
            f"outputs: {ROBUST}, {UNKNOWN_INPUT}."
        ),
    ] = ROBUST,
    unknown_input: Annotated[
        list[str] | None,
        typer.Option(metavar="CH", help=f"Input that will not be measured, of {UNKNOWN_INPUT}. Repeat it for several."),
    ] = None,
    gamma: Annotated[float, typer.Option(help="Largest gain from model error and noise to the residual, γ.")] = 0.1,
    healthy: Annotated[
        list[Path] | None, typer.Option("--healthy", metavar="RECORD", help="Healthy records; default: those of the model.")
    ] = None,
    channel_map: ChannelMap = None,
    epsilon: Epsilon = EPSILON,
    zeta: Zeta = ZETA,
    rule: Rule = "chernoff",
    weight_order: WeightOrder = WEIGHT_ORDER,
    points: Points = None,
    lowest: Lowest = None,
    as_json: AsJson = False,
) -> None:
    """Design a robust residual generator from an identified model."""
    check_output_file(out)
    if is_multivariable(identified):
        answer = _design_several(identified, out, method, unknown_input or [], healthy or [], channel_map)
        return report(answer, several.design_text(answer), as_json=as_json)
    if unknown_input or method == UNKNOWN_INPUT:
        raise BadInput(
            f"method {UNKNOWN_INPUT}: needs a model with several outputs, by `residuum identify` with --output repeated"
        )
    model = load_identified(identified)
    records = load_records(healthy, channel_map=channel_map) if healthy else _own_records(model.provenance.get("records", ()))
    grid = asked_grid(model.sample_time, points, lowest)
    weight = design_uncertainty_weight(model, omega=grid, accuracy=epsilon, confidence=1 - zeta, rule=rule, order=weight_order)
    made = design_residual(model, weight.weight, records, fault=fault, gamma=gamma, method=method)
    made.save(out)
    answer = design_json(made, records, identified=str(identified), file=str(out))
    report(answer, design_text(made, str(out)), as_json=as_json)


def _design_several(
    identified: Path, out: Path, method: str, unknown: list[str], healthy: list[Path], channel_map: list[str] | None
) -> dict[str, Any]:
    model = load_multivariable(identified)
    own = model.models[0][0].provenance.get("records", ())
    records = load_records(healthy, channel_map=channel_map) if healthy else _own_records(own)
    made = design_multivariable_residual(model, records, method=method, unknown=unknown)
    made.save(out)
    return several.design_json(made, identified=str(identified), file=str(out))


def _own_records(names: Any) -> list[Record]:
    """The records a model was identified from, where they are still readable."""
    files = [Path(name) for name in names if isinstance(name, str) and name]
    if not files or not all(file.is_file() for file in files):
        progress("no healthy record at hand: noise as the model says, no `calibrated` threshold (give one with --healthy)")
        return []
    return load_records(files)


@app.command()
def run(
    design: Annotated[Path, typer.Argument(help="Design file, as `residuum residual design` writes it.")],
    record: Annotated[Path, typer.Argument(metavar="RECORD", help="Record file.")],
    threshold: Annotated[ThresholdKind, typer.Option(help="Kind of threshold.")] = "posterior",
    false_alarms_per_day: Annotated[
        float, typer.Option(help="Number of false alarms a day that is accepted, for the posterior and the calibrated threshold.")
    ] = 1.0,
    evaluation: Annotated[
        EvaluationName | None,
        typer.Option(
            help="How the residual is evaluated. Default: glr (likelihood ratio over windows); point for source and peak."
        ),
    ] = None,
    noise_bound: Annotated[float | None, typer.Option(help="Largest noise, for source and peak [output unit].")] = None,
    channel_map: ChannelMap = None,
    resample: Resample = False,
    mapping: MappingFile = None,
    dbc: DbcFile = None,
    sample_time: SampleTime = None,
    unit: Units = None,
    as_json: AsJson = False,
) -> None:
    """Run a residual design on a record: is there a fault, since when, of which kind and size?"""
    loaded = load_records(
        [record], mapping=mapping, dbc=dbc, resample=resample, sample_time=sample_time, units=unit, channel_map=channel_map
    )[0]
    if stored_kind(design) == KIND:
        if (threshold, evaluation, noise_bound) != ("posterior", None, None):
            raise BadInput("a design with several inputs or outputs: has the threshold posterior alone, and its own evaluation")
        seen = detect_multivariable(MultivariableResidual.load(design), loaded, false_alarms_per_day=false_alarms_per_day)
        answer = several.run_json(loaded, seen, false_alarms_per_day)
        return report(answer, several.run_text(answer), as_json=as_json)
    made = ResidualDesign.load(design)
    found = detect(
        made,
        loaded,
        threshold=threshold,
        evaluation=evaluation,
        false_alarms_per_day=false_alarms_per_day,
        noise_bound=noise_bound,
    )
    report(run_json(made, loaded, found), run_text(made, loaded, found), as_json=as_json)
