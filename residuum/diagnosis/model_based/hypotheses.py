"""What may have happened to a machine: each hypothesis as the columns that it adds to the innovations of a filter."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from residuum.diagnosis.model_based.filtered_window import Filtered, TrackingFilter
from residuum.identification.errors import BadInput
from residuum.identification.physics import Experiment, PhysicalModel, Simulator, candidates, conditions_at
from residuum.identification.physics.effects import EFFECTS
from residuum.identification.physics.simulate.filter_sensitivities import innovation_slopes

Array = npt.NDArray[np.float64]

_SHAPES = 3
"""First shapes of an effect (wave numbers, speeds) that are kept."""


@dataclass(frozen=True)
class Column:
    """One size: what it acts on (`parameter:…`, `balance:…`, `input:…`, `output:…`), times which signal, in which unit.

    `signal` is `one`, `reading` (the output as expected), `slope` (its falling rate), `input`, or `effect:size` of a stand-in.
    """

    acts_on: str
    signal: str
    unit: str
    lower: float = -np.inf
    upper: float = np.inf


@dataclass(frozen=True)
class Hypothesis:
    """One thing that may have happened.

    Parameters
    ----------
    kind : str
        `parameter`, `effect`, `sensor`, `actuator` or `disturbance`.
    name, place : str
        The parameter's name, the effect's id, or what happened to a signal; and the balance, output or input.
    columns : tuple of Column
        Its sizes.
    shape : mapping
        Values of an effect's other parameters, for one that is in the catalogue alone.
    """

    kind: str
    name: str
    place: str
    columns: tuple[Column, ...]
    shape: Mapping[str, float] = field(default_factory=dict)

    @property
    def label(self) -> str:
        """`name@place`, or the name alone where there is no place."""
        return f"{self.name}@{self.place}" if self.place else self.name

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        columns = [[c.acts_on, c.signal, c.unit, *map(_written, (c.lower, c.upper))] for c in self.columns]
        return {"kind": self.kind, "name": self.name, "place": self.place, "columns": columns, "shape": dict(self.shape)}

    @classmethod
    def from_json(cls, stored: Mapping[str, Any]) -> Hypothesis:
        """What `to_json` gave."""
        columns = tuple(
            Column(a, s, u, -np.inf if low is None else low, np.inf if high is None else high)
            for a, s, u, low, high in stored["columns"]
        )
        return cls(stored["kind"], stored["name"], stored["place"], columns, dict(stored["shape"]))


def hypotheses(model: PhysicalModel, tracking: TrackingFilter, windows: Sequence[Filtered]) -> list[Hypothesis]:
    """All that fit the model and the outputs that were measured; effects' first shapes are those of the windows' operation."""
    measured = np.any([w.experiment.measured for w in windows], axis=0)
    found = [_parameter(model, name) for name in model.free]
    for name, output in model.outputs.items():
        if measured[list(model.outputs).index(name)]:
            found += _sensor(name, output.unit)
    for name, signal in model.inputs.items():
        if not signal.absent and signal.default is None:
            found += _actuator(name, signal.unit)
    for balance in model.balances.values():
        found.append(Hypothesis("disturbance", "load", balance.name, (Column(f"balance:{balance.name}", "one", balance.unit),)))
    return found + _catalogue(model, tracking, windows)


def _parameter(model: PhysicalModel, full_name: str) -> Hypothesis:
    parameter = model.all_parameters[full_name]
    column = Column(f"parameter:{full_name}", "one", parameter.unit, parameter.lower, parameter.upper)
    label, dot, _ = full_name.rpartition(".")
    if dot and "@" in label:
        return Hypothesis("effect", label.partition("@")[0], label.partition("@")[2], (column,))
    return Hypothesis("parameter", full_name, "", (column,))


def _sensor(output: str, unit: str) -> list[Hypothesis]:
    at = f"output:{output}"
    return [
        Hypothesis("sensor", "offset", output, (Column(at, "one", unit),)),
        Hypothesis("sensor", "gain", output, (Column(at, "reading", "1", -1.0, np.inf),)),
        Hypothesis("sensor", "delay", output, (Column(at, "slope", "s", 0.0, np.inf),)),
    ]


def _actuator(name: str, unit: str) -> list[Hypothesis]:
    at = f"input:{name}"
    return [
        Hypothesis("actuator", "offset", name, (Column(at, "one", unit),)),
        Hypothesis("actuator", "gain", name, (Column(at, "input", "1", -1.0, np.inf),)),
        Hypothesis("actuator", "limit", name, (Column(at, "limit", unit, 0.0, np.inf),)),
    ]


def _catalogue(model: PhysicalModel, tracking: TrackingFilter, windows: Sequence[Filtered]) -> list[Hypothesis]:
    """Effects that are a term of a balance alone, at each of their first shapes; a constant load is the disturbance already."""
    longest = max(windows, key=lambda w: w.experiment.n)
    found: list[Hypothesis] = []
    for id, target in candidates(model):
        effect = EFFECTS[id]
        if effect.place != "balance" or not effect.sizes or id == "constant-load":
            continue
        site = model.site(target, effect)
        if effect.states(site):
            continue
        X = tracking.states(longest)
        conditions = conditions_at(model, effect, target, longest.experiment, X, np.zeros(longest.experiment.n))
        known = {p.name: p for p in effect.parameters(site)}
        try:
            starts = effect.starts(conditions)[:_SHAPES]
            for start in starts:
                _terms(Simulator(model.with_effect(id, target, start)), id, target, longest.experiment, X)
        except (BadInput, NotImplementedError, KeyError, ValueError):
            continue
        for start in starts:
            columns = tuple(
                Column(f"balance:{target}", f"{id}:{size}", known[size].unit, known[size].lower, known[size].upper)
                for size in effect.sizes
            )
            found.append(Hypothesis("effect", id, target, columns, dict(start)))
    return found


def _terms(simulator: Simulator, id: str, target: str, experiment: Experiment, X: Array) -> Array:
    """The effect's term along states X, shape (n,)."""
    return simulator.look(experiment, X)[f"{target}.{id}"]


class Signals:
    """The signals that hypotheses multiply what they act on with, along a window.

    The terms of all effects that are in the catalogue alone are looked up in one structure that holds them together.
    """

    def __init__(self, model: PhysicalModel, listed: Sequence[Hypothesis]) -> None:
        self.model, self.listed = model, list(listed)
        together = model
        self._places: list[tuple[Hypothesis, str, int]] = []
        count: dict[tuple[str, str], int] = {}
        for h in self.listed:
            if not h.shape:
                continue
            together = together.with_effect(h.name, h.place, dict.fromkeys(EFFECTS[h.name].sizes, 0.0) | _shapes(h))
            count[h.name, h.place] = count.get((h.name, h.place), 0) + 1
            self._places.append((h, together.effects[-1].label, count[h.name, h.place]))
        self._simulator = Simulator(together) if self._places else None

    def of(self, filtered: Filtered, X: Array) -> Array:
        """One column a size of every hypothesis in turn, shape (n, sizes)."""
        terms = self._effect_terms(filtered.experiment, X)
        columns = [self._signal(h, column, filtered, terms) for h in self.listed for column in h.columns]
        return np.ascontiguousarray(np.column_stack(columns))

    def _effect_terms(self, experiment: Experiment, X: Array) -> dict[tuple[int, str], Array]:
        """Each stand-in's term a unit of each of its sizes; by the hypothesis' identity and the size's name."""
        found: dict[tuple[int, str], Array] = {}
        if self._simulator is None:
            return found
        states = np.zeros((len(X), len(self._simulator.states)))
        states[:, : X.shape[1]] = X
        for turn in range(max(len(h.columns) for h, _, _ in self._places)):
            values, asked = {}, []
            for h, label, instance in self._places:
                if turn < len(h.columns):
                    size = h.columns[turn].signal.partition(":")[2]
                    unit = abs(h.shape.get(size, 0.0)) or 1.0
                    values[f"{label}.{size}"] = unit
                    asked.append((h, size, unit, instance))
            look = self._simulator.look(experiment, states, values)
            for h, size, unit, instance in asked:
                name = f"{h.place}.{h.name}" + (f"#{instance}" if instance > 1 else "")
                found[id(h), size] = look[name] / unit
        return found

    def _signal(self, h: Hypothesis, column: Column, filtered: Filtered, terms: Mapping[tuple[int, str], Array]) -> Array:
        e = filtered.experiment
        if h.shape:
            return terms[id(h), column.signal.partition(":")[2]]
        if h.kind == "sensor" and column.signal != "one":
            reading = expected_reading(filtered, list(self.model.outputs).index(h.place))
            return reading if column.signal == "reading" else -_rate(reading, e.sample_time)
        if h.kind == "actuator" and column.signal != "one":
            u = e.U[:, list(self.model.inputs).index(h.place)]
            return u if column.signal == "input" else beyond_limit(u)
        return np.ones(e.n)


def beyond_limit(u: Array, share: float = 0.75) -> Array:
    """What an input lacks, a unit of its size, where only this share of its largest magnitude is reached."""
    limit = share * float(np.max(np.abs(u)))
    lost = np.maximum(np.abs(u) - limit, 0.0)
    largest = float(np.max(lost))
    return np.asarray(-np.sign(u) * lost / largest) if largest > 0.0 else np.zeros(len(u))


def _rate(reading: Array, sample_time: float) -> Array:
    """Rate at which an expected reading came to where it is; the next one would know this sample's innovation already."""
    return np.concatenate([[0.0], np.diff(reading)]) / sample_time


def expected_reading(filtered: Filtered, output: int) -> Array:
    """What an output was expected to read; where nothing was measured its neighbours' line."""
    reading = filtered.predicted[:, output]
    known = np.isfinite(reading)
    if known.all() or not known.any():
        return np.nan_to_num(reading)
    at = np.arange(len(reading))
    return np.interp(at, at[known], reading[known])


def slopes_of(filtered: Filtered, tracking: TrackingFilter, listed: Sequence[Hypothesis], signals: Array) -> Array:
    """Derivative of the normalised innovations by every size, shape (n, outputs, sizes)."""
    outputs, places = list(tracking.model.outputs), {name: k for k, name in enumerate(tracking.columns)}
    base = [
        -1 - outputs.index(h.place) if c.acts_on.startswith("output:") else places[c.acts_on] for h in listed for c in h.columns
    ]
    return np.asarray(
        innovation_slopes(
            filtered.P, filtered.F, filtered.H, filtered.e, filtered.V, filtered.G, filtered.C, np.array(base), signals
        )
    )


def _shapes(h: Hypothesis) -> dict[str, float]:
    return {name: value for name, value in h.shape.items() if name not in EFFECTS[h.name].sizes}


def _written(bound: float) -> float | None:
    return float(bound) if np.isfinite(bound) else None
