"""Explain: which physical effect is missing in a model?"""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from residuum.identification.blas_threads import one_thread
from residuum.identification.discrepancy.advice import NextExperiment, Undetectable, next_experiments, undetectable
from residuum.identification.discrepancy.candidate import Candidate
from residuum.identification.discrepancy.data import Data, data_of, matched
from residuum.identification.discrepancy.following import followed
from residuum.identification.discrepancy.free_term import FreeTerm, free_terms
from residuum.identification.discrepancy.ladder import climb_at_likelier_timing
from residuum.identification.discrepancy.policy import MOST_EFFORT
from residuum.identification.discrepancy.proposals import HELD, forgotten_columns
from residuum.identification.discrepancy.search import Search, Tell, Wanted, search, untold
from residuum.identification.discrepancy.structure import fitted
from residuum.identification.discrepancy.verdict import Step, is_timing, share_of, steps_of, verdict_on
from residuum.identification.physics import Key, PhysicalModel, find_effect, noise_floor, with_coloured_noise
from residuum.identification.record import Record
from residuum.identification.residual_analysis.compare import compare
from residuum.identification.residual_analysis.input_timing import innovation_variance, innovations_of, turned_timing
from residuum.identification.work import Work, at_most


@dataclass(frozen=True)
class HeldValue:
    """A parameter's value in the model, where it is fixed, and the one that the records ask for, with its standard deviation.

    Of the parameters in `indistinguishable_from` another value would do as much (a mass, or the area that drives it).
    """

    name: str
    held: float
    value: float
    std: float
    unit: str
    indistinguishable_from: tuple[str, ...]


@dataclass(frozen=True)
class Remaining:
    """What a model leaves on unseen blocks: `share` of the power of the model as it was, `times_noise` the largest RMS error
    over its measurement noise, and the block of time `where` (from, to) [s] in which most of it lies.
    """

    share: float
    times_noise: float
    where: tuple[float, float]


@dataclass(frozen=True, eq=False)
class Explanation:
    """The answer.

    Attributes
    ----------
    verdict : str
        `missing-effect`, `adequate` or `unknown-effect`.
    candidates : tuple of Candidate
        The accepted effects first, the verdict's before all; probabilities of one step sum with those of "nothing" and
        "unknown" to at most one.
    probability_none, probability_unknown : float
    unexplained_share : float
        Part of what could be explained that only a free term explains.
    free : FreeTerm or None
        The smooth term that takes away most of the rest.
    undetectable, next_experiment
        What this experiment cannot show, and what would.
    accepted, timing : tuple of Key
        The effects that joined, and shifts in time by less than a sample: how the record was taken.
    drifting : bool
        Whether an unknown load that wanders in time does more than any effect.
    left : mapping of output
        RMS error that the best structure leaves, its unit, and how often that is what its own past cannot predict.
    held : tuple of HeldValue
        Parameters that the model holds fixed, and that the records ask otherwise.
    remaining : Remaining
        What the model with the accepted effects leaves on unseen blocks.
    work : Work
        Samples simulated, fits made, and what was not tried.
    search : Search
        Everything that was tried.
    """

    verdict: str
    candidates: tuple[Candidate, ...]
    probability_none: float
    probability_unknown: float
    unexplained_share: float
    free: FreeTerm | None
    undetectable: tuple[Undetectable, ...]
    next_experiment: tuple[NextExperiment, ...]
    accepted: tuple[Key, ...]
    timing: tuple[Key, ...]
    drifting: bool
    left: Mapping[str, tuple[float, str, float]]
    held: tuple[HeldValue, ...]
    remaining: Remaining
    work: Work
    search: Search
    seconds: float


@one_thread()
def explain(
    model: PhysicalModel,
    records: Sequence[Record],
    mapping: Mapping[str, str] | None = None,
    *,
    effects: Iterable[str] | None = None,
    learned: bool = False,
    seconds: float | None = None,
    tell: Tell = untold,
) -> Explanation:
    """Name the physical effect that is missing in a model.

    Parameters
    ----------
    model : PhysicalModel
        Its free parameters are re-estimated; its structure is what is judged, and whether a fixed value explains more.
    records : sequence of Record
        Each is an experiment with its own initial states.
    mapping : mapping of model name to column
    effects : iterable of effect id
        Consider only these (default: all that fit the model).
    learned : bool
        Consider curves to be learned over one signal, too.
    seconds : float, optional
        Time after which the search is left as well as after its work; the answer then depends on the machine, and says so.
    tell : callable
        Told how far the work is.

    Returns
    -------
    The answer; its verdict is `adequate` only where `compare` finds no structure in what the re-estimated model leaves.

    Raises
    ------
    BadRecord, BadUnit, BadModel
        Columns that do not fit the model, records too short; an effect that is not in the catalogue.
    NotIdentifiable
        The model diverges on a record.

    Notes
    -----
    Fails where a disturbance is synchronous with the input, and where two effects act alike in this experiment (they are then
    named as a group).
    """
    began = time.perf_counter()
    wanted = Wanted(None if effects is None else tuple(effects), learned)
    for id in wanted.effects or ():
        find_effect(id)
    with at_most() as work:
        data = with_forgotten(matched(model, records, mapping), wanted)
        with at_most(MOST_EFFORT, seconds):
            found = at_its_timing(search(data, wanted, tell), wanted, tell)
        tell(0.8, "what is left")
        return _answer(found, wanted, records, mapping, work, began)


def with_forgotten(data: Data, wanted: Wanted) -> Data:
    """The data with those spare columns as idle inputs that what a balance lacks resembles."""
    asked = wanted.effects is None or any(find_effect(id).takes_columns for id in wanted.effects)
    if not asked or not any(e.spare for e in data.experiments):
        return data
    along = followed(climb_at_likelier_timing(data).structure.model, data)
    return data if along is None else data.with_columns(forgotten_columns(data.model, along))


def at_its_timing(found: Search, wanted: Wanted, tell: Tell) -> Search:
    """The search at the other input timing, where what was found fits better there: the timing was chosen without it."""
    court, best = found.court, found.best
    if not best.keys:
        return found
    other = data_of(court.data.model, turned_timing(court.data.experiments))
    rung = other.rung(court.last.windows)
    states = best.structure.states[court.last.windows]
    turned = fitted(best.model, rung.parts, states, court.scale, steps=10, tolerance=1e-4)
    here = innovations_of(np.split(best.errors, court.last.starts[1:-1]))
    if turned is None or innovations_of(turned.residuals) >= here:
        return found
    return search(other, wanted, tell, turn=False)


def _answer(
    found: Search,
    wanted: Wanted,
    records: Sequence[Record],
    mapping: Mapping[str, str] | None,
    work: Work,
    began: float,
) -> Explanation:
    best = found.best
    stds = doubts_of(found)
    adequate = not compare(best.model, records, mapping).present
    free = free_terms(found.base, found.court)
    verdict = verdict_on(found, free, stds, adequate=adequate)
    steps = steps_of(found)
    rest = free_terms(best, found.court) if best.keys else free
    return Explanation(
        verdict=verdict.verdict,
        candidates=verdict.candidates,
        probability_none=verdict.none,
        probability_unknown=verdict.unknown,
        unexplained_share=_unexplained(found, rest),
        free=next(iter(rest), None),
        undetectable=undetectable(found, wanted, found.along),
        next_experiment=next_experiments(found, verdict.candidates),
        accepted=tuple(s.key for s in steps if s.key.effect != HELD and not is_timing(s.key, found)),
        timing=tuple(s.key for s in steps if is_timing(s.key, found)),
        drifting=verdict.unknown > 0.5 and bool(free) and free[0].axis == "time",
        left=_left(found),
        held=tuple(_held(s, found, stds) for s in steps if s.key.effect == HELD),
        remaining=remaining(found),
        work=work,
        search=found,
        seconds=time.perf_counter() - began,
    )


def doubts_of(found: Search) -> dict[str, float]:
    """Standard deviations of the best structure's parameters by full name, in noise of the colour that is left."""
    last, best = found.court.last, found.best
    states = best.structure.states[last.windows]
    estimate = fitted(best.model, last.parts, states, found.court.scale, steps=1, tolerance=1e-3)
    if estimate is None:
        return {}
    std = np.sqrt(np.maximum(np.diag(with_coloured_noise(estimate, last.parts).covariance), 0.0))
    return dict(zip(estimate.parameters, std.tolist(), strict=True))


def _unexplained(found: Search, rest: Sequence[FreeTerm]) -> float:
    """Part of what could be explained that only the best free term explains."""
    if not rest:
        return 0.0
    named = max(found.base.cost - found.best.cost, 0.0)
    more = max(found.best.cost - rest[0].cost, 0.0)
    return more / (more + named) if more > 0.0 else 0.0


def remaining(found: Search) -> Remaining:
    """What the best structure leaves on unseen blocks."""
    data, best = found.court.data, found.best
    Y = np.concatenate([e.Y for e in data.experiments])
    noise = np.nan_to_num(noise_floor(Y))
    times = best.rms[data.measured] / np.where(noise > 0.0, noise, np.nan)[data.measured]
    largest = float(np.nanmax(times)) if np.isfinite(times).any() else float("inf")
    where = int(np.argmax(found.court.scale.by_block(best.power)))
    return Remaining(1.0 - share_of(found.base, best).value, largest, data.times_of(where))


def _left(found: Search) -> dict[str, tuple[float, str, float]]:
    best, parts = found.best, np.split(found.best.errors, found.court.last.starts[1:-1])
    told = {}
    for o, output in enumerate(best.model.outputs.values()):
        if found.court.data.measured[o]:
            errors = [p[:, o] for p in parts]
            rms = float(np.sqrt(np.nanmean(np.concatenate(errors) ** 2)))
            told[output.name] = (rms, output.unit, rms / max(float(np.sqrt(innovation_variance(errors))), 1e-300))
    return told


def _held(step: Step, found: Search, stds: Mapping[str, float]) -> HeldValue:
    name = step.key.target
    before, now = found.court.data.model.parameters[name], found.best.model.parameters[name]
    alike = [k.target for one in step.group for k in one.keys if k.effect == HELD and k.target != name]
    return HeldValue(name, before.value, now.value, float(stds.get(name, 0.0)), now.unit, tuple(dict.fromkeys(alike)))
