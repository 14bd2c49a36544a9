"""What `explain` adds to the `compare` object, and its short report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from math import isfinite
from typing import Any

import numpy as np

from residuum.array_types import FloatArray
from residuum.identification.discrepancy.explain import EstimatedValue, Explanation
from residuum.identification.errors import said
from residuum.identification.physics.model import place_of, tied_to
from residuum.identification.residual_analysis.policy import SLOW
from residuum.identification.unseen_blocks.free_term import BlockTerm, nearest_formula
from residuum.identification.unseen_blocks.structure import HeldValue
from residuum.identification.unseen_blocks.verdict import (
    BlockErrors,
    Candidate,
    Quantity,
    Remaining,
)
from residuum.identification.work import Work
from residuum.library.answers.plain import quantities_json, sizes_text, value_text

# What is told of an effect that is tied to other signals: the channel of a forgotten input, the
# curve that was learned.


def tied_json(effect: str, target: str, parameters: Mapping[str, Quantity]) -> dict[str, Any]:
    """Keys beside those that every effect has; none for an effect of the catalogue."""
    tied = tied_to(target)
    if effect == "forgotten-input":
        gain = parameters["gain"]
        return {
            "channel": tied[0],
            "gain": {"value": gain.value, "std": gain.std, "unit": gain.unit},
        }
    if effect == "coupling":
        return {"between": [place_of(target), tied[0]]}
    if effect == "learned":
        return {
            "signals": list(tied),
            "curve": _curve(parameters),
            "formula": _formula(tied[0], parameters),
        }
    return {}


def tied_text(effect: str, target: str, parameters: Mapping[str, Quantity]) -> str | None:
    """One sentence in the place of a list of parameters; None for an effect of the catalogue."""
    place, tied = place_of(target), tied_to(target)
    if effect == "forgotten-input":
        gain = parameters["gain"]
        return (
            f"what {place} lacks follows {tied[0]} with {gain.value:.3g} ± {gain.std:.2g}"
            f" {gain.unit}".rstrip()
        )
    if effect == "learned":
        formula = _formula(tied[0], parameters) or "no formula comes near"
        return f"a curve over {tied[0]}, {len(_curve(parameters)['at'])} values: {formula}"
    return None


def _curve(parameters: Mapping[str, Quantity]) -> dict[str, Any]:
    count = sum(name.startswith("a") for name in parameters)
    at = [parameters[f"a{k}"] for k in range(1, count + 1)]
    values = [parameters[f"v{k}"] for k in range(1, count + 1)]
    return {
        "at": [q.value for q in at],
        "value": [q.value for q in values],
        "std": [q.std for q in values],
        "unit": values[0].unit,
        "at_unit": at[0].unit,
    }


def _formula(signal: str, parameters: Mapping[str, Quantity]) -> str | None:
    curve = _curve(parameters)
    # A curve of values says little to a reader; a formula that comes near says what it is like.
    nearest = nearest_formula(np.array(curve["at"]), np.array(curve["value"]))
    return (
        None
        if nearest is None
        else (
            f"{nearest.formula} {curve['unit']}, z = {signal} / {nearest.largest:.3g}"
            f" {curve['at_unit']}".rstrip()
        )
    )


# Power of an experiment below which it is no advice. Chosen.
_WORTH_SAYING = 0.1
# Candidates that are less probable are only named.
_RULED_OUT = 0.005
# Of what was not tried, so many are named: the whole list filled a page for a real arm.
_TOLD = 6


# What is said of an error that stands so many times above its innovations.
_OF_THE_REST = {
    "adequate": ("noise that is slow, or something slow that no candidate explains", 3.0),
    "missing-effect": ("what is named is not all, or was not followed to its end", SLOW),
    "unknown-effect": ("something slow that no candidate explains, or that drifts", SLOW),
}


def explanation_json(explanation: Explanation) -> dict[str, Any]:
    """What `explain` adds to the `compare` object."""
    return {
        "verdict": explanation.verdict,
        "candidates": [
            _candidate_json(candidate)
            for candidate in explanation.candidates
            if candidate.step == 0
        ],
        "also_missing": [
            _candidate_json(candidate) for candidate in explanation.candidates if candidate.step > 0
        ],
        "probability_nothing_missing": explanation.probability_none,
        "probability_unknown_effect": explanation.probability_unknown,
        "undetectable": [
            {
                "effect": u.effect,
                "balance": u.balance,
                "smallest_visible": u.smallest_visible,
                "unit": u.unit,
            }
            for u in explanation.undetectable
        ],
        "unexplained_share": explanation.unexplained_share,
        "left": {
            output: {"rmse": rms, "unit": unit, "times_its_innovations": times}
            for output, (rms, unit, times) in explanation.left.items()
        },
        "missing_term": None if explanation.free is None else free_term_json(explanation.free),
        "next_experiment": [
            {"do": p.do, "separates": list(p.separates), "power": p.power}
            for p in explanation.next_experiment
        ],
        "estimated_values": [
            asdict(value) | {"differs": value.differs} for value in explanation.values
        ],
        "held_values": [asdict(held) for held in explanation.held],
        "timing": [{"effect": effect, "at": target} for effect, target in explanation.timing],
        "drifting": explanation.drifting,
        "by_share": explanation.by_share,
        "remaining": remaining_json(explanation.remaining),
        "blocks": _blocks_json(explanation.blocks),
        "work": work_json(explanation.work),
        "seconds": explanation.seconds,
    }


def _blocks_json(blocks: BlockErrors) -> dict[str, Any]:
    """RMS errors of each output on unseen blocks: before, after, and with each candidate alone;
    null where unmeasured.
    """

    def listed(errors: FloatArray) -> list[float | None]:
        # JSON has no NaN.
        return [float(e) if isfinite(e) else None for e in errors]

    return {
        "blocks": [
            {"record": record, "from": begin, "to": end}
            for record, (begin, end) in zip(blocks.records, blocks.times, strict=True)
        ],
        "outputs": [
            {
                "output": output,
                "unit": unit,
                "before": listed(blocks.before[:, o]),
                "after": listed(blocks.after[:, o]),
                "candidates": [
                    {"effect": key.effect, "balance": key.target, "error": listed(errors[:, o])}
                    for key, errors in blocks.candidates.items()
                ],
            }
            for o, (output, unit) in enumerate(zip(blocks.outputs, blocks.units, strict=True))
        ],
    }


def work_json(work: Work) -> dict[str, Any]:
    """What was computed, and what was not tried because the work, or the seconds that a user gave,
    were over.
    """
    return {
        "samples": work.samples,
        "fits": work.fits,
        "not_tried": work.not_tried,
        "out_of_seconds": work.timed_out,
    }


def work_text(work: Work) -> list[str]:
    """A line where something was not tried."""
    if not work.not_tried:
        return []
    why = (
        "the seconds given were over"
        if work.timed_out
        else "the work that a search may take was done"
    )
    # The object names all; a line of text some.
    shown, more = work.not_tried[:_TOLD], len(work.not_tried) - _TOLD
    return [
        f"  not tried, for {why}: {', '.join(shown)}"
        + (f" and {more} more (the JSON object names them)" if more > 0 else "")
    ]


def free_term_json(free: BlockTerm) -> dict[str, Any]:
    """The shape of what the catalogue leaves unexplained."""
    formula = nearest_formula(free.at, free.value)
    return {
        "suggestion": None if formula is None else asdict(formula),
        "balance": free.balance,
        "axis": free.axis,
        "unit": free.unit,
        "at": free.at,
        "value": free.value,
        "evidence": free.evidence,
    }


def _candidate_json(candidate: Candidate) -> dict[str, Any]:
    return {
        "effect": candidate.effect,
        "balance": candidate.balance,
        "probability": candidate.probability,
        "indistinguishable_from": list(candidate.indistinguishable_from),
        "rivals": list(candidate.rivals),
        "parameters": quantities_json(candidate.parameters),
        "error_before": candidate.error_before,
        "error_after": candidate.error_after,
        "error_unit": candidate.error_unit,
        "output": candidate.output,
        "held_out": candidate.held_out,
        "within_bounds": candidate.within_bounds,
        "share": (
            None
            if candidate.share is None
            else {"value": candidate.share.value, "std": candidate.share.std}
        ),
        "because": _because(candidate),
    } | tied_json(candidate.effect, candidate.balance, candidate.parameters)


def _because(candidate: Candidate) -> str:
    """One sentence for the candidate: how much it takes away, of what, and what may stand for
    it.
    """
    if candidate.share is None:
        return (
            f"{candidate.effect} at {candidate.balance} makes the records more likely than the"
            " model without it"
        )
    share = f"{100 * candidate.share.value:.0f} ± {100 * candidate.share.std:.0f} %"
    alike = f"; {' or '.join(candidate.rivals)} would do as well" if candidate.alike else ""
    return (
        f"{candidate.effect} at {candidate.balance} takes away {share} of the error's power on"
        f" blocks kept aside{alike}"
    )


def remaining_json(remaining: Remaining) -> dict[str, Any]:
    """What is left on blocks kept aside."""
    begin, end = remaining.where
    return {
        "share": remaining.share,
        "times_noise": remaining.times_noise if isfinite(remaining.times_noise) else None,
        "where": {"axis": "time", "from": begin, "to": end, "unit": "s"},
    }


def _candidate_text(candidate: Candidate) -> str:
    sizes = tied_text(candidate.effect, candidate.balance, candidate.parameters) or sizes_text(
        candidate.parameters
    )
    text = (
        f"  {'then ' if candidate.step else ''}{candidate.effect} in {candidate.balance}: "
        f"probability {candidate.probability:.2f}, {sizes}; "
        f"{candidate.output} error {'on data kept aside ' if candidate.held_out else ''}"
        f"{candidate.error_before:.4g} → {candidate.error_after:.4g} {candidate.error_unit}"
    )
    bounds = "" if candidate.within_bounds else "; at a physical bound"
    rivals = f"; not to be told from {', '.join(candidate.rivals)}" if candidate.alike else ""
    return text + bounds + rivals


def held_text(held: HeldValue) -> str:
    """One line for a fixed value that the records contradict."""
    alike = (
        f" ({', '.join(held.indistinguishable_from)} would do as well)"
        if held.indistinguishable_from
        else ""
    )
    asked, way_on = value_text(held.value, held.std, held.unit), said("free", [held.name])
    against = (
        f"as much as {' and '.join(held.as_much_as)}"
        if held.as_much_as
        else "more than an effect would"
    )
    return (
        f"  {held.name} is fixed at {held.held:.4g} {held.unit}; the records ask for {asked}, which"
        f" explains {against}{alike}: improve with {way_on} takes it up"
    )


def _values_text(values: Sequence[EstimatedValue]) -> list[str]:
    """One line for the values that the records contradict."""
    # Of a machine whose mass had changed it would not be told why its model errs.
    estimates = [
        f"{v.name} = {value_text(v.value, v.std, v.unit)} (file: {v.file:.4g})"
        for v in values
        if v.differs
    ]
    return [f"  estimated from the records: {', '.join(estimates)}"] if estimates else []


def _free_term_text(explanation: Explanation) -> list[str]:
    """What a term outside the catalogue explains, and what it looks like."""
    free = explanation.free
    if (
        free is None
        or explanation.probability_unknown <= 0.1
        or explanation.unexplained_share <= 0.0
    ):
        return []
    lines = [
        f"  a term outside the catalogue in balance {free.balance}, a function of {free.axis},"
        f" explains {100 * explanation.unexplained_share:.0f} % of what can be explained"
    ]
    formula = nearest_formula(free.at, free.value)
    if formula is not None:
        lines.append(
            f"    it looks like {formula.formula} {free.unit}, z = {free.axis} /"
            f" {formula.largest:.3g}"
        )
    return lines


def _rest_text(explanation: Explanation) -> list[str]:
    """What remains of each output's error, what drifts, and what is said of the record's timing."""
    says, from_ = _OF_THE_REST[explanation.verdict]
    lines = [
        f"  {output}: {rms:.3g} {unit} RMS remain, {times:.0f} times what their own past cannot"
        f" predict: {says}"
        for output, (rms, unit, times) in explanation.left.items()
        if times > from_
    ]
    if explanation.drifting:
        lines.append(
            "  an unknown load or offset drifts with time; it explains more than any effect would"
        )
    return lines + [
        f"  {effect} at {target} by less than a sample: how the record was taken"
        for effect, target in explanation.timing
    ]


def explanation_text(explanation: Explanation) -> str:
    """The short human report."""
    lines = [f"verdict: {explanation.verdict}"]
    lines += map(held_text, explanation.held)
    # What was accepted in a later step is told whatever its probability there was.
    likely = [c for c in explanation.candidates if c.step > 0 or c.probability >= _RULED_OUT]
    named = {candidate.key for candidate in likely} | set(explanation.timing)
    ruled_out = [c for c in explanation.candidates if c not in likely and c.key not in named]
    lines += map(_candidate_text, likely[:6])
    if ruled_out:
        lines.append(
            f"  tried and ruled out: {', '.join(f'{c.effect} in {c.balance}' for c in ruled_out)}"
        )
    lines += (
        _values_text(explanation.values) + _free_term_text(explanation) + _rest_text(explanation)
    )
    lines += [
        f"  next: {p.do} (tells {' from '.join(p.separates)} in {100 * p.power:.0f} % of the cases)"
        for p in explanation.next_experiment[:2]
        if p.power >= _WORTH_SAYING
    ]
    lines += work_text(explanation.work)
    lines.append(
        f"  none of these: {explanation.probability_none + explanation.probability_unknown:.2f}"
    )
    return "\n".join(lines)
