"""Explain: which physical effect is missing in a model? What is answered, and how the answer is
made of what a search tried.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from residuum.identification.blas_threads import one_thread
from residuum.identification.discrepancy.policy import OTHER_VALUE
from residuum.identification.errors import BadRecord, NotIdentifiable
from residuum.identification.physics import Key, PhysicalModel
from residuum.identification.record import Record
from residuum.identification.residual_analysis.compare import compare
from residuum.identification.residual_analysis.feedback import innovation_variance
from residuum.identification.residual_analysis.policy import SLOW
from residuum.identification.unseen_blocks.advice import (
    NextExperiment,
    Undetectable,
    next_experiments,
    undetectable,
)
from residuum.identification.unseen_blocks.free_term import BlockTerm, free_terms
from residuum.identification.unseen_blocks.policy import FEWEST_TO_JUDGE, UNKNOWN_LEADS
from residuum.identification.unseen_blocks.record_search import searched, with_forgotten_inputs
from residuum.identification.unseen_blocks.structure import HELD, HeldValue
from residuum.identification.unseen_blocks.tried import Search, Wanted
from residuum.identification.unseen_blocks.verdict import (
    BlockErrors,
    Candidate,
    Remaining,
    Step,
    block_errors,
    is_timing,
    remaining,
    steps_of,
    verdict_on,
)
from residuum.identification.work import Tell, Work, at_most, begun, part_of, untold

# What is answered.


@dataclass(frozen=True)
class EstimatedValue:
    """A free parameter of the model: its value in the file, and as estimated, with the standard
    deviation.
    """

    name: str
    file: float
    value: float
    std: float
    unit: str

    @property
    def differs(self) -> bool:
        """Whether the records plainly contradict the file's value."""
        return abs(self.value - self.file) > OTHER_VALUE * self.std


@dataclass(frozen=True, eq=False)
class Explanation:
    """The answer.

    Attributes
    ----------
    verdict : str
        `missing-effect`, `adequate` or `unknown-effect`.
    candidates : tuple of Candidate
        The accepted effects first, the verdict's before all; probabilities of one step sum with
        those of "nothing" and "unknown" to at most one.
    probability_none, probability_unknown : float
    unexplained_share : float
        Part of what could be explained that no candidate explains.
    free : BlockTerm or None
        The smooth term that best explains the rest.
    undetectable, next_experiment
        What this experiment cannot show, and what would.
    accepted, timing : tuple of Key
        The effects that joined, and shifts in time by less than a sample: how the record was taken.
    drifting : bool
        Whether an unknown load or offset that drifts is taken to be there, whatever else is.
    left : mapping of output
        What the model with the accepted effects leaves of each measured output: RMS error, its
        unit, and how often that is what its own past cannot predict (`SLOW` and more: something
        slow is missing, or drifts).
    values : tuple of EstimatedValue
        The model's own free parameters, estimated with the accepted effects, beside the file's.
    held : tuple of HeldValue
        Parameters that the model holds fixed, where another value does more than any effect, or as
        much as one that was found.
    remaining : Remaining
        What that model leaves on unseen blocks.
    blocks : BlockErrors
        Errors block by block before and after, and with each candidate alone.
    work : Work
        Samples simulated, fits made, and what was not tried, since the work or the user's seconds
        were over.
    found : Search
        What was tried.
    """

    verdict: str
    candidates: tuple[Candidate, ...]
    probability_none: float
    probability_unknown: float
    unexplained_share: float
    free: BlockTerm | None
    undetectable: tuple[Undetectable, ...]
    next_experiment: tuple[NextExperiment, ...]
    accepted: tuple[Key, ...]
    timing: tuple[Key, ...]
    drifting: bool
    left: Mapping[str, tuple[float, str, float]]
    values: tuple[EstimatedValue, ...]
    held: tuple[HeldValue, ...]
    remaining: Remaining
    blocks: BlockErrors
    work: Work
    seconds: float
    found: Search

    @property
    def by_share(self) -> bool:
        """Whether effects were named by the share that they take away: what they leave is more than
        its own noise.
        """
        return not self.found.validation.scale.nats


# The question.


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
        Its free parameters are re-estimated; its structure is what is judged, and whether a fixed
        value explains more.
    records : sequence of Record
        Each is an experiment with its own initial states.
    mapping : mapping of model name to column
    effects : iterable of effect id
        Consider only these (default: all that fit the model).
    learned : bool
        Consider curves to be learned over one signal, too.
    seconds : float, optional
        Time after which the search is left as well as after its work; the answer then depends on
        the machine, and says so.
    tell : callable
        Told how far the work is.

    Returns
    -------
    The answer; its verdict is `adequate` only where `compare` finds no structure in what the
    re-estimated model leaves.

    Raises
    ------
    BadRecord, BadUnit, BadModel
        Columns that do not fit the model; fewer than 40 samples in all; an effect that is not in
        the catalogue.
    NotIdentifiable
        The model diverges on a record.

    Notes
    -----
    Effects are named by what they take away on blocks of the records that no fit has seen: in power
    while what is left is not its own noise, in the likelihood of that noise from there on.

    Fails where a disturbance is synchronous with the input, and where two effects act alike in this
    experiment (they are then named as a group).
    """
    check_length(records)
    return explained(
        model,
        records,
        mapping,
        Wanted(None if effects is None else tuple(effects), learned),
        seconds,
        tell,
    )


def check_length(records: Sequence[Record]) -> None:
    """BadRecord where the records are so short together that an effect may follow every sample."""
    samples = sum(record.n for record in records)
    if samples < FEWEST_TO_JUDGE:
        names = ", ".join(repr(record.source) for record in records)
        raise BadRecord(
            f"record {names}: {samples} samples; at least {FEWEST_TO_JUDGE} are needed to tell what"
            " is missing from noise: record longer or faster, or give several records"
        )


def explained(
    model: PhysicalModel,
    records: Sequence[Record],
    mapping: Mapping[str, str] | None,
    wanted: Wanted,
    seconds: float | None,
    tell: Tell,
) -> Explanation:
    """The answer by what takes away most on unseen blocks of the records."""
    with at_most():
        began = time.perf_counter()
        # a forgotten input is added before anything is searched: its effect needs it in the model
        model = with_forgotten_inputs(model, records, mapping, wanted)
        left = None if seconds is None else seconds - (time.perf_counter() - began)
        search = searched(
            model, records, mapping, wanted, seconds=left, tell=part_of(tell, 0.0, 0.9)
        )
        tell(0.9, "drawing what no effect explains")
        return answer_on_blocks(search, wanted, records, mapping, began)


# The answer, made of what a search tried.


def answer_on_blocks(
    search: Search,
    wanted: Wanted,
    records: Sequence[Record],
    mapping: Mapping[str, str] | None,
    began: float,
) -> Explanation:
    """The answer by errors on unseen blocks."""
    best, steps = search.best, steps_of(search)
    stds = search.validation.doubts(best.structure)
    # beside the model as it is: what any smooth term would do is the measure of what names do
    free = free_terms(search.base, search.validation)
    left = _left(search)
    # few answers to few steps look like a walk at random, which passes for noise in `compare`
    slow = any(times > SLOW for _, _, times in left.values())
    adequate = not slow and not leaves_something(best.model, records, mapping)
    verdict = verdict_on(search, steps, free, stds, adequate=adequate)
    free_beside = free_terms(best, search.validation) if best.keys else free
    timing = [step.key for step in steps if is_timing(step.key, search)]
    held = [_held(step, search, stds) for step in steps]
    accepted = [step.key for step in steps if step.key.effect != HELD and step.key not in timing]
    return Explanation(
        verdict=verdict.verdict,
        candidates=verdict.candidates,
        probability_none=verdict.none,
        probability_unknown=verdict.unknown,
        unexplained_share=_unexplained(search, free_beside),
        free=next(iter(free_beside), None),
        undetectable=undetectable(search, wanted, search.along, _named_by(steps)),
        next_experiment=next_experiments(search, verdict.candidates),
        accepted=tuple(accepted),
        timing=tuple(timing),
        drifting=verdict.unknown > UNKNOWN_LEADS and _drifts(free),
        left=left,
        values=estimated_values(search.validation.data.model, best.model, stds),
        held=tuple(value for value in held if value is not None),
        remaining=remaining(search.base, best, search.validation),
        blocks=block_errors(search, verdict.candidates),
        work=begun(),
        seconds=time.perf_counter() - began,
        found=search,
    )


def _drifts(free: Sequence[BlockTerm]) -> bool:
    """Whether the best free term is a function of time: a load that drifts."""
    return bool(free) and free[0].axis == "time"


def _named_by(steps: Sequence[Step]) -> set[Key]:
    """The effects that joined, and what does the same in their place."""
    fits = [fit for step in steps for fit in (step.after, *step.group)]
    return {key for fit in fits for key in fit.keys}


def leaves_something(
    model: PhysicalModel, records: Sequence[Record], mapping: Mapping[str, str] | None
) -> bool:
    """Whether `compare` finds structure in what a model that was found leaves; as where it diverges
    from the measured states, since only the first states that the search found follow the records.
    """
    try:
        return compare(model, records, mapping, refuse_unstable=False).present
    except NotIdentifiable:
        return True


def _unexplained(search: Search, terms: Sequence[BlockTerm]) -> float:
    """Part of what could be explained that only the best free term explains."""
    if not terms:
        return 0.0
    named = max(search.base.cost - search.best.cost, 0.0)
    more = max(search.best.cost - terms[0].cost, 0.0)
    return more / (more + named) if more > 0.0 else 0.0


def _left(search: Search) -> dict[str, tuple[float, str, float]]:
    """What the best structure leaves of each measured output; see `Explanation.left`."""
    best, parts = search.best, np.split(search.best.errors, search.validation.last.starts[1:-1])
    left = {}
    for o, output in enumerate(best.model.outputs.values()):
        if search.validation.data.measured[o]:
            errors = [part[:, o] for part in parts]
            rms = float(np.sqrt(np.nanmean(np.concatenate(errors) ** 2)))
            innovations = float(np.sqrt(innovation_variance(errors)))
            # A model that meets its record exactly leaves no innovations to be held against.
            left[output.name] = (rms, output.unit, rms / max(innovations, 1e-300))
    return left


def _held(step: Step, search: Search, stds: Mapping[str, float]) -> HeldValue | None:
    """The fixed value that is doubted at a step, of several that do as much the first of the
    model; None where nothing but effects explains what the step does.
    """
    model, is_value = search.validation.data.model, step.key.effect == HELD
    tied = {step.key.target: search} if is_value else {}
    for rival in step.group:
        for key in rival.keys:
            if key.effect == HELD and key not in search.best.keys:
                tied[key.target] = replace(search, best=rival)
    if not tied:
        return None
    # which of them led is chance: the first of the model is the same for every record
    first, *alike = sorted(tied, key=list(model.parameters).index)
    asking = tied[first]
    doubt = stds if asking is search else search.validation.doubts(asking.best.structure)
    before, now = model.parameters[first], asking.best.model.parameters[first]
    return HeldValue(
        first,
        before.value,
        now.value,
        doubt.get(first, np.inf),
        now.unit,
        tuple(alike),
        () if is_value else (str(step.key),),
    )


def estimated_values(
    model: PhysicalModel, best: PhysicalModel, stds: Mapping[str, float]
) -> tuple[EstimatedValue, ...]:
    """Free parameters of `model` in the structure that was found best.

    Where they explain the error without any effect, the machine or the file has changed, and no
    physics is missing.
    """
    values = best.values
    return tuple(
        EstimatedValue(
            name, model.values[name], values[name], stds[name], model.all_parameters[name].unit
        )
        for name in model.free
        if name in values and name in stds
    )
