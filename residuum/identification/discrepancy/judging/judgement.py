"""Judgement: from the structures that were tried to probabilities, groups and a verdict."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from residuum.identification.discrepancy.fitting.structures import Structure
from residuum.identification.discrepancy.judging.completeness import explains_a_part, times_the_noise_left
from residuum.identification.discrepancy.judging.free_term import FreeTerm, scaled_power
from residuum.identification.discrepancy.policy.acceptance import ACCEPT, ALIKE
from residuum.identification.discrepancy.policy.answers import (
    DOUBTED,
    LARGE_REST,
    MUCH_ABOVE_NOISE,
    NAMELESS_ABOVE_NOISE,
    NEGLIGIBLE_REST,
    REFUTED,
    UNKNOWN_FROM,
)
from residuum.identification.discrepancy.policy.likelihood import SAME
from residuum.identification.discrepancy.searching.evidence import relative_evidence
from residuum.identification.discrepancy.searching.search_state import Search
from residuum.identification.physics import Key
from residuum.identification.physics.model import find_effect
from residuum.identification.residual_analysis.policy.noise import NOTHING_LEFT
from residuum.identification.unseen_blocks.candidate import Candidate, Quantity

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Judgement:
    """Probabilities of "nothing is missing" and "something outside the catalogue is", and the candidates."""

    verdict: str
    candidates: tuple[Candidate, ...]
    none: float
    unknown: float
    unexplained_share: float


def judge(found: Search, free: FreeTerm | None, *, incomplete: bool = False) -> Judgement:
    """The verdict, each effect judged inside the best joint structure.

    The candidates of the first step share 1 − P(none) − P(unknown). P(unknown) grows with the part of all explainable
    log-likelihood that only the free term explains, and is large when what the likelihood wanted failed on held-out data or was a
    drift.
    A later step's candidates are judged given the earlier ones. `incomplete`: see
    `is_incomplete`.
    """
    share = _unexplained(found, free)
    unknown = _probability_unknown(found, share, incomplete)
    posteriors = [_posterior(found, step) for step in range(min(max(1, len(found.accepted)), len(found.alternatives)))]
    none = posteriors[0][1] if posteriors else 1.0
    listed = [c for step, (each, _) in enumerate(posteriors) for c in _candidates(found, step, each, 1.0 - unknown)]
    claims = float(sum(c.probability for c in listed if c.step == 0))
    verdict = "missing-effect" if found.accepted else "adequate"
    total = claims + none * (1.0 - unknown) + unknown
    return Judgement(
        "unknown-effect" if unknown >= UNKNOWN_FROM else verdict,
        tuple(sorted(listed, key=lambda c: _place(found, c))),
        none * (1.0 - unknown) / total,
        unknown / total,
        share,
    )


def _probability_unknown(found: Search, share: float, incomplete: bool) -> float:
    """Of something outside the catalogue, which alone explains this share of what can be explained."""
    unknown = float(np.clip((share - NEGLIGIBLE_REST) / (LARGE_REST - NEGLIGIBLE_REST), 0.0, 1.0))
    if incomplete or ((found.refuted or found.drifting) and not found.accepted):
        unknown = max(unknown, REFUTED)
    return max(unknown, _doubt(found)) if found.accepted else unknown


def _doubt(found: Search) -> float:
    """Of what was accepted: how probable something else is, for more is left than the right effects leave."""
    left = times_the_noise_left(found.best)
    if left > NAMELESS_ABOVE_NOISE:
        return REFUTED
    much = left > MUCH_ABOVE_NOISE or (left >= NOTHING_LEFT and explains_a_part(found))
    return DOUBTED if much or not _recorded(found) else 0.0


def _place(found: Search, c: Candidate) -> tuple[int, float, int]:
    """Order of the candidates: by step, those that were accepted first; of a group that shares its probability the simplest."""
    step = c.step if _is_accepted(found, c) else len(found.accepted)
    return step, round(-c.probability, 9), sum(q.std > 0 for q in c.parameters.values())


def _recorded(found: Search) -> bool:
    """Whether the records say when the effects act that were accepted."""
    model = found.best.model
    return all(find_effect(id).recorded(model.site(target, find_effect(id))) for id, target in found.accepted)


def _is_accepted(found: Search, candidate: Candidate) -> bool:
    return candidate.step < len(found.accepted) and found.accepted[candidate.step] == candidate.key


def _unexplained(found: Search, free: FreeTerm | None) -> float:
    """Share of what can be explained that the catalogue leaves to the free term: geometric mean of likelihood and of power.

    Likelihood alone would call a millivolt of rest unknown physics where the noise is a tenth of that; power alone would
    overlook a large error that is confined to a short time.
    """
    if free is None or free.evidence < ALIKE:
        return 0.0
    explained = max(found.best.log_likelihood - found.base.log_likelihood - found.best.penalty(found.base), 0.0)
    information = free.gain / (free.gain + explained)
    before, now = (scaled_power(s.residuals, found.best.noises) for s in (found.base, found.best))
    power = max(now - free.rest, 0.0) / max(before - free.rest, now - free.rest, 1e-300)
    return float(np.clip(np.sqrt(information * power), 0.0, 1.0))


def _posterior(found: Search, step: int) -> tuple[dict[Key, float], float]:
    before, structures = found.before[step], found.alternatives[step]
    scores, nothing = relative_evidence(structures, before)
    nothing += float(np.log(max(found.count, 1)))  # the prior: "nothing" weighs as much as all candidates together
    if found.accepted[step : step + 1] and found.accepted[step] in found.plain:
        nothing = min(nothing, -ACCEPT)
    top = max([nothing, *scores.values()])
    total = float(np.exp(nothing - top) + sum(np.exp(value - top) for value in scores.values()))
    return {key: float(np.exp(value - top)) / total for key, value in scores.items()}, float(np.exp(nothing - top)) / total


def _candidates(found: Search, step: int, posterior: Mapping[Key, float], rest: float) -> list[Candidate]:
    before, structures = found.before[step], found.alternatives[step]
    scores, nothing = relative_evidence(structures, before)
    groups = _groups(structures, scores)
    listed = []
    for key in sorted(scores, key=lambda k: -scores[k]):
        group = groups[key]
        probability = rest * sum(posterior[k] for k in group) / len(group)
        others = tuple(k[0] for k in group if k != key)
        value = scores[key] - nothing - float(np.log(max(found.count, 1)))
        errors = found.held_out.get(key)
        listed.append(_candidate(key, structures[key], before, probability, others, value, step, errors))
    return listed


def _groups(structures: Mapping[Key, Structure], scores: Mapping[Key, float]) -> dict[Key, list[Key]]:
    """For each candidate those that the experiment cannot tell from it (only around the leading one)."""
    groups = {key: [key] for key in structures}
    if not scores:
        return groups
    leader = max(scores, key=lambda k: scores[k])
    L = structures[leader].log_likelihood
    alike = [k for k, s in structures.items() if scores[leader] - scores[k] < ALIKE and abs(L - s.log_likelihood) < 2 * ALIKE]
    alike += [k for k in structures if k not in alike and _is_open(k, structures[k], leader, L)]
    return groups | {key: sorted(alike, key=lambda k: -scores[k]) for key in alike}


def _is_open(key: Key, structure: Structure, leader: Key, log_likelihood: float) -> bool:
    """Whether an effect that generalises the leading one is as likely, and its sizes are left open: only its price is against it.

    Beside a spring that is at rest anywhere nobody can tell how friction differs between the two directions.
    """
    if (find_effect(key[0]).generalises, key[1]) != leader or abs(structure.log_likelihood - log_likelihood) > SAME:
        return False
    label, std = structure.label_of(key), dict(zip(structure.parameters, structure.std.tolist(), strict=True))
    return all(std.get(f"{label}.{size}") == np.inf for size in find_effect(key[0]).sizes)


def _candidate(
    key: Key,
    structure: Structure,
    before: Structure,
    probability: float,
    others: tuple[str, ...],
    value: float,
    step: int,
    held_out: tuple[FloatArray, FloatArray] | None,
) -> Candidate:
    label = structure.label_of(key)
    std = dict(zip(structure.parameters, structure.std, strict=True))
    parameters = {
        name.removeprefix(f"{label}."): Quantity(p.value, float(std.get(name, 0.0)), p.unit)
        for name, p in structure.model.all_parameters.items()
        if name.startswith(f"{label}.")
    }
    with np.errstate(invalid="ignore"):
        o = int(np.nanargmin(structure.rmse / before.rmse))
    output = list(structure.model.outputs.values())[o]
    errors = (before.rmse, structure.rmse) if held_out is None else held_out
    return Candidate(
        effect=key[0],
        balance=key[1],
        probability=probability,
        indistinguishable_from=others,
        parameters=parameters,
        error_before=float(errors[0][o]),
        error_after=float(errors[1][o]),
        error_unit=output.unit,
        output=output.name,
        within_bounds=not any(name.startswith(f"{label}.") for name in structure.at_bound),
        evidence=value,
        step=step,
        held_out=held_out is not None,
    )
