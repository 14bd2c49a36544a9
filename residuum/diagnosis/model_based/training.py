"""Training: healthy records and a model → a baseline.

The model's values over all windows together, fitted over ever longer horizons; the model mended
by what every window lacks; then each window's own estimate, whose mean and scatter carry all that
is inexact.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import stats

from residuum.array_types import FloatArray
from residuum.diagnosis.model_based.assessment import NotAssessable, estimated_window
from residuum.diagnosis.model_based.baseline import Baseline, KindOfRun, Usual, own_estimate
from residuum.diagnosis.model_based.hypotheses import UNKNOWN_LOAD, Hypothesis, try_hypotheses
from residuum.diagnosis.model_based.policy import (
    ALWAYS,
    APART,
    CALIBRATED,
    CUT_INTO,
    FEWEST_IN_A_WINDOW,
    FEWEST_WINDOWS,
    LEARNED_FALSELY,
    NO_ERROR,
    OPEN,
    SEARCH,
    SEARCHED,
)
from residuum.diagnosis.model_based.variant import Variant
from residuum.diagnosis.model_based.window_fit import (
    Fit,
    Scatter,
    Whitening,
    WindowFitter,
    information,
    log_power,
)
from residuum.identification.blas_threads import one_thread
from residuum.identification.errors import BadInput, BadRecord, NotIdentifiable, said
from residuum.identification.physics import (
    EffectUse,
    Estimate,
    Experiment,
    Key,
    PhysicalModel,
    estimate,
    match,
)
from residuum.identification.physics.effects.base import Parameter
from residuum.identification.record import Record
from residuum.identification.residual_analysis.feedback import at_likelier_timing, turned_timing
from residuum.identification.unseen_blocks.data import data_of
from residuum.identification.unseen_blocks.multiple_shooting import (
    first_fit,
    first_fit_at_likelier_timing,
)
from residuum.identification.unseen_blocks.policy import TIE
from residuum.identification.unseen_blocks.search import search
from residuum.identification.unseen_blocks.structure import HeldValue, freed
from residuum.identification.unseen_blocks.tried import Search, Wanted
from residuum.identification.unseen_blocks.verdict import is_timing
from residuum.identification.work import at_most
from residuum.nearest_names import known_names

# Missing physics of a watched machine: what its model lacks in healthy windows, each at values of
# its own.
# Over all windows together the scatter of values hides it. So it is sought in single windows by
# the judge of missing physics, and kept where it takes error away in the others as well.


@dataclass(frozen=True, eq=False)
class _FittedToWindows:
    """A model, how its inputs move between samples, and its fit to each window at the window's own
    values.
    """

    model: PhysicalModel
    windows: Sequence[Experiment]
    fits: Sequence[Fit | None]

    @property
    def log_errors(self) -> FloatArray:
        """Mean over the outputs of the logarithm of the RMS error in each window, in the model's
        over all of them; infinite where it diverges.

        An error a thousand times smaller is none: in a window in which nothing moves any error can
        be taken away.
        """
        measured = self.windows[0].measured
        power = [None if f is None else f.power.mean(axis=0) for f in self.fits]
        return np.array(
            [
                np.inf if p is None else 0.5 * np.mean(np.log(p + NO_ERROR**2), where=measured)
                for p in power
            ]
        )

    @property
    def information(self) -> FloatArray:
        """What each window tells of the values, shape (windows, values, values): 0 where the model
        diverges.
        """
        count = len(self.model.free)
        return np.array(
            [np.zeros((count, count)) if f is None else information(f, count) for f in self.fits]
        )


def with_missing_physics(
    model: PhysicalModel, windows: Sequence[Experiment], whitening: Whitening
) -> tuple[PhysicalModel, list[Experiment], list[HeldValue]]:
    """The model with what healthy windows lack beside it, the windows at the input timing that
    suits it, and the value held that does as much as what is lacking. The first two stay as they are
    where nothing is lacking in all windows.

    Values of new effects that the windows leave open are held.
    """
    # Sought in the window that tells the most of the values, then held against a few of them all.
    few = [windows[k] for k in evenly(len(windows), CALIBRATED)]
    base = _fitted(model, few, whitening)
    searched = np.argsort(-_information_by_window(base), kind="stable")[:SEARCHED]
    candidates = _candidates(_with_library_held(model), few, searched.tolist())
    if model.foreign is not None:
        candidates = [(replace(m, parameters=model.parameters), e) for m, e in candidates]
    chosen = _simplest_better(base, [_fitted(*trial, whitening) for trial in candidates])
    if chosen is None:
        return model, list(windows), []
    timed = [replace(e, hold=chosen.windows[0].hold) for e in windows]
    return _settled(chosen, model), timed, _held_that_do_as_much(model, chosen, whitening)


def _simplest_better(
    base: _FittedToWindows, fits: Sequence[_FittedToWindows]
) -> _FittedToWindows | None:
    """Of the fits that take error away in all windows, and of those that take away as much as the
    best, the one with the fewest values; None where none does.
    """
    errors = [trial.log_errors for trial in fits]
    better = [k for k, error in enumerate(errors) if _is_reduced(base.log_errors - error)]
    if not better:
        return None
    best = min(better, key=lambda k: float(errors[k].mean()))
    # as much: to one standard error
    alike = [k for k in better if k == best or not _is_reduced(errors[k] - errors[best], 1.0)]
    return fits[min(alike, key=lambda k: (len(fits[k].model.free), float(errors[k].mean())))]


def _held_that_do_as_much(
    model: PhysicalModel, found: _FittedToWindows, whitening: Whitening
) -> list[HeldValue]:
    """The value that the model holds which, free in the windows, takes away as much of their error
    as the effects that were found, to one standard error; none where none does.
    """
    effects = _labels_beyond(model, found.model)
    trials = [
        (name, _fitted(freeing, found.windows, whitening))
        for name, freeing in _with_one_free(model, found.windows)
    ]
    errors = {name: trial.log_errors for name, trial in trials}
    finite = [name for name in errors if np.isfinite(errors[name]).all()]
    if not finite:
        return []
    least = errors[min(finite, key=lambda name: float(errors[name].mean()))]
    if _is_reduced(least - found.log_errors - NO_ERROR, 1.0):
        return []
    # of what does the same the first of the model, as `explain` tells it
    (name, trial), *more = [
        (name, trial)
        for name, trial in trials
        if not _is_reduced(errors[name] - least - NO_ERROR, 1.0)
    ]
    values, std = _over_windows(trial)
    k, known = trial.model.free.index(name), trial.model.parameters[name]
    alike = tuple(other for other, _ in more)
    return [
        HeldValue(name, known.value, float(values[k]), float(std[k]), known.unit, alike, effects)
    ]


def _with_one_free(
    model: PhysicalModel, windows: Sequence[Experiment]
) -> Iterator[tuple[str, PhysicalModel]]:
    """The model with each of the values that it holds free in turn; those of an FMU that nobody
    named are held, too.
    """
    if model.foreign is None:
        for name, known in model.parameters.items():
            if known.fixed and known.value != 0.0:
                yield name, freed(model, [name])
        return
    # loads what compiles, for FMUs alone
    from residuum.identification.physics.fmu.watched_model import declaring  # noqa: PLC0415

    for name, offered in model.foreign.description.parameters.items():
        if offered.start != 0.0 and name not in model.free:
            freeing = freed(declaring(model, [name]), [name])
            assert freeing.foreign is not None
            freeing.foreign.choose_steps(freeing, windows[:1])
            yield name, freeing


def _with_library_held(model: PhysicalModel) -> PhysicalModel:
    """The model with the parameters of its library set and no longer free: passes that a search
    compiles call the library as it is.
    """
    if model.foreign is None:
        return model
    model.foreign.settle({name: p.value for name, p in model.parameters.items()})
    return held(model, list(model.parameters))


def following(model: PhysicalModel, names: Sequence[str]) -> PhysicalModel:
    """The model with these values free, by full name, and all others held."""
    known = model.all_parameters
    if unknown := [name for name in names if name not in known]:
        raise BadInput(
            repr(unknown[0]),
            "free",
            f"the model has no parameter of this name; {known_names(unknown[0], known)}",
        )
    return _with_fixed(model, lambda name, _held: name not in names)


def held(model: PhysicalModel, names: Sequence[str]) -> PhysicalModel:
    """The model with these values, by full name, no longer free."""
    return _with_fixed(model, lambda name, held: held or name in names)


def _with_fixed(model: PhysicalModel, fixed: Callable[[str, bool], bool]) -> PhysicalModel:
    """The model with the values held of which `fixed` says so, given the full name of each and
    whether it is held.
    """

    def settled(parameters: Mapping[str, Parameter], prefix: str = "") -> dict[str, Parameter]:
        return {
            name: replace(p, fixed=fixed(prefix + name, p.fixed)) for name, p in parameters.items()
        }

    effects = tuple(
        replace(use, parameters=settled(use.parameters, f"{use.label}.")) for use in model.effects
    )
    return replace(model, parameters=settled(model.parameters), effects=effects)


def evenly(windows: int, count: int) -> list[int]:
    """So many windows, evenly over all of them, the first and the last left out."""
    return np.unique(np.linspace(0, windows - 1, count + 2)[1:-1].round().astype(int)).tolist()


def _information_by_window(base: _FittedToWindows) -> FloatArray:
    """How much each window tells of the values, shape (windows,): the geometric mean of the
    information on each of them.
    """
    precision = np.nan_to_num(np.diagonal(base.information, axis1=1, axis2=2))
    return np.asarray(
        np.log(np.maximum(precision, 1e-12 * precision.max(axis=0, initial=0.0)) + 1e-300).sum(
            axis=1
        )
    )


def _candidates(
    model: PhysicalModel, windows: Sequence[Experiment], searched: Sequence[int]
) -> list[tuple[PhysicalModel, Sequence[Experiment]]]:
    """The model with what one of the windows that are searched lacks, at either input timing of all
    windows.
    """
    by_effects: dict[tuple[Key, ...], list[tuple[PhysicalModel, Sequence[Experiment]]]] = {}
    for k in searched:
        try:
            with at_most(SEARCH):
                outcome = search(data_of(model, [windows[k]]), Wanted(held=False))
        except (BadRecord, NotIdentifiable):
            continue
        physics = _physics(outcome)
        keys = tuple(use.key for use in physics.effects)
        if len(keys) > len(model.effects) and keys not in by_effects:
            by_effects[keys] = [(physics, windows), (physics, turned_timing(windows))]
    return [candidate for both in by_effects.values() for candidate in both]


def _physics(outcome: Search) -> PhysicalModel:
    """The best model without shifts in time by less than a sample: those are how records were
    taken.
    """
    model = outcome.best.model
    for use in outcome.best.model.effects:
        if use.key in outcome.best.keys and is_timing(use.key, outcome):
            model = model.without_effect(use.label)
    return model


def _fitted(
    model: PhysicalModel, windows: Sequence[Experiment], whitening: Whitening
) -> _FittedToWindows:
    start = np.array([model.values[name] for name in model.free])
    return _FittedToWindows(
        model, windows, [own_estimate(model, window, start, whitening) for window in windows]
    )


def _settled(best: _FittedToWindows, before: PhysicalModel) -> PhysicalModel:
    """The model at the middle of the windows' values. Of new effects those values are held that are
    shapes, or that all windows together leave open.
    """
    names = list(best.model.free)
    values, std = _over_windows(best)
    # infinite where no window tells a value at all
    fixed = std < OPEN * np.abs(values)
    shapes = {
        f"{use.label}.{p}"
        for use in best.model.effects
        if use.effect.sizes
        for p in use.parameters
        if p not in use.effect.sizes
    }
    new = [
        name
        for name, known in zip(names, fixed, strict=True)
        if name not in before.free and (name in shapes or not known)
    ]
    return held(best.model.with_values(dict(zip(names, values.tolist(), strict=True))), new)


def _over_windows(best: _FittedToWindows) -> tuple[FloatArray, FloatArray]:
    """The median of the windows' values, weighed by each window's information, and the standard
    deviation of what all windows together leave open of each.
    """
    known = [fit is not None for fit in best.fits]
    window_info = best.information[known]
    values = _middle(
        np.array([fit.values for fit in best.fits if fit is not None]),
        np.diagonal(window_info, axis1=1, axis2=2),
    )
    total = window_info.sum(axis=0)
    std = np.sqrt(np.diag(np.linalg.pinv(total, hermitian=True)))
    return values, np.where(np.diag(total) > 0.0, std, np.inf)


def _middle(values: FloatArray, weights: FloatArray) -> FloatArray:
    """The weighted median over the rows."""
    order = np.argsort(values, axis=0, kind="stable")
    below = np.cumsum(np.take_along_axis(weights + 1e-300, order, axis=0), axis=0)
    at = np.argmax(below >= 0.5 * below[-1], axis=0)
    return np.asarray(
        np.take_along_axis(values, np.take_along_axis(order, at[None], axis=0), axis=0)[0]
    )


def _is_reduced(gain: FloatArray, times: float = ALWAYS) -> bool:
    """Whether the error falls in windows by more than so many standard errors."""
    return bool(
        np.isfinite(gain).all() and gain.mean() > times * gain.std(ddof=1) / np.sqrt(len(gain))
    )


# Whether windows may be used to learn a baseline anew: never where a sensor's fault or a new
# effect is probable in them.
# A fault too small for the limit of one window is judged healthy again and again; learned from,
# it would become the new normal. So the windows are held together against those of the training:
# for each hypothesis the mean of its sizes in both (Welch's test, Bonferroni over hypotheses). A
# value that has changed may become the new normal: where a value tells the windows as well as a
# fault does, they are learned from.

_FEWEST = 2


class NothingLearned(BadInput):
    """A baseline is not learned anew from these windows; the message says why."""


@one_thread()
def refuse_recalibration(
    baseline: Baseline, records: Sequence[Record], accepted: Sequence[Key] = ()
) -> None:
    """Raise NothingLearned where a sensor's fault, an actuator's, a load or a new effect is
    probable in the windows.

    An effect that the user has `accepted` is none of them.
    """
    gains, sizes = _gains_and_sizes(baseline, records)
    if max(map(len, sizes.values()), default=0) < _FEWEST:
        return
    p = _chances(baseline, sizes)
    # Bonferroni: so many hypotheses have as many chances to look shifted
    shifted = [h for h in baseline.hypotheses if p[h.label] * len(p) < LEARNED_FALSELY]
    free = [h for h in shifted if h.label in baseline.free or h.key in accepted]
    blamed = [h for h in shifted if h not in free and h.name != UNKNOWN_LOAD]
    if not blamed:
        return
    likeliest = max(blamed, key=lambda h: (gains[h.label], -p[h.label]))
    as_a_value = max((gains[h.label] for h in free), default=-np.inf)
    if as_a_value > max(gains[likeliest.label] - TIE, 0.0):
        return
    raise NothingLearned(
        _refusal_to_learn(likeliest, min(1.0, p[likeliest.label] * len(p)), len(records))
    )


def _gains_and_sizes(
    baseline: Baseline, records: Sequence[Record]
) -> tuple[dict[str, float], dict[str, list[FloatArray]]]:
    """What each hypothesis gains over all windows beyond what is usual [nat], and its sizes in each
    of them, by its label; of many records a few, evenly chosen, and none that cannot be judged.
    """
    count = min(CALIBRATED, len(records))
    chosen = np.unique(np.linspace(0, len(records) - 1, count).astype(int))
    gains: dict[str, float] = {}
    sizes: dict[str, list[FloatArray]] = {}
    for k in chosen:
        try:
            observed = estimated_window(baseline, records[k])
        except NotAssessable:
            continue
        fitter = baseline.fitter(observed.window, observed.features)
        healthy, trials = try_hypotheses(fitter, baseline.hypotheses, baseline.usual_gain)
        for label, trial in trials.items():
            sizes.setdefault(label, []).append(trial.fit.own)
            gains[label] = (
                gains.get(label, 0.0)
                + fitter.cost(healthy)
                - fitter.cost(trial.fit)
                - baseline.usual_gain(trial.hypothesis)
            )
    return gains, sizes


def _refusal_to_learn(likeliest: Hypothesis, chance: float, windows: int) -> str:
    place = f" of {likeliest.place}" if likeliest.place else ""
    return (
        f"the model is not learned anew: these {windows} windows together show"
        f" {likeliest.kind} {likeliest.name}{place} (chance that they are healthy: {chance:.1g}),"
        " and it would become the new normal; mend it first, or, if it was always there, add it to"
        " the model with `residuum improve`"
    )


def _chances(baseline: Baseline, sizes: Mapping[str, Sequence[FloatArray]]) -> dict[str, float]:
    """Of each hypothesis by its label: `_chance` of its sizes."""
    labels = [h.label for h in baseline.hypotheses]
    return {label: _chance(baseline, label, sizes.get(label, [])) for label in labels}


def _chance(baseline: Baseline, label: str, sizes: Sequence[FloatArray]) -> float:
    """Chance that a hypothesis' first size differs so much between these windows, if they are
    healthy, and those of the training; 1 where too few windows tell it.
    """
    usual = baseline.usual.get(label)
    if usual is None or len(usual.sizes) < _FEWEST or len(sizes) < _FEWEST:
        return 1.0
    new_sizes, usual_sizes = np.array([s[0] for s in sizes]), usual.sizes[:, 0]
    # sizes that are alike to rounding
    least = (1e-9 * float(np.max(np.abs([*new_sizes, *usual_sizes])))) ** 2 + 1e-300
    a, b = (max(float(x.var(ddof=1)), least) / len(x) for x in (new_sizes, usual_sizes))
    # Welch's t with the degrees of freedom of Welch and Satterthwaite
    t = float(new_sizes.mean() - usual_sizes.mean()) / np.sqrt(a + b)
    share = a / (a + b)
    freedom = 1.0 / (share**2 / (len(new_sizes) - 1) + (1.0 - share) ** 2 / (len(usual_sizes) - 1))
    return float(2.0 * stats.t.sf(abs(t), freedom))


class Undetermined(NotIdentifiable):
    """Healthy windows do not determine some of the model's parameters, which are named."""

    def __init__(self, message: str, parameters: Sequence[str]) -> None:
        super().__init__(message)
        self.parameters = tuple(parameters)


@one_thread()
def train(
    model: PhysicalModel,
    records: Sequence[Record],
    *,
    fix_undetermined: bool = False,
    known: Sequence[EffectUse] = (),
) -> Baseline:
    """Learn a baseline from healthy records and a model.

    Each record is a window; fewer than 6 are cut into windows of equal length. `known` are effects
    that healthy windows were found to show before beyond the model: they stay what the model lacks.

    Raises
    ------
    Undetermined
        Windows leave a free value open (not with `fix_undetermined`, which keeps it at the file's
        value).
    BadRecord
        Records do not fit the model or each other, or are too short.
    """
    asked, experiments = match(model, windows_of(records))
    experiments = _alike(experiments)
    base = _beside_known(asked, known)
    if base.foreign is not None:
        base.foreign.choose_steps(base, [experiments[k] for k in evenly(len(experiments), 1)])
    fit = _determined(asked, base, experiments, fix_undetermined)
    better, experiments, doubted = with_missing_physics(
        fit.model, fit.experiments, _sized(fit.model, fit.experiments)
    )
    learned = _learned(asked, better, experiments, [record.source for record in records])
    return _calibrated(replace(learned, doubted=tuple(doubted)), experiments)


def _beside_known(asked: PhysicalModel, known: Sequence[EffectUse]) -> PhysicalModel:
    """The user's model with effects that it was found to lack before."""
    base = asked
    for use in known:
        if use.key not in [own.key for own in asked.effects]:
            base = base.with_effect(*use.key, {name: p.value for name, p in use.parameters.items()})
    return base


def _determined(
    asked: PhysicalModel,
    base: PhysicalModel,
    experiments: list[Experiment],
    fix_undetermined: bool,
) -> _FittedToAll:
    """The fit to all windows at once, which determine what no window determines by itself; Undetermined
    where values of the user's model stay open, unless those are to be held.
    """
    fit = _over_all(base, experiments)
    while wide := [name for name in _open(fit) if name in asked.parameters]:
        if not fix_undetermined:
            raise _refusal(asked, experiments, wide)
        # with the widest one held, others may be determined
        base = held(base, wide[:1])
        fit = _over_all(base, fit.experiments, timing_known=True)
    return fit


def windows_of(records: Sequence[Record]) -> list[Record]:
    """The records, or where they are few their parts of equal length."""
    if not records:
        raise BadRecord("model-based: no healthy record to train on")
    if len(records) >= FEWEST_WINDOWS:
        return list(records)
    length = max(min(r.n for r in records) * len(records) // CUT_INTO, FEWEST_IN_A_WINDOW)
    parts = [r.window(k, k + length) for r in records for k in range(0, r.n - length + 1, length)]
    if len(parts) < FEWEST_WINDOWS:
        samples = sum(r.n for r in records)
        raise BadRecord(
            f"model-based: {len(records)} healthy records with {samples} samples; at least"
            f" {FEWEST_WINDOWS} windows of {FEWEST_IN_A_WINDOW} samples are needed, 20 are good"
        )
    return parts


def _alike(experiments: Sequence[Experiment]) -> list[Experiment]:
    first = experiments[0]
    for e in experiments:
        if abs(e.sample_time / first.sample_time - 1.0) > 1e-3:
            raise BadRecord(
                f"record {e.source!r}: sampled every {e.sample_time:g} s, {first.source!r} every"
                f" {first.sample_time:g} s; healthy windows must be alike"
            )
        if e.n < FEWEST_IN_A_WINDOW:
            raise BadRecord(
                f"record {e.source!r}: {e.n} samples; a healthy window needs at least"
                f" {FEWEST_IN_A_WINDOW}"
            )
        if np.any(e.measured != first.measured):
            raise BadRecord(
                f"records {e.source!r} and {first.source!r}: have different outputs; healthy"
                " windows must be alike"
            )
    # one timing of the inputs for all windows, that of most of them
    hold = np.array(np.mean([e.hold for e in experiments], axis=0) >= 0.5, dtype=float)
    return [replace(e, hold=hold) for e in experiments]


@dataclass(frozen=True, eq=False)
class _FittedToAll:
    """A model fitted to all windows together, these at the input timing that suits it."""

    model: PhysicalModel
    experiments: list[Experiment]
    parameters: Sequence[str]
    std: FloatArray


def _over_all(
    model: PhysicalModel, experiments: list[Experiment], *, timing_known: bool = False
) -> _FittedToAll:
    if model.foreign is not None:
        # its slopes are differences of whole simulations, which no pass of shooting makes
        def fitted(turned: list[Experiment]) -> Estimate:
            return estimate(model, turned)

        timed, found = (
            (experiments, fitted(experiments))
            if timing_known
            else at_likelier_timing(experiments, fitted)
        )
        return _FittedToAll(found.model, timed, found.parameters, found.std)
    data = data_of(model, experiments)
    start = first_fit(data) if timing_known else first_fit_at_likelier_timing(data)
    fit = start.found
    return _FittedToAll(fit.model, start.data.experiments, fit.parameters, fit.std)


def _open(fit: _FittedToAll) -> list[str]:
    """Values that all healthy windows together leave open, the widest first."""
    now = fit.model.values
    share = {
        name: std / max(abs(now[name]), 1e-300)
        for name, std in zip(fit.parameters, fit.std.tolist(), strict=True)
    }
    return sorted(
        (name for name, wide in share.items() if not wide < OPEN),
        key=lambda name: -np.nan_to_num(share[name], nan=np.inf),
    )


def _refusal(
    model: PhysicalModel, experiments: Sequence[Experiment], wide: Sequence[str]
) -> Undetermined:
    pronoun = "them" if len(wide) > 1 else "it"
    way_on = said("fix_undetermined", True)
    driving = ", ".join(model.inputs) or "the machine"
    measured = np.any([e.measured for e in experiments], axis=0)
    lacking = [name for name, known in zip(model.outputs, measured, strict=True) if not known]
    more = f", or record {' or '.join(lacking)} too" if lacking else ""
    return Undetermined(
        f"model {model.name!r}: healthy windows do not determine {', '.join(wide)}: record windows"
        f" in which {driving} moves faster and over a wider range{more}, or keep"
        f" {pronoun} at the file's value: {way_on}",
        wide,
    )


def _learned(
    asked: PhysicalModel,
    model: PhysicalModel,
    experiments: Sequence[Experiment],
    sources: Sequence[str],
) -> Baseline:
    """The baseline before hypotheses are tried on healthy windows.

    Parameters
    ----------
    asked, model : PhysicalModel
        The user's, and that with the physics which healthy windows show beyond it.
    experiments, sources : sequences, one a window
    """
    start = np.array([model.values[name] for name in model.free])
    whitening = _learned_whitening(model, experiments, start)
    kind = KindOfRun.of(experiments)
    F = _features(kind, experiments)
    fits = _each_alone(model, experiments, start, whitening)
    theta = np.array([fit.values for fit in fits])
    window_info = [information(fit, len(start)) for fit in fits]
    values = Scatter.of(F, theta, window_info, 1e-3 * np.abs(start) + 1e-12)
    power = np.array([log_power(fit) for fit in fits])
    errors = Scatter.of(F, power, None, np.full(power.shape[1], 0.01))
    # features are counted from the healthy mean, so the first row of B is what is usual there
    model = model.with_values(dict(zip(model.free, values.B[0].tolist(), strict=True)))
    diagonals = np.array([np.diag(h) for h in window_info]).reshape(len(window_info), len(start))
    # offsets are known once the values' scatter is: `_calibrated` replaces this scatter of zeros
    unknown_offsets = np.zeros((len(experiments), len(model.outputs)))
    first = experiments[0]
    return Baseline(
        asked=asked,
        model=model,
        mended=_labels_beyond(asked, model),
        kind=kind,
        whitening=whitening,
        values=values,
        errors=errors,
        offsets=Scatter.of(F, unknown_offsets, None, unknown_offsets[0] + 1.0),
        usual={},
        information=diagonals.min(axis=0),
        typical=np.median(diagonals, axis=0),
        input_spans=_least_span([e.U for e in experiments]),
        spans=_least_span([_readings(e) for e in experiments]),
        measured=first.measured,
        hold=first.hold,
        sample_time=first.sample_time,
        seconds=first.sample_time * float(np.median([e.n for e in experiments])),
        windows=len(experiments),
        apart=_apart(F, np.column_stack([theta, power])),
        sources=list(sources),
    )


def _features(kind: KindOfRun, experiments: Sequence[Experiment]) -> FloatArray:
    """Features of each window, shape (windows, features)."""
    return np.array([kind.features(e) for e in experiments])


def _labels_beyond(asked: PhysicalModel, model: PhysicalModel) -> tuple[str, ...]:
    """Effects of a model that the user's does not have."""
    known = [use.label for use in asked.effects]
    return tuple(use.label for use in model.effects if use.label not in known)


def _learned_whitening(
    model: PhysicalModel, experiments: Sequence[Experiment], start: FloatArray
) -> Whitening:
    """The whitening of healthy errors: twice, because it decides the fits that leave them."""
    whitening = _sized(model, experiments)
    for _ in range(2):
        fits = _each_alone(model, experiments, start, whitening)
        whitening = Whitening.of([fit.error for fit in fits])
    return whitening


def _least_span(signals: Sequence[FloatArray]) -> FloatArray:
    """The smallest span of each channel over the windows, shape (channels,)."""
    return np.array([np.ptp(signal, axis=0) for signal in signals]).min(axis=0)


def _sized(model: PhysicalModel, experiments: Sequence[Experiment]) -> Whitening:
    """A whitening before errors are known but for their size: their RMS over all windows."""
    return Whitening.plain(
        np.maximum(np.nan_to_num(estimate(model, experiments, free=()).rmse), 1e-9)
    )


def _each_alone(
    model: PhysicalModel, experiments: Sequence[Experiment], start: FloatArray, whitening: Whitening
) -> list[Fit]:
    fits = []
    for e in experiments:
        fit = own_estimate(model, e, start, whitening)
        if fit is None:
            raise BadRecord(
                f"record {e.source!r}: the model diverges along it; look at it with `residuum"
                " compare`, or leave it out"
            )
        fits.append(fit)
    return fits


def _readings(e: Experiment) -> FloatArray:
    """Readings, a missing one as their mean."""
    count = np.maximum(np.isfinite(e.Y).sum(axis=0), 1)
    return np.where(np.isfinite(e.Y), e.Y, np.nan_to_num(e.Y).sum(axis=0) / count)


def _apart(F: FloatArray, x: FloatArray) -> tuple[int, ...]:
    """Windows that differ from all others in a value or in their error, each held against the
    scatter of the others.
    """
    apart, n = [], len(x)
    for k in range(n):
        but_k = np.arange(n) != k
        scatter = Scatter.of(F[but_k], x[but_k], None, 1e-3 * np.abs(x).mean(axis=0) + 1e-12)
        mean, covariance = scatter.at(F[k])
        t = np.abs(x[k] - mean) / np.sqrt(np.diag(covariance))
        # two-sided, Bonferroni over all values of all windows
        if 2.0 * x.size * stats.t.sf(t.max(), scatter.freedom) < APART:
            apart.append(k)
    return tuple(apart)


def _calibrated(baseline: Baseline, experiments: Sequence[Experiment]) -> Baseline:
    """The baseline with the scatter of offsets over all windows, and with what each hypothesis gains,
    and how its sizes scatter, in some of them.
    """
    F = _features(baseline.kind, experiments)
    fitters = [baseline.fitter(e, f) for e, f in zip(experiments, F, strict=True)]
    offsets, H = np.array(
        [baseline.offsets_in(fitter, fitter.fit(Variant(baseline.model))) for fitter in fitters]
    ).swapaxes(0, 1)
    baseline = replace(
        baseline,
        offsets=Scatter.of(F, offsets, [np.diag(h) for h in H], 1e-6 * baseline.spans + 1e-300),
    )
    chosen = [fitters[k] for k in evenly(len(experiments), CALIBRATED)]
    trials = [
        (fitter, *try_hypotheses(fitter, baseline.hypotheses, baseline.usual_gain))
        for fitter in chosen
    ]
    usual = {}
    for h in baseline.hypotheses:
        fits = [
            (fitter, healthy, by_label[h.label].fit)
            for fitter, healthy, by_label in trials
            if h.label in by_label
        ]
        usual[h.label] = _usual(fits)
    return replace(baseline, usual=usual)


def _usual(fits: Sequence[tuple[WindowFitter, Fit, Fit]]) -> Usual:
    """What a hypothesis shows in healthy windows, each given as its fitter, the healthy fit and
    that of the hypothesis.
    """
    gains = [_gain(fitter, healthy, fit) for fitter, healthy, fit in fits]
    sizes = _sizes([fit for _, _, fit in fits])
    return Usual(float(np.mean(gains)) if gains else 0.0, sizes)


def _gain(fitter: WindowFitter, healthy: Fit, fit: Fit) -> float:
    """[nat] By which a hypothesis explains a healthy window better. The price of its sizes is not
    taken off, since `cost` does so where hypotheses are compared; what other values paid to the
    prior is.
    """
    return max(fitter.cost(healthy) - fitter.cost(fit) + fitter.penalty(fit) - fit.prior_cost, 0.0)


def _sizes(fits: Sequence[Fit]) -> FloatArray:
    """Shape (windows, sizes); a hypothesis whose number of sizes differs from window to window has
    none that scatter.
    """
    counts = {len(fit.own) for fit in fits}
    return np.array([fit.own for fit in fits]) if len(counts) == 1 else np.zeros((0, 1))
