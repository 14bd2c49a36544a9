"""What may have happened to a healthy machine: a value changed, an effect more, a sensor's or an
actuator's fault, a load.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from residuum.array_types import FloatArray
from residuum.diagnosis.model_based.policy import (
    FIRST_SIZE,
    GRID,
    HYPOTHESES_FITTED,
    KNOTS,
    LOST_READING,
    SCREENING_STEPS,
    SHAPES_LOOKED_AT,
)
from residuum.diagnosis.model_based.variant import Variant, amplified, delayed, edited, held
from residuum.diagnosis.model_based.window_fit import Fit, WindowFitter
from residuum.identification.errors import BadInput, BadRecord
from residuum.identification.physics import (
    Experiment,
    Key,
    PhysicalModel,
    candidates,
    conditions_at,
    find_effect,
)

UNKNOWN_LOAD = "unknown-load"
_LATE = (0.5, 3.0, 12.0)
"""[samples] Delays to begin with."""


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """A thing that may have happened.

    Attributes
    ----------
    kind : str
        `parameter`, `effect`, `sensor`, `actuator` or `disturbance`.
    name, place, unit : str
        What, where, and the unit of its first size.
    variants : function
        Window and states along the healthy model → ways to begin with it.
    begin : function or None
        Window and sample → the way that begins there, where the beginning is a size of its own.
    in_residual : function or None
        Where it shows in the residual of the healthy fit alone: fitter and healthy fit → its fit.
    in_samples : bool
        Whether its size counts samples.
    key : Key or None
        The effect that the healthy model lacks.
    """

    kind: str
    name: str
    place: str = ""
    unit: str = ""
    variants: Callable[[Experiment, FloatArray], list[Variant]] = lambda e, X: []
    begin: Callable[[Experiment, int], Variant] | None = None
    in_residual: Callable[[WindowFitter, Fit], Fit | None] | None = None
    in_samples: bool = False
    key: Key | None = None

    @property
    def label(self) -> str:
        """`name@place`."""
        return f"{self.name}@{self.place}" if self.place else self.name


def hypotheses(model: PhysicalModel, values: Sequence[str]) -> list[Hypothesis]:
    """Everything that may have happened to a machine with this model, of which these values may
    change.
    """
    listed = [_value(model, name) for name in values]
    listed += [_new_effect(model, key) for key in candidates(model) if model.records(key)]
    for o, (name, output) in enumerate(model.outputs.items()):
        listed += _sensor(model, o, name, output.unit)
    for i, (name, signal) in enumerate(model.inputs.items()):
        if not signal.absent and Key("input-offset", name) in candidates(model, ["input-offset"]):
            listed += _actuator(model, i, name, signal.unit)
    return listed + [_load(model, name) for name in model.balances]


def _load(model: PhysicalModel, balance: str) -> Hypothesis:
    return Hypothesis(
        "disturbance", UNKNOWN_LOAD, balance, "", lambda e, X: [_unknown_load(model, balance)]
    )


def _value(model: PhysicalModel, name: str) -> Hypothesis:
    # a library's parameters may have dots in their names: `motor.R` is no effect's
    use = "" if name in model.parameters else name.rpartition(".")[0]
    effect, _, place = use.partition("@")
    unit = model.all_parameters[name].unit
    return Hypothesis(
        "effect" if effect else "parameter",
        effect or name,
        place,
        unit,
        lambda e, X: [Variant(model, (name,))],
    )


def _new_effect(model: PhysicalModel, key: Key) -> Hypothesis:
    effect = find_effect(key.effect)
    kind = {"input": "actuator", "output": "sensor"}.get(effect.place, "effect")
    parameters = {p.name: p for p in effect.parameters(model.site(key.target, effect))}
    unit = parameters[effect.sizes[0]].unit if effect.sizes else ""
    name = key.effect.removeprefix(f"{effect.place}-")
    return Hypothesis(
        kind, name, key.target, unit, lambda e, X: _beginnings(model, key, e, X), key=key
    )


def _beginnings(model: PhysicalModel, key: Key, e: Experiment, X: FloatArray) -> list[Variant]:
    """Variants with the effect at each of its first shapes, its sizes small: the fit finds them."""
    effect, variants = find_effect(key.effect), []
    try:
        starts = list(effect.starts(conditions_at(model, effect, key.target, e, X)))
        for start in starts[:SHAPES_LOOKED_AT]:
            small = {
                name: value * FIRST_SIZE if name in effect.sizes else value
                for name, value in start.items()
            }
            larger = model.with_effect(*key, small)
            use = larger.effects[-1]
            # the size first: it is what is told
            own = sorted(
                (n for n, p in use.parameters.items() if not p.fixed),
                key=lambda n: n not in effect.sizes,
            )
            if own:
                variants.append(Variant(larger, tuple(f"{use.label}.{name}" for name in own)))
    except BadInput:
        pass  # an effect that this window gives no first values for, or only some, is not tried
    return variants


def _sensor(model: PhysicalModel, o: int, name: str, unit: str) -> list[Hypothesis]:
    own = np.arange(len(model.outputs)) == o
    # A gain is begun at none and stays above −0.95: at −1 the reading would be gone.
    gain = Variant(
        model,
        sizes=(0.0,),
        lower=(-0.95,),
        reading=edited(o, amplified),
        noise_gain=lambda s: np.asarray(1.0 + s[0] * own),
    )
    late = [Variant(model, sizes=(k,), lower=(0.0,), reading=edited(o, delayed)) for k in _LATE]

    def stuck(e: Experiment, t: int) -> Variant:
        y = e.Y[t:, o]
        value = float(np.median(y[np.isfinite(y)])) if np.isfinite(y).any() else 0.0
        return Variant(model, sizes=(value,), lower=(-np.inf,), onset=t, reading=edited(o, held, t))

    def anywhere(e: Experiment, X: FloatArray) -> list[Variant]:
        # a sensor that sticks without noise repeats one reading: its run shows where it began
        grid = range(0, e.n - 2, max(e.n // GRID, 1))
        return [stuck(e, t) for t in sorted({_longest_run(e.Y[:, o]), *grid})]

    return [
        Hypothesis("sensor", "gain", name, "", lambda e, X: [gain]),
        Hypothesis("sensor", "delay", name, "s", lambda e, X: late, in_samples=True),
        Hypothesis("sensor", "stuck", name, unit, anywhere, begin=stuck),
        Hypothesis("sensor", "noise", name, unit, in_residual=partial(_noisier, o)),
        Hypothesis("sensor", "drop-out", name, "", in_residual=partial(_dropped, o)),
    ]


def _actuator(model: PhysicalModel, i: int, name: str, unit: str) -> list[Hypothesis]:
    gain = Variant(model, sizes=(0.0,), lower=(-0.95,), inputs=edited(i, amplified))

    def stuck(e: Experiment, t: int) -> Variant:
        return Variant(
            model, sizes=(float(e.U[t, i]),), lower=(-np.inf,), onset=t, inputs=edited(i, held, t)
        )

    def anywhere(e: Experiment, X: FloatArray) -> list[Variant]:
        return [stuck(e, t) for t in range(0, e.n - 2, max(e.n // GRID, 1))]

    return [
        Hypothesis("actuator", "gain", name, "", lambda e, X: [gain]),
        Hypothesis("actuator", "stuck", name, unit, anywhere, begin=stuck),
    ]


def _longest_run(y: FloatArray) -> int:
    """Where the longest run of equal readings begins."""
    edges = np.flatnonzero(np.concatenate([[True], y[1:] != y[:-1], [True]]))
    return int(edges[np.argmax(np.diff(edges))])


def _unknown_load(model: PhysicalModel, balance: str) -> Variant:
    """A load on a balance that nobody recorded, linear between knots at even times."""
    # Each knot is an input that the model lacks, of which the fit finds the gain: an unknown course
    # becomes KNOTS linear sizes.
    larger, inputs = model, len(model.inputs)
    for k in range(KNOTS):
        larger = larger.with_input(f"knot{k}", "").with_effect(
            "forgotten-input", f"{balance}(knot{k})", {"gain": 0.0}
        )

    def hats(U: FloatArray, sizes: FloatArray) -> FloatArray:
        at = np.linspace(0.0, KNOTS - 1.0, len(U))
        return np.column_stack(
            [U[:, :inputs], *(np.interp(at, np.arange(KNOTS), hat) for hat in np.eye(KNOTS))]
        )

    return Variant(
        larger, tuple(f"{use.label}.gain" for use in larger.effects[-KNOTS:]), inputs=hats
    )


def _noisier(o: int, fitter: WindowFitter, healthy: Fit) -> Fit | None:
    """The healthy fit with one output's error power less by the white noise that the window has
    beyond healthy ones; its size is the standard deviation of that noise in the output's unit.
    """
    growth = float(fitter.noise_growth(healthy.white)[o])
    power = healthy.power.copy()
    # half of what the likelihood would give: what has a structure is told by what explains it
    power[:, o] /= growth
    more = max(float(fitter.steps(healthy.white)[o] - fitter.whitening.steps[o]), 0.0)
    return replace(
        healthy, power=power, own=np.array([np.sqrt(more / fitter.whitening.amplified[o])])
    )


def _dropped(o: int, fitter: WindowFitter, healthy: Fit) -> Fit | None:
    """The healthy fit without readings that were lost: far away, and all at one value. Its size is
    their share; None where there are none.
    """
    r, Y = healthy.error[:, o], fitter.window.Y.copy()
    if not fitter.count[o]:
        return None
    # 1.4826 median |r| is σ of Gaussian noise, which the lost readings themselves do not raise
    far = np.abs(np.nan_to_num(r)) > LOST_READING * 1.4826 * np.nanmedian(np.abs(r))
    # lost readings stand at one value; readings that are far away at many values are noise
    values, counts = np.unique(Y[far, o], return_counts=True)
    if not counts.size or counts.max() < max(3.0, 0.5 * float(far.sum())):
        return None
    lost = far & (Y[:, o] == values[counts.argmax()])
    Y[lost, o] = np.nan
    refit = fitter.of(replace(fitter.window, Y=Y)).fit(healthy.variant)
    return None if refit is None else replace(refit, own=np.array([lost.mean()]))


# Every hypothesis tried on one window: all are screened, the best are fitted.


@dataclass(frozen=True, eq=False)
class Trial:
    """A hypothesis and its best fit."""

    hypothesis: Hypothesis
    fit: Fit


def try_hypotheses(
    fitter: WindowFitter, listed: Sequence[Hypothesis], usual_gain: Callable[[Hypothesis], float]
) -> tuple[Fit, dict[str, Trial]]:
    """The healthy fit, and the best fit of each hypothesis by its label.

    Raises
    ------
    BadRecord
        The healthy model cannot be simulated along the window.
    """
    healthy = fitter.fit(Variant(fitter.model))
    if healthy is None:
        raise BadRecord(
            f"record {fitter.window.source!r}: the model diverges along it; `residuum compare`"
            " shows how far off it is"
        )
    X, screened = fitter.states(healthy), []
    for h in listed:
        if h.in_residual is not None:
            fits = [h.in_residual(fitter, healthy)]
        else:
            fits = [
                fitter.fit(v, SCREENING_STEPS, beside=healthy) for v in h.variants(fitter.window, X)
            ]
        if known := [fit for fit in fits if fit is not None]:
            screened.append(Trial(h, min(known, key=fitter.cost)))
    # Screened by a few steps from the healthy fit. What costs little after them, and gains little in
    # healthy windows anyway, is fitted; the others stay as they were screened.
    screened.sort(key=lambda t: fitter.cost(t.fit) + usual_gain(t.hypothesis))
    screened[:HYPOTHESES_FITTED] = [
        _fitted(fitter, healthy, t) for t in screened[:HYPOTHESES_FITTED]
    ]
    return healthy, {t.hypothesis.label: t for t in screened}


def _fitted(fitter: WindowFitter, healthy: Fit, trial: Trial) -> Trial:
    """The trial fitted to the end; where its onset is a size, that is found by halving steps."""
    h, best = trial.hypothesis, trial.fit
    if h.in_residual is not None:
        return trial
    steps = fitter.window.n // GRID if h.begin is not None else 0
    # the screened fit stays a candidate: the full one may end in a poorer minimum
    known = [fit for fit in (best, fitter.fit(best.variant, begin=best)) if fit is not None]
    best = min(known, key=fitter.cost)
    while h.begin is not None and (steps := steps // 2):
        beside = [
            t for t in (best.onset - steps, best.onset + steps) if 0 <= t < fitter.window.n - 2
        ]
        nearby = [
            fitter.fit(h.begin(fitter.window, t), SCREENING_STEPS, beside=healthy) for t in beside
        ]
        best = min([best, *(fit for fit in nearby if fit is not None)], key=fitter.cost)
    return Trial(h, best)
