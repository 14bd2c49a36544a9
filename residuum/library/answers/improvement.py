"""The `improve` object and its short report."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from residuum.identification.discrepancy.improvement import Improvement, Step, quantities_of
from residuum.identification.physics import EffectUse
from residuum.library.answers.explanation import (
    held_text,
    remaining_json,
    tied_json,
    tied_text,
    work_json,
    work_text,
)
from residuum.library.answers.plain import quantities_json, sizes_text


def improvement_json(improvement: Improvement, file: str | None) -> dict[str, Any]:
    """The `improve` object of the command line and the HTTP interface; `file` is where the model
    was written.
    """
    remaining = None if improvement.explanation is None else improvement.explanation.remaining
    return {
        "history": [
            {"added": step.added, "at": step.at, "error": step.error}
            | {"remaining": None if step.remaining is None else remaining_json(step.remaining)}
            for step in improvement.history
        ],
        "verdict": improvement.verdict,
        "effects": [_effect_json(use, improvement) for use in improvement.added],
        "output": improvement.output,
        "error_unit": improvement.error_unit,
        "held_out": True,
        "kept_aside": improvement.aside,
        "refused": list(improvement.refused),
        "held_values": (
            []
            if improvement.explanation is None
            else [asdict(held) for held in improvement.explanation.held]
        ),
        "remaining": None if remaining is None else remaining_json(remaining),
        "work": work_json(improvement.work),
        "model_file": file,
    }


def _effect_json(use: EffectUse, improvement: Improvement) -> dict[str, Any]:
    judged = improvement.candidate(use)
    return {
        "effect": use.id,
        "at": use.target,
        "probability": None if judged is None else judged.probability,
        "indistinguishable_from": [] if judged is None else list(judged.indistinguishable_from),
        "parameters": quantities_json(quantities_of(use)),
    } | tied_json(use.id, use.target, quantities_of(use))


def improvement_text(improvement: Improvement, file: str | None) -> str:
    """The short human report."""
    lines = [
        f"error of {improvement.output} on held-out data ({improvement.aside}; explained and"
        " estimated on the rest):"
    ]
    lines += [
        f"  {step_text(step)}: {step.error:.4g} {improvement.error_unit}"
        for step in improvement.history
    ]
    lines += [] if improvement.explanation is None else map(held_text, improvement.explanation.held)
    lines += [_effect_text(use, improvement) for use in improvement.added]
    if improvement.refused:
        lines.append(
            "  not added, for the error on held-out data would rise:"
            f" {', '.join(improvement.refused)}"
        )
    lines += work_text(improvement.work)
    lines.append(f"verdict: {improvement.verdict}")
    if file:
        lines.append(f"model file (estimated on everything): {file}")
    elif not improvement.helps:
        lines.append("nothing is written: what is missing by name would make the model worse")
    return "\n".join(lines)


def step_text(step: Step) -> str:
    """What a line of the history says was added, and where."""
    place = "" if step.at is None else f" in {step.at}"
    return f"{step.added or 'the model as it was'}{place}"


def _effect_text(use: EffectUse, improvement: Improvement) -> str:
    judged = improvement.candidate(use)
    sizes = tied_text(use.id, use.target, quantities_of(use)) or sizes_text(quantities_of(use))
    text = f"{use.id} in {use.target}: {sizes}"
    # What a user asked for by name was not compared with rivals, and has no probability.
    if judged is None:
        return text
    rivals = f", not to be told from {', '.join(judged.rivals)}" if judged.alike else ""
    return f"{text} (probability {judged.probability:.2f}{rivals})"
