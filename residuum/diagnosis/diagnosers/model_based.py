"""Any machine that has a model: trained on a model file and healthy records, told which cause and
how much.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np

from residuum.diagnosis.diagnosers.base import Channel, Diagnoser, Example, NotTrained
from residuum.diagnosis.finding import Finding
from residuum.diagnosis.model_based.assessment import CLASSES, assess, missing_physics, rate_alone
from residuum.diagnosis.model_based.baseline import Baseline
from residuum.diagnosis.model_based.training import following, refuse_recalibration, train
from residuum.diagnosis.thresholds.false_alarm_rate import SECONDS_A_DAY
from residuum.identification.errors import BadInput, said
from residuum.identification.physics import BUILT_IN, PhysicalModel, load_model
from residuum.identification.record import Record
from residuum.identification.unseen_blocks.structure import HeldValue
from residuum.nearest_names import known_names

FALSE_ALARMS_PER_DAY = 1.0
_SETTINGS = ("false_alarms_per_day", "fix_undetermined")


class ModelBased(Diagnoser):
    """Each window's values and simulation error against those of healthy windows; causes by the
    same error; their sizes.

    Parameters
    ----------
    model : str, path, PhysicalModel or None
        A built-in name or a model file; None: the built-in model whose inputs and outputs the
        records have.
    false_alarms_per_day : float
        Of windows that follow one another without overlap.
    fix_undetermined : bool
        Keep values that healthy windows do not determine at the file's, instead of refusing.
    free : sequence of str or None
        Values that are followed from window to window, all others held; None: those that the model
        does not hold.
    """

    name: ClassVar[str] = "model-based"
    views: ClassVar[Sequence[str]] = ("tracks",)
    channels: ClassVar[Sequence[Channel]] = (
        Channel("inputs", "", "every input of the model, by its name there (unit: the model's)"),
        Channel("outputs", "", "every output of the model that was recorded, by its name there"),
    )
    classes: ClassVar[Sequence[str]] = CLASSES

    def __init__(
        self,
        *,
        model: str | Path | PhysicalModel | None = None,
        false_alarms_per_day: float = FALSE_ALARMS_PER_DAY,
        fix_undetermined: bool = False,
        free: Sequence[str] | None = None,
    ) -> None:
        if not (np.isfinite(false_alarms_per_day) and false_alarms_per_day > 0):
            raise BadInput(
                f"false alarms per day: {false_alarms_per_day!r}; must be a positive number"
            )
        self.model = load_model(model) if isinstance(model, str | Path) else model
        if free is not None:
            self.model = _following(self.model, free)
        self.false_alarms_per_day, self.fix_undetermined = false_alarms_per_day, fix_undetermined
        self._baseline: Baseline | None = None

    def fit(self, records: Sequence[Record], labels: Sequence[str] | None = None) -> Self:
        """Learn what is healthy from the records labelled `healthy` (all, without labels)."""
        if labels is not None and len(labels) != len(records):
            raise BadInput(
                f"model-based: {len(labels)} labels for {len(records)} records; one each is needed"
            )
        healthy = [r for k, r in enumerate(records) if labels is None or labels[k] == "healthy"]
        if not healthy:
            raise BadInput("model-based: no healthy record to train on")
        model = self.model or built_in_model(healthy)
        self._baseline = train(model, healthy, fix_undetermined=self.fix_undetermined)
        self.model = model
        return self

    @property
    def baseline(self) -> Baseline:
        """What was learned; NotTrained before `fit`."""
        if self._baseline is None:
            raise NotTrained(
                "model-based: has no baseline; train it on a model and healthy records first"
            )
        return self._baseline

    def score(self, record: Record) -> Finding:
        """Judge one window."""
        return assess(self.name, self.baseline, record, self.false_alarms_per_day)

    def refuse_learning(self, healthy: Sequence[Record]) -> None:
        """Raise NothingLearned where a sensor's fault or a new effect is probable in the windows,
        taken together.
        """
        refuse_recalibration(self.baseline, healthy)

    def relearned(self, healthy: Sequence[Record], model: PhysicalModel | None = None) -> Self:
        """Learned anew from these windows, with another model where one is given.

        What the model lacked when it was trained first stays what it lacks. NothingLearned where a
        fault is probable in them, or a new effect that the other model does not have.
        """
        known = () if self._baseline is None else self._baseline.stand_ins
        if self._baseline is not None:
            refuse_recalibration(
                self._baseline, healthy, [] if model is None else [use.key for use in model.effects]
            )
        diagnoser = copy.copy(self)
        diagnoser.model = self.baseline.asked if model is None else model
        diagnoser._baseline = train(
            diagnoser.model, healthy, fix_undetermined=self.fix_undetermined, known=known
        )
        return diagnoser

    def with_settings(self, **settings: object) -> Self:
        """The same baseline at another rate of false alarms."""
        if "method" in settings:
            super().with_settings(method=settings.pop("method"))
        current = {name: getattr(self, name) for name in _SETTINGS}
        try:
            diagnoser = type(self)(model=self.model, **(current | settings))
        except TypeError:
            first = next(name for name in settings if name not in _SETTINGS)
            raise BadInput(
                f"diagnoser {self.name!r}: has no setting {first!r};"
                f" {known_names(first, _SETTINGS, 'it has')}"
            ) from None
        diagnoser._baseline = self._baseline
        return diagnoser

    def learned(self) -> dict[str, Any]:
        """Healthy values, the physics that healthy windows show beyond the model, and the rate that
        they vouch for.
        """
        b = self.baseline
        alone, missing = rate_alone(b), missing_physics(b)
        unseen = b.smallest_visible(min(0.5, self.false_alarms_per_day * b.seconds / SECONDS_A_DAY))
        values = {
            n: {
                "value": b.model.values[n],
                "unit": b.model.all_parameters[n].unit,
                "smallest_visible_change": unseen[n],
            }
            for n in b.free
        }
        says = [
            f"  {n} = {v['value']:.5g} {v['unit']}; {_found(unseen[n])} would be found in one window"
            for n, v in values.items()
            if not n.startswith(b.mended)
        ]
        says += [self._held_says(value) for value in b.doubted]
        says += [
            f"  healthy windows show {m['effect']}@{m['place']}, which the model lacks: `residuum"
            " explain` tells more"
            for m in missing
        ]
        says += [
            f"  {b.sources[k]} stands apart from the others: is it healthy?"
            for k in b.apart
            if k < len(b.sources)
        ]
        says.append(
            f"  {b.windows} healthy windows by themselves allow {alone:.3g} false alarms a day;"
            " less is extrapolated"
        )
        summary = {
            "windows": b.windows,
            "parameters": values,
            "missing_physics": missing,
            "held_values": [asdict(value) for value in b.doubted],
            "apart": list(b.apart),
        }
        return summary | {"rate_without_extrapolation": alone, "says": says}

    def _held_says(self, held: HeldValue) -> str:
        """One line for a value that the model holds, and that healthy windows contradict."""
        followed = [*self.baseline.asked.free, held.name]
        alike = (
            f" ({', '.join(held.indistinguishable_from)} would do as well)"
            if held.indistinguishable_from
            else ""
        )
        return (
            f"  {held.name} is held at {held.held:.4g} {held.unit}; healthy windows ask for"
            f" {held.value:.4g} ± {held.std:.2g} {held.unit}, which explains as much as"
            f" {' and '.join(held.as_much_as)}{alike}: correct it, or follow it with"
            f" {said('free', followed)}"
        )

    def describe(self) -> Mapping[str, object]:
        """With the channels of the model, once it is known."""
        if self.model is None:
            return super().describe()
        inputs = [
            Channel(n, s.unit, "input of the model", s.default is None)
            for n, s in self.model.inputs.items()
        ]
        outputs = [
            Channel(n, s.unit, "output of the model", False) for n, s in self.model.outputs.items()
        ]
        return {
            **super().describe(),
            "channels": [vars(channel) for channel in (*inputs, *outputs)],
        }

    def save(self, path: str | Path) -> None:
        """Store the trained diagnoser."""
        settings = {
            "false_alarms_per_day": self.false_alarms_per_day,
            "fix_undetermined": self.fix_undetermined,
        }
        self.baseline.save(path, self.name, settings)

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """The diagnoser stored by `save`."""
        baseline, settings = Baseline.load(path, cls.name)
        try:
            loaded = cls(**settings)
        except TypeError as error:
            raise BadInput(f"{path}: is not a model-based baseline: {error}") from None
        loaded._baseline, loaded.model = baseline, baseline.asked
        return loaded

    @classmethod
    def examples(cls) -> Sequence[Example]:
        """A mass on a guide pushed to and fro: its mass grown, a friction that was not there, an
        offset of its speed's sensor.
        """
        healthy = [_axis(seed) for seed in range(12)]
        faulty = [_axis(51, mass=120.0), _axis(52, friction=20.0), _axis(53, gain=1.1)]
        return (Example(healthy, None, [_axis(seed) for seed in (61, 62, 63)], faulty),)


def _found(change: float) -> str:
    """What of a value would be found, where its smallest visible change is known."""
    return f"a change by {change:.2g}" if change < float("inf") else "no change, however large,"


def _following(model: PhysicalModel | None, free: Sequence[str]) -> PhysicalModel:
    if model is None:
        raise BadInput(
            ", ".join(free),
            "free",
            "are values of a model, which is missing",
            way_on=[("model", "FILE")],
        )
    if model.foreign is not None:
        # loads what compiles, for FMUs alone
        from residuum.identification.physics.fmu.watched_model import declaring  # noqa: PLC0415

        model = declaring(model, free)
    return following(model, free)


def built_in_model(records: Sequence[Record]) -> PhysicalModel:
    """The built-in model whose inputs, and at least one output, all records have; BadInput when
    there is none.
    """
    for name in BUILT_IN:
        model = load_model(name)
        needed = [n for n, s in model.inputs.items() if s.default is None]
        if all(set(needed) <= set(r.names) and set(model.outputs) & set(r.names) for r in records):
            return model
    raise BadInput(
        "model-based: needs a model; no built-in one has the channels"
        f" {', '.join(records[0].names)}",
        way_on=[("model", "FILE")],
    )


def _axis(
    seed: int, *, mass: float = 95.0, friction: float = 0.0, gain: float = 1.0, n: int = 1500
) -> Record:
    """M dv/dt = F − τ sgn v at 200 Hz, F of random levels; position and speed with noise."""
    rng = np.random.default_rng([seed, 7])
    levels = rng.uniform(30.0, 120.0, n // 50 + 1) * np.where(np.arange(n // 50 + 1) % 2, -1.0, 1.0)
    force = np.repeat(levels, 50)[:n]
    q, v = np.zeros(n), np.zeros(n)
    for k in range(n - 1):
        for _ in range(10):
            free = v[k + 1] if _ else v[k]
            pushed = free + 5e-4 * force[k] / mass
            v[k + 1] = pushed - np.sign(pushed) * min(abs(pushed), 5e-4 * friction / mass)
            q[k + 1] = (q[k + 1] if _ else q[k]) + 5e-4 * v[k + 1]
    channels = {
        "force": force,
        "position": q + 1e-4 * rng.standard_normal(n),
        "velocity": gain * v + 2e-3 * rng.standard_normal(n),
    }
    return Record(
        channels,
        {"force": "N", "position": "m", "velocity": "m/s"},
        0.005,
        source=f"example {seed}",
    )
