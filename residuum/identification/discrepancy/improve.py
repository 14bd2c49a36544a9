"""Improve: add effects to a model, re-estimate it, and count the error on data that were not used for it."""

from __future__ import annotations

import datetime
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice, pairwise, product

import numpy as np
import numpy.typing as npt

from residuum.identification.blas_threads import one_thread
from residuum.identification.discrepancy.compare import compare
from residuum.identification.discrepancy.experiments_to_blame import at_turned_timing
from residuum.identification.discrepancy.explain import Explanation, explain
from residuum.identification.discrepancy.held_out import Split, held_out_rmse, split
from residuum.identification.discrepancy.held_values import freed
from residuum.identification.discrepancy.input_timing import experiments_and_base
from residuum.identification.discrepancy.judgement import Candidate, Quantity
from residuum.identification.discrepancy.prediction_windows import in_windows
from residuum.identification.discrepancy.proposals import uninformed
from residuum.identification.discrepancy.score_test import Screen
from residuum.identification.discrepancy.search import Tell, untold
from residuum.identification.discrepancy.structures import Structure, fit_structure, in_likelier_order
from residuum.identification.errors import BadModel, NotIdentifiable
from residuum.identification.physics import EffectUse, Experiment, PhysicalModel, candidates, estimate, match, with_coloured_noise
from residuum.identification.physics.model import tied_to
from residuum.identification.record import Record

FloatArray = npt.NDArray[np.float64]

_HALF = 0.5
"""Part of the time that `explain` gets; the rest is for estimating what it names."""
_PLAIN_SHIFT = 4.0
"""Standard deviations from zero at which a shift in time must lie to stay in a model."""
_MOST_TOGETHER = 8
"""Choices among effects that cannot be told apart that are tried together at most."""
_RISE, _TIMING, _STRANGE = 1.002, 0.9, 1.25
"""Factors of the held-out error above which an effect is not kept, and a shift in time by less than a sample is not; and times
the error of the rest above which, at any output, something happens there that the rest does not know.
"""
_ERROR_AFTER, _STD = "error_after", "std_"
"""Keys of an effect's provenance: the held-out error with it, and the standard deviation of a parameter."""


@dataclass(frozen=True)
class Step:
    """One line of the history: what was added (None: the model as it was, `-id`: dropped) and the held-out error after it.

    Effects that lower it only `together` share the error that they have together.
    """

    added: str | None
    error: float
    together: bool = False


@dataclass(frozen=True, eq=False)
class Improvement:
    """The improved model with provenance, and how its error on held-out data (`aside`) fell, in `error_unit` of `output`."""

    model: PhysicalModel
    history: tuple[Step, ...]
    verdict: str
    output: str
    error_unit: str
    explanation: Explanation | None
    aside: str

    @property
    def added(self) -> list[EffectUse]:
        """The effects that joined and stayed, estimated on everything; `quantities_of` tells their sizes."""
        ids = [step.added for step in self.history]
        return [use for use in self.model.effects if use.id in ids and _ERROR_AFTER in use.provenance]

    def candidate(self, use: EffectUse) -> Candidate | None:
        """An effect that was added, as `explain` judged it on the rest; None where it was asked for."""
        candidates = () if self.explanation is None else self.explanation.candidates
        return next((c for c in candidates if (c.effect, c.balance) == (use.id, use.target)), None)


@dataclass(frozen=True, eq=False)
class _Attempt:
    """An improvement by one choice of what is kept aside, and whether that shows something that the rest does not: it refused an
    effect, or its error stands far above the rest's.
    """

    improvement: Improvement
    strange: bool


@one_thread()
def improve(
    model: PhysicalModel,
    records: Sequence[Record],
    mapping: Mapping[str, str] | None = None,
    *,
    add: Sequence[str] | None = None,
    effects: Sequence[str] | None = None,
    free: Sequence[str] = (),
    learned: bool = False,
    seconds: float | None = None,
    tell: Tell = untold,
) -> Improvement:
    """Add the effects `add` (id or id@target), or with None those that `explain` accepts, one after the other.

    Parameters are estimated on the training part of the records; an effect proposed by `explain` is kept only while the
    simulation error on the rest does not rise. Where the end of a record refuses an effect, or its error stands far above
    the rest's, the beginning is kept aside instead: the end may show what the rest never did. The returned model is
    re-estimated on everything. Values that the model fixes stay, but for those named in `free`. The verdict is that of `compare`
    on the returned model: `adequate` where its error is not structured.

    Raises
    ------
    BadModel
        An effect that is not in the catalogue, does not fit the model, or fits several places and names none; a name in `free`
        that is no fixed parameter.
    NotIdentifiable
        The model diverges on a record.
    """
    _check_fixed(model, free)
    how = _How(mapping, add, effects, free, learned, None if seconds is None else _HALF * seconds)
    began, parts = time.perf_counter(), split(records)
    found = _improved(model, records, parts, how, tell)
    if add is not None or not found.strange or len(records) > 1 or records[0].split is not None:
        return found.improvement
    again = split(records, end=False)
    spent = time.perf_counter() - began
    if again.aside == parts.aside or (seconds is not None and spent > _HALF * seconds):
        return found.improvement
    later: Tell = lambda share, doing: tell(0.8 + 0.2 * share, doing)  # noqa: E731
    other = _improved(model, records, again, replace(how, seconds=None if seconds is None else seconds - spent), later)
    return found.improvement if other.strange else other.improvement


def _check_fixed(model: PhysicalModel, names: Sequence[str]) -> None:
    fixed = [name for name, p in model.parameters.items() if p.fixed]
    if unknown := [name for name in names if name not in fixed]:
        there = ", ".join(fixed) or "none"
        raise BadModel(f"free {unknown[0]!r}: is no parameter that model {model.name!r} holds fixed; there are {there}")


@dataclass(frozen=True)
class _How:
    """What was asked of `improve`, but for the model, the records and what is kept aside of them."""

    mapping: Mapping[str, str] | None
    add: Sequence[str] | None
    effects: Sequence[str] | None
    free: Sequence[str]
    learned: bool
    seconds: float | None


@dataclass(frozen=True, eq=False)
class _Begun:
    """The training data, the model as it was on them, the base that effects join, what `explain` says, and the effects chosen."""

    experiments: list[Experiment]
    as_it_was: Structure
    base: Structure
    explanation: Explanation | None
    chosen: list[tuple[str, str]]


def _asked_for(model: PhysicalModel, records: Sequence[Record], parts: Split, how: _How, ids: Sequence[str]) -> _Begun:
    """The base, and the effects that the user names."""
    model = _with_columns_of(model, records, ids)
    chosen = [_resolved(model, id) for id in ids]
    experiments, base = experiments_and_base(model, parts.training, how.mapping)
    return _Begun(experiments, base, _with_free(base, how.free, experiments), None, chosen)


def _explained(model: PhysicalModel, parts: Split, how: _How, tell: Tell) -> _Begun:
    """The base on the experiments that `explain` settled on, and the effects that it accepts."""
    found = explain(
        freed(model, how.free),
        parts.training,
        how.mapping,
        effects=how.effects,
        learned=how.learned,
        seconds=how.seconds,
        tell=lambda share, doing: tell(0.1 + 0.5 * share, doing),
    )
    search, experiments = found.search, found.experiments
    initial, chosen = search.base.initial, [*search.accepted, *search.timing]
    if turned := at_turned_timing(search, experiments):
        experiments, initial, chosen = turned[0], turned[1].initial, list(search.accepted)
    started = experiments_and_base(_with_inputs_of(model, search.base.model), parts.training, how.mapping, found.finer)
    model = started[1].model
    as_it_was = fit_structure(model, experiments, initial) or replace(search.base, model=model)
    return _Begun(experiments, as_it_was, _with_free(as_it_was, how.free, experiments), found, chosen)


def _with_inputs_of(model: PhysicalModel, knowing: PhysicalModel) -> PhysicalModel:
    for name, signal in knowing.inputs.items():
        model = model.with_input(name, signal.unit)
    return model


def _with_free(base: Structure, names: Sequence[str], experiments: Sequence[Experiment]) -> Structure:
    return (fit_structure(freed(base.model, names), experiments, base.initial) if names else None) or base


def _improved(model: PhysicalModel, records: Sequence[Record], parts: Split, how: _How, tell: Tell) -> _Attempt:
    tell(0.0, "estimating the model as it is")
    begun = _explained(model, parts, how, tell) if how.add is None else _asked_for(model, records, parts, how, how.add)
    explanation, experiments, finer = begun.explanation, begun.experiments, 1
    if explanation is not None:
        finer = explanation.finer
    judge = _HeldOut(parts, experiments, begun.base, how.mapping, finer)
    history = [Step(None, judge.error(begun.as_it_was))]
    history += [Step(f"{name} freed", judge.error(begun.base)) for name in how.free]
    kept, refused = _all_joined(begun, judge, history, tell)
    strange = refused or bool(np.any(judge.errors(kept) > _STRANGE * kept.rmse))
    tell(0.8, "estimating on everything")
    if how.add is None:
        kept, dropped = _without_needless(kept, experiments, judge, history[-1].error)
        history += dropped
    plain = _least_simulation_error(kept, experiments)
    error = np.inf if plain is None else judge.error(plain)
    simulates_better = error < history[-1].error
    if simulates_better:
        history = [replace(s, error=error) if s.together or s is history[-1] else s for s in history]
    final = _on_everything(kept, records, how.mapping, finer, least_error=simulates_better)
    for use in _vanished(final, history, [] if explanation is None else explanation.search.timing):
        final = replace(final, model=final.model.without_effect(use.label))
        history.append(Step(f"-{use.id}", history[-1].error))
    improved = uninformed(_with_provenance(final, records, history, judge), model)
    fell = history[-1].error < history[0].error
    verdict = ("improved" if fell else "not-improved") if how.add is not None else _verdict(improved, records, how.mapping)
    return _Attempt(Improvement(improved, tuple(history), verdict, judge.output, judge.unit, explanation, parts.aside), strange)


def _all_joined(begun: _Begun, judge: _HeldOut, history: list[Step], tell: Tell) -> tuple[Structure, bool]:
    """The base with the chosen effects that do not raise the held-out error, and whether one was refused (shifts apart)."""
    explanation, experiments, chosen = begun.explanation, begun.experiments, begun.chosen
    kept, waiting, tried = begun.base, chosen, len(chosen) + 1
    before = list(history)
    while len(waiting) < tried:  # what does not help alone may help beside what joined after it
        tried = len(waiting)
        kept, waiting = _joined(kept, waiting, experiments, judge, history, explanation, tell)
    shifts = [] if explanation is None else explanation.search.timing
    refused = any(key not in shifts for key in waiting)
    if explanation is not None and refused and len(chosen) > 1:
        together, steps = _joined_together(begun.base, chosen, experiments, judge, history[-1].error, explanation)
        if together is not None:
            history[:] = [*before, *steps]
            return together, False
    return kept, refused


def added(
    structure: Structure, experiments: Sequence[Experiment], key: tuple[str, str], seen: Mapping[str, float] | None = None
) -> Structure | None:
    """The structure with one more effect, re-estimated; None when it diverges.

    The likelihood of a contact or of friction has many tops: every start of the effect that promises something is followed, and
    the values `seen` (by full name) where it was estimated before; the likeliest end is kept.
    """
    starts = [screened.start for screened in Screen(structure, experiments).promising(*key)]
    if seen:
        model = structure.model.with_effect(*key)
        starts.append(model.with_values({n: v for n, v in seen.items() if n in model.free}))
    fitted = [fit_structure(start, experiments, structure.initial) for start in starts]
    best = max((found for found in fitted if found is not None), key=lambda found: found.log_likelihood, default=None)
    return best if best is None else in_likelier_order(best, key, experiments)


def _joined(
    kept: Structure,
    chosen: Sequence[tuple[str, str]],
    experiments: Sequence[Experiment],
    judge: _HeldOut,
    history: list[Step],
    explanation: Explanation | None,
    tell: Tell,
) -> tuple[Structure, list[tuple[str, str]]]:
    """The structure with those effects that do not raise the held-out error, each told in the history; and those that did.

    In the place of one that does, those are tried that the training data cannot tell from it: data kept aside may.
    """
    refused = []
    for index, key in enumerate(chosen):
        tell(0.6 + 0.2 * index / len(chosen), f"adding {key[0]} to {key[1]}")
        if explanation is None:
            better = added(kept, experiments, key)
            if better is None:
                raise NotIdentifiable(f"effect {key[0]!r} at {key[1]!r}: the model diverges with it")
            kept = better
            history.append(Step(key[0], judge.error(better)))
            continue
        found, highest = explanation.search, history[-1].error * (_TIMING if key in explanation.search.timing else _RISE)
        for each in found.alike(key):
            better = added(kept, experiments, each, found.values_of(each))
            if better is not None and explanation.by_share:  # no structure is exact: the likelihood of samples is no judge
                better = _least_simulation_error(better, experiments) or better
            error = judge.error(better) if better is not None else np.inf
            if better is not None and error <= highest:
                kept = better
                history.append(Step(each[0], error))
                break
        else:
            refused.append(key)
    return kept, refused


def _joined_together(
    base: Structure,
    chosen: Sequence[tuple[str, str]],
    experiments: Sequence[Experiment],
    judge: _HeldOut,
    error: float,
    explanation: Explanation,
) -> tuple[Structure | None, list[Step]]:
    """The base with all the effects at once, of which some raise the held-out `error` alone, if they do not together; and how.

    A drag without the rolling friction beside it is a better model of a van under way, and a worse one of a van that coasts.
    Where the training data cannot tell an effect from others, those kept aside may.
    """
    found = explanation.search
    for keys in islice(product(*(found.alike(key) for key in chosen)), _MOST_TOGETHER):
        all_: Structure | None = base
        for key in keys:
            all_ = None if all_ is None else added(all_, experiments, key, found.values_of(key))
        left = np.inf if all_ is None else judge.error(all_)
        if all_ is not None and left <= error * _RISE:
            return all_, [Step(id, left, together=True) for id, _ in keys]
    return None, []


def _verdict(improved: PhysicalModel, records: Sequence[Record], mapping: Mapping[str, str] | None) -> str:
    """That of `compare` on the model as it will be written: `adequate`, or what is left has no name."""
    return "unknown-effect" if compare(improved, records, mapping).present else "adequate"


def _with_columns_of(model: PhysicalModel, records: Sequence[Record], ids: Sequence[str]) -> PhysicalModel:
    """The model with those columns of the records among its inputs that a forgotten input is to be tied to."""
    for name in [n for id in ids for n in tied_to(id) if id.startswith("forgotten-input")]:
        if name not in model.inputs and all(name in record.names for record in records):
            model = model.with_input(name, records[0].units.get(name, ""))
    return model


def _resolved(model: PhysicalModel, id: str) -> tuple[str, str]:
    name, _, target = id.replace(":", "@", 1).partition("@")
    fitting = [t for _, t in candidates(model, [name])]
    if target:
        model.with_effect(name, target)
        return name, target
    if not fitting:
        raise BadModel(f"effect {name!r}: fits no balance, input or output of model {model.name!r}, or is in it already")
    if len(fitting) > 1:
        raise BadModel(f"effect {name!r}: fits {', '.join(fitting)}; say which, as {name}@{fitting[0]}")
    return name, fitting[0]


class _HeldOut:
    """Simulation error on the data that were kept aside, on one output: the one whose error stands highest above its noise."""

    def __init__(
        self,
        parts: Split,
        experiments: Sequence[Experiment],
        base: Structure,
        mapping: Mapping[str, str] | None,
        finer: int,
    ) -> None:
        self.testing = _reduced(base.model, parts.testing, mapping, experiments, finer)
        noise = [np.nan if n is None else np.sqrt(n.innovation_variance) for n in base.noises]
        self.o = int(np.nanargmax(base.rmse / np.array(noise)))
        self.output = list(base.model.outputs)[self.o]
        self.unit = base.model.outputs[self.output].unit

    def error(self, structure: Structure) -> float:
        """RMS over the held-out samples; their records' first states come from what precedes them, or from themselves."""
        return float(self.errors(structure)[self.o])

    def errors(self, structure: Structure) -> FloatArray:
        """The same of every output; NaN where one is never measured."""
        return held_out_rmse(structure, self.testing)


def _reduced(
    model: PhysicalModel,
    testing: Sequence[tuple[Record, int]],
    mapping: Mapping[str, str] | None,
    like: Sequence[Experiment],
    finer: int,
) -> list[tuple[Experiment, int]]:
    """Held-out records with the training experiments' input timing, blocks and windows, and their first held-out sample."""
    model, experiments = match(model, [record for record, _ in testing], mapping)
    found = []
    for e, (_, first) in zip(experiments, testing, strict=True):
        timed = replace(e, hold=like[0].hold, block=like[0].block)
        parts = in_windows(model, [timed], finer)
        later = [(part, 0) for part in parts if round((part.t0 - timed.t0) / timed.sample_time) >= first]
        found += [(timed, first)] if len(parts) == 1 else later
    return found


def _without_needless(
    structure: Structure, experiments: Sequence[Experiment], judge: _HeldOut, error: float
) -> tuple[Structure, list[Step]]:
    """Drop effects whose absence the Schwarz criterion prefers and the held-out error does not mind."""
    dropped: list[Step] = []
    for use in structure.model.effects:
        if len(structure.model.effects) < 2:
            break
        less = fit_structure(structure.model.without_effect(use.label), experiments, structure.initial)
        if less is None or structure.log_likelihood - structure.penalty(less) > less.log_likelihood:
            continue
        without = judge.error(less)
        if without <= error * _RISE:
            structure, error = less, without
            dropped.append(Step(f"-{use.id}", without))
    return structure, dropped


def _least_simulation_error(structure: Structure, experiments: Sequence[Experiment]) -> Structure | None:
    """The structure at the least plain simulation error: of a model that is never complete it is the better simulator."""
    try:
        plain = with_coloured_noise(
            estimate(structure.model, experiments, free=structure.parameters, initial=structure.initial), experiments
        )
    except NotIdentifiable:
        return None
    return replace(structure, model=plain.model, initial=plain.initial, std=np.sqrt(np.diag(plain.covariance)))


def _on_everything(
    kept: Structure, records: Sequence[Record], mapping: Mapping[str, str] | None, finer: int, *, least_error: bool
) -> Structure:
    """The structure re-estimated on all records, at the likeliest innovations or at the least simulation error."""
    try:
        experiments, result = experiments_and_base(kept.model, records, mapping, finer)
    except NotIdentifiable:  # with the values of the training part it diverges on the rest
        return kept
    likelier = fit_structure(kept.model, experiments, result.initial)
    if likelier is not None and likelier.log_likelihood > result.log_likelihood:
        result = likelier
    return (_least_simulation_error(result, experiments) if least_error else None) or result


def _vanished(final: Structure, history: Sequence[Step], shifts: Sequence[tuple[str, str]]) -> list[EffectUse]:
    """Effects that were added and have no size left: at zero, or of the `shifts` in time those that cannot be told from it.

    Once all is estimated at the likelier input timing, what was a delay of half a sample may be some microseconds.
    """
    values, std = final.model.values, dict(zip(final.parameters, final.std, strict=True))

    def gone(use: EffectUse, name: str) -> bool:
        label = f"{use.label}.{name}"
        doubt = std.get(label, 0.0) if (use.id, use.target) in shifts else 0.0
        return abs(values.get(label, 0.0)) <= _PLAIN_SHIFT * np.nan_to_num(doubt, posinf=0.0)

    joined = [use for use in final.model.effects if use.effect.sizes and any(step.added == use.id for step in history)]
    return [use for use in joined if all(gone(use, name) for name in use.effect.sizes)]


def _with_provenance(final: Structure, records: Sequence[Record], history: Sequence[Step], judge: _HeldOut) -> PhysicalModel:
    """Each effect with its records, date, held-out error before and after, and the standard deviation of its parameters."""
    model = final.model
    std = dict(zip(final.parameters, final.std, strict=True))
    for before, after in pairwise(history):
        use = next((u for u in model.effects if u.id == after.added), None)
        if use is None:
            continue
        note = {
            "records": ", ".join(record.source for record in records),
            "date": datetime.datetime.now(datetime.UTC).date().isoformat(),
            "output": judge.output,
            "error_before": before.error,
            _ERROR_AFTER: after.error,
            "error_unit": judge.unit,
        }
        note |= {_STD + n: float(s) for n in use.parameters if np.isfinite(s := std.get(f"{use.label}.{n}", np.nan))}
        model = model.with_provenance(use.label, note)
    return model


def quantities_of(use: EffectUse) -> dict[str, Quantity]:
    """The parameters of an effect that was added, with their standard deviations: 0 where held, infinite where undetermined."""
    doubts = {n: 0.0 if p.fixed else float(use.provenance.get(_STD + n, np.inf)) for n, p in use.parameters.items()}
    return {n: Quantity(p.value, doubts[n], p.unit) for n, p in use.parameters.items()}
