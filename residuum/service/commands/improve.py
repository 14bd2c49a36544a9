"""`residuum improve`: add effects to a model and re-estimate it."""

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer

from residuum.identification.discrepancy.improve import Improvement, improve, quantities_of
from residuum.identification.errors import BadInput
from residuum.identification.physics import EffectUse, load_model, write_model
from residuum.service.commands.explain import Learned, Seconds, held_text, remaining_json
from residuum.service.commands.output_file import check_output_file
from residuum.service.commands.quantities import quantities_json, sizes_text
from residuum.service.commands.records import ChannelMap, RecordFiles, Resample, SampleTime, Units, load_records, pairs
from residuum.service.commands.report import AsJson, progress, report
from residuum.service.commands.tied_effects import tied_json, tied_text
from residuum.service.work.large_arrays import keep_large_arrays

app = typer.Typer(add_completion=False)


@app.command(name="improve")
def improve_command(
    model: Annotated[str, typer.Argument(metavar="MODEL", help="A built-in model or a model file.")],
    records: RecordFiles,
    out: Annotated[Path, typer.Option(help="Model file to write; the previous file stays as it is.")],
    add: Annotated[
        list[str] | None, typer.Option(metavar="ID…", help="Effects to add: ID or ID@TARGET, also with commas.")
    ] = None,
    auto: Annotated[bool, typer.Option("--auto", help="Add what explain finds until the model is adequate.")] = False,
    effects: Annotated[str | None, typer.Option(metavar="ID,…", help="With --auto: consider only these effects.")] = None,
    free: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME…", help="Parameters that the model fixes, to be estimated; also with commas."),
    ] = None,
    learned: Learned = False,
    seconds: Seconds = 24.0,
    channel_map: ChannelMap = None,
    resample: Resample = False,
    sample_time: SampleTime = None,
    unit: Units = None,
    as_json: AsJson = False,
) -> None:
    """Add effects to a model, re-estimate it, and show its error on data not used for that."""
    if auto == bool(add):
        raise BadInput("improve: give either --add ID or --auto")
    check_output_file(out)
    if Path(model).exists() and out.exists() and Path(model).samefile(out):
        raise BadInput(f"improve: --out {out} is the model itself; write a new file, the previous one is the way back")
    loaded = load_records(records, resample=resample, sample_time=sample_time, units=unit)
    wanted = None if auto else names_of(add)
    considered = None if effects is None else [id.strip() for id in effects.split(",")]
    keep_large_arrays()
    improvement = improve(
        load_model(model),
        loaded,
        pairs("--map", channel_map),
        add=wanted,
        effects=considered,
        free=names_of(free),
        learned=learned,
        seconds=seconds,
        tell=lambda share, doing: progress(doing, share),
    )
    out.write_text(write_model(improvement.model), encoding="utf-8")
    remaining = None if improvement.explanation is None else improvement.explanation.remaining
    result = {
        "history": [
            {"added": step.added, "error": step.error} | ({"together": True} if step.together else {})
            for step in improvement.history
        ],
        "verdict": improvement.verdict,
        "effects": [_effect_json(use, improvement) for use in improvement.added],
        "output": improvement.output,
        "error_unit": improvement.error_unit,
        "held_out": True,
        "kept_aside": improvement.aside,
        "held_values": [] if improvement.explanation is None else [asdict(held) for held in improvement.explanation.held],
        "remaining": None if remaining is None else remaining_json(remaining),
        "model_file": str(out),
    }
    report(result, improvement_text(improvement, out), as_json=as_json)


def names_of(texts: Sequence[str] | None) -> list[str]:
    """Names given once each or several with commas between them.

    >>> names_of(["a,b", "c"])
    ['a', 'b', 'c']
    """
    return [name.strip() for text in texts or [] for name in text.split(",")]


def _effect_json(use: EffectUse, improvement: Improvement) -> dict[str, Any]:
    judged = improvement.candidate(use)
    return {
        "effect": use.id,
        "at": use.target,
        "probability": None if judged is None else judged.probability,
        "indistinguishable_from": [] if judged is None else list(judged.indistinguishable_from),
        "parameters": quantities_json(quantities_of(use)),
    } | tied_json(use.id, use.target, quantities_of(use))


def improvement_text(improvement: Improvement, out: Path) -> str:
    """The short human report."""
    lines = [f"error of {improvement.output} on held-out data ({improvement.aside}; explained and estimated on the rest):"]
    lines += [
        f"  {step.added or 'the model as it was'}: {step.error:.4g} {improvement.error_unit}"
        + (" (together, each alone raises it)" if step.together else "")
        for step in improvement.history
    ]
    lines += [_effect_text(use, improvement) for use in improvement.added]
    lines += [] if improvement.explanation is None else map(held_text, improvement.explanation.held)
    return "\n".join([*lines, f"verdict: {improvement.verdict}", f"model file (estimated on everything): {out}"])


def _effect_text(use: EffectUse, improvement: Improvement) -> str:
    judged = improvement.candidate(use)
    sizes = tied_text(use.id, use.target, quantities_of(use)) or sizes_text(quantities_of(use))
    text = f"{use.id} in {use.target}: {sizes}"
    if judged is None:
        return text
    others = f", not to be told from {', '.join(judged.indistinguishable_from)}" if judged.indistinguishable_from else ""
    return f"{text} (probability {judged.probability:.2f}{others})"
