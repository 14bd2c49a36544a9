"""Judgement: from the structures that were tried to probabilities, groups and a verdict."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from residuum.identification.discrepancy.axes import signal_axes
from residuum.identification.discrepancy.compare import structured_errors
from residuum.identification.discrepancy.evidence import ALIKE, relative_evidence
from residuum.identification.discrepancy.free_term import FreeTerm, scaled_power
from residuum.identification.discrepancy.growth import Search
from residuum.identification.discrepancy.noise_floor import (
    PLAINLY,
    STANDS_OUT,
    fast_floor,
    times_the_noise,
    times_the_quiet_noise,
)
from residuum.identification.discrepancy.structures import Structure, times_its_innovations
from residuum.identification.discrepancy.trials import ACCEPT, NOTHING_LEFT, SLOW
from residuum.identification.errors import NotIdentifiable
from residuum.identification.physics import Estimate, Experiment, Settings, Simulator, estimate
from residuum.identification.physics.model import find_effect

FloatArray = npt.NDArray[np.float64]

_NEGLIGIBLE, _MOST = 0.03, 0.30
"""Shares of the explainable gain that a free term may take before the candidates lose probability, and lose all of it."""

_REFUTED = 0.9
_MOSTLY = 0.7
_MUCH, _NEARLY_ALL, _DOUBTED = 3.0, 100.0, 0.3
"""Times the noise floor that no error keeps with the right effect added (at most 2); beyond which no name stands; and how
probable something else is between them."""
_SAME = 0.5
"""Log-likelihood within which the data do not prefer either of two."""
_MOST_OF_IT = 0.8
"""Share of what stands above the noise that the right effect takes away at least, where more than noise is left."""
_CERTAIN, _SHARE = 1e-4, 0.2
"""Level of the test, and share of the error's power, from which on a model errs by its own signals."""


@dataclass(frozen=True)
class Quantity:
    """A number with its standard deviation and unit."""

    value: float
    std: float
    unit: str


@dataclass(frozen=True)
class Candidate:
    """One effect that may be missing, with what speaks for it.

    `step` counts the effects that were accepted before it; `evidence` is its log odds against "nothing more is missing";
    the errors are RMS simulation errors of `output` before and after it was added, on data that were not used for the
    estimation where `held_out` says so; `share` is the part of the error's power that it takes away on blocks kept aside.
    """

    effect: str
    balance: str
    probability: float
    indistinguishable_from: tuple[str, ...]
    parameters: Mapping[str, Quantity]
    error_before: float
    error_after: float
    error_unit: str
    output: str
    within_bounds: bool
    evidence: float
    step: int = 0
    held_out: bool = False
    share: Quantity | None = None


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
    unknown = float(np.clip((share - _NEGLIGIBLE) / (_MOST - _NEGLIGIBLE), 0.0, 1.0))
    if incomplete or ((found.refuted or found.drifting) and not found.accepted):
        unknown = max(unknown, _REFUTED)
    left = _times_left(found.best)
    if found.accepted and left > _NEARLY_ALL:
        unknown = max(unknown, _REFUTED)
    elif found.accepted and (left > _MUCH or (left >= NOTHING_LEFT and _explains_a_part(found)) or not _recorded(found)):
        unknown = max(unknown, _DOUBTED)
    listed: list[Candidate] = []
    none = 1.0
    for step in range(min(max(1, len(found.accepted)), len(found.alternatives))):
        posterior, nothing = _posterior(found, step)
        if step == 0:
            none = nothing
        listed += _candidates(found, step, posterior, 1.0 - unknown)
    accepted = len(found.accepted) > 0
    claims = float(sum(c.probability for c in listed if c.step == 0))
    verdict = "missing-effect" if accepted and unknown < 0.5 else "adequate"
    if unknown >= 0.5:
        verdict = "unknown-effect"
    total = claims + none * (1.0 - unknown) + unknown

    def place(c: Candidate) -> tuple[int, float, int]:
        step = c.step if _is_accepted(found, c) else len(found.accepted)
        estimated = sum(q.std > 0 for q in c.parameters.values())
        return step, round(-c.probability, 9), estimated  # of a group that shares its probability the simplest first

    leading = sorted(listed, key=place)
    return Judgement(verdict, tuple(leading), none * (1.0 - unknown) / total, unknown / total, share)


def _explains_a_part(found: Search) -> bool:
    """Whether little went of what stood above the noise: the nearest shape in the catalogue to something else does that."""
    before, after = (np.concatenate(s.residuals) ** 2 for s in (found.base, found.best))
    floors = np.array([fast_floor(column) for column in _of_each_output(found.best.residuals)])
    known = floors > 0.0
    stood, stands = (np.sum(np.nanmean(power[:, known], axis=0) / floors[known] ** 2 - 1.0) for power in (before, after))
    return bool(stood - stands < _MOST_OF_IT * stood)


def _recorded(found: Search) -> bool:
    """Whether the records say when the effects act that were accepted."""
    model = found.best.model
    return all(find_effect(id).recorded(model.site(target, find_effect(id))) for id, target in found.accepted)


def leaves_much(structure: Structure) -> bool:
    """Whether an error stands so far above the noise of its fast part as none does with the right effects in the model."""
    return _times_left(structure) > _MUCH


def at_the_noise(structure: Structure) -> bool:
    """Whether no more is left of any output than the right effects leave."""
    return not leaves_much(structure)


def _times_left(structure: Structure) -> float:
    return max(map(times_the_noise, _of_each_output(structure.residuals)))


def _of_each_output(residuals: Sequence[FloatArray]) -> list[tuple[FloatArray, ...]]:
    """The residuals (n, outputs) of several experiments output by output."""
    return list(zip(*(r.T for r in residuals), strict=True))


def _plain(best: Structure, experiments: Sequence[Experiment]) -> Estimate | None:
    try:
        settings = Settings(iterations=20, tolerance=1e-4)
        return estimate(best.model, experiments, initial=best.initial, settings=settings)
    except NotIdentifiable:
        return None


def is_incomplete(found: Search, experiments: Sequence[Experiment]) -> bool:
    """Whether the model's own signals predict its least simulation error, so that it cannot be called complete.

    The search may find nothing to add and yet a slow error remain: noise that is nearly integrated swallows it. Or what it
    found takes away little of the error, as the nearest shape to something that the catalogue does not hold. Where an output's
    error fell to less than `_MOSTLY` what was found stands, complete or not.

    Few steps of an input, and as many slow answers that the model lacks, look like a walk at random; but a model whose error
    stands `SLOW` times above what its noise cannot predict is not complete either way.
    """
    with np.errstate(invalid="ignore"):
        fell = float(np.nanmin(found.best.rmse / found.base.rmse))
    if fell < _MOSTLY:
        return False
    if times_its_innovations(found.best) > SLOW:
        return True
    least = _plain(found.best, experiments) or found.best  # where that leads to where the model diverges: as it is likeliest
    simulator = Simulator(least.model)
    runs = simulator.run_each(experiments, least.initial, simulator.p(), substeps=least.substeps)
    residuals = runs.errors_of_each
    columns = _of_each_output(residuals)
    if any(times_the_noise(c) > PLAINLY or times_the_quiet_noise(c) > STANDS_OUT for c in columns):
        return True
    axes = [signal_axes(least.model, e, run.X) for e, run in zip(experiments, runs, strict=True)]
    tests = structured_errors(experiments, residuals, axes, least.model, level=_CERTAIN, least_share=_SHARE)
    return any(test.present and test.share > _SHARE for test in tests.values())


def _is_accepted(found: Search, candidate: Candidate) -> bool:
    return candidate.step < len(found.accepted) and found.accepted[candidate.step] == (candidate.effect, candidate.balance)


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


def _posterior(found: Search, step: int) -> tuple[dict[tuple[str, str], float], float]:
    before, structures = found.before[step], found.alternatives[step]
    scores, nothing = relative_evidence(structures, before)
    nothing += float(np.log(max(found.count, 1)))  # the prior: "nothing" weighs as much as all candidates together
    if found.accepted[step : step + 1] and found.accepted[step] in found.plain:
        nothing = min(nothing, -ACCEPT)
    top = max([nothing, *scores.values()])
    total = float(np.exp(nothing - top) + sum(np.exp(value - top) for value in scores.values()))
    return {key: float(np.exp(value - top)) / total for key, value in scores.items()}, float(np.exp(nothing - top)) / total


def _candidates(found: Search, step: int, posterior: Mapping[tuple[str, str], float], rest: float) -> list[Candidate]:
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


def _groups(
    structures: Mapping[tuple[str, str], Structure], scores: Mapping[tuple[str, str], float]
) -> dict[tuple[str, str], list[tuple[str, str]]]:
    """For each candidate those that the experiment cannot tell from it (only around the leading one)."""
    groups = {key: [key] for key in structures}
    if not scores:
        return groups
    leader = max(scores, key=lambda k: scores[k])
    L = structures[leader].log_likelihood
    alike = [k for k, s in structures.items() if scores[leader] - scores[k] < ALIKE and abs(L - s.log_likelihood) < 2 * ALIKE]
    alike += [k for k in structures if k not in alike and _is_open(k, structures[k], leader, L)]
    return groups | {key: sorted(alike, key=lambda k: -scores[k]) for key in alike}


def _is_open(key: tuple[str, str], structure: Structure, leader: tuple[str, str], log_likelihood: float) -> bool:
    """Whether an effect that generalises the leading one is as likely, and its sizes are left open: only its price is against it.

    Beside a spring that is at rest anywhere nobody can tell how friction differs between the two directions.
    """
    if (find_effect(key[0]).generalises, key[1]) != leader or abs(structure.log_likelihood - log_likelihood) > _SAME:
        return False
    label, std = structure.label_of(key), dict(zip(structure.parameters, structure.std.tolist(), strict=True))
    return all(std.get(f"{label}.{size}") == np.inf for size in find_effect(key[0]).sizes)


def _candidate(
    key: tuple[str, str],
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
