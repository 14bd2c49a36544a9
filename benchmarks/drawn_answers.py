"""Models and records as they come, drawn: does any question end in a fault, and do the answers hold together?

    python -m benchmarks.drawn_answers [--first 0] [--count 100] [--effects N] [--samples 2000] [--parts 3]

Each case draws a machine (none to three inputs, one to three balances of every kind, with storage and without, autonomous ones,
unstable ones, effects already inside), simulates it with one effect more or none, records it one to three times as records are
(holes, channels that stand still, one sine, drift, spikes, 20 to 2000 samples) and asks compare, estimate, explain and improve of
the first model. Every exception but a refusal (`BadInput`) is a fault; so is an answer that breaks one of `broken`'s rules. N
effects of the catalogue are considered in each case (0: all of them).
"""

from __future__ import annotations

import argparse
import math
import re
import time
import traceback
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

import residuum as rs
from residuum.identification.errors import BadInput
from residuum.identification.physics import (
    Experiment,
    Key,
    PhysicalModel,
    Simulator,
    candidates,
    read_model,
)
from residuum.identification.record import Record

Array = npt.NDArray[np.float64]
FEWEST_SAMPLES, MOST_SAMPLES = 20, 2000
LIMIT = 1e6
"""Size from which on a drawn machine has run away, and is drawn anew."""


@dataclass(frozen=True)
class Balance:
    """A part of a drawn machine: what its file says; `{i}` stands for its number, `{u}` for its input."""

    unit: str
    states: Mapping[str, str]
    parameters: Mapping[str, tuple[float, str]]
    balances: str
    outputs: Mapping[str, tuple[str, str]]
    initial: Mapping[str, float]
    sample_time: float
    drive: float
    driven_only: bool = False


_MASS = {"q{i}": "{unit: m, rate: v{i}}", "v{i}": "{unit: m/s}"}
_SEEN = {"place{i}": ("q{i}", "m"), "pace{i}": ("v{i}", "m/s")}
_AXIS = "axis{i}: {kind: force, storage: M{i} * der(v{i}), terms: {TERMS}, position: q{i}, velocity: v{i}}"
_M, _D, _K = (2.0, "kg"), (3.0, "N*s/m"), (40.0, "N/m")

BALANCES = {
    "sled": Balance(
        "N", _MASS, {"M{i}": _M, "d{i}": _D}, _AXIS.replace("TERMS", "drive: {u}, loss: -d{i} * v{i}"), _SEEN,
        {"q{i}": 0.0, "v{i}": 0.3}, 0.01, 10.0,
    ),
    "spring": Balance(
        "N", _MASS, {"M{i}": _M, "d{i}": _D, "k{i}": _K},
        _AXIS.replace("TERMS", "drive: {u}, loss: -d{i} * v{i}, spring: -k{i} * q{i}"), _SEEN,
        {"q{i}": 0.2, "v{i}": 0.0}, 0.02, 10.0,
    ),
    "unstable": Balance(
        "N", _MASS, {"M{i}": _M, "d{i}": _D, "k{i}": (0.5, "N/m")},
        _AXIS.replace("TERMS", "drive: {u}, loss: -d{i} * v{i}, away: k{i} * q{i}"), _SEEN,
        {"q{i}": 0.001, "v{i}": 0.0}, 0.01, 0.2,
    ),
    "pendulum": Balance(
        "N*m", {"phi{i}": "{unit: rad, rate: w{i}}", "w{i}": "{unit: rad/s}"},
        {"J{i}": (0.02, "kg*m**2"), "G{i}": (0.6, "N*m"), "b{i}": (0.004, "N*m*s/rad")},
        "pivot{i}: {kind: torque, storage: J{i} * der(w{i}), terms: {drive: {u}, weight: -G{i} * sin(phi{i}), "
        "loss: -b{i} * w{i}}, position: phi{i}, velocity: w{i}}",
        {"angle{i}": ("phi{i}", "rad")}, {"phi{i}": 0.6, "w{i}": 0.0}, 0.02, 0.2,
    ),
    "motor": Balance(
        "V", {"w{i}": "{unit: rad/s}"},
        {"J{i}": (0.002, "kg*m**2"), "K{i}": (0.07, "V*s/rad"), "R{i}": (0.8, "ohm"), "b{i}": (0.001, "N*m*s/rad")},
        "shaft{i}: {kind: torque, storage: J{i} * der(w{i}), terms: {motor: K{i} * i{i}, loss: -b{i} * w{i}}, velocity: w{i}}\n"
        "  winding{i}: {kind: voltage, storage: 0, terms: {supply: {u}, drop: -R{i} * i{i}, back: -K{i} * w{i}}, current: i{i}}",
        {"speed{i}": ("w{i}", "rad/s"), "amps{i}": ("i{i}", "A")}, {"w{i}": 0.0}, 0.01, 8.0,
    ),
    "coil": Balance(
        "V", {"i{i}": "{unit: A}"}, {"L{i}": (0.05, "H"), "R{i}": (2.0, "ohm")},
        "coil{i}: {kind: voltage, storage: L{i} * der(i{i}), terms: {supply: {u}, drop: -R{i} * i{i}}, current: i{i}}",
        {"amps{i}": ("i{i}", "A")}, {"i{i}": 1.0}, 0.005, 8.0,
    ),
    "resistor": Balance(
        "V", {}, {"R{i}": (2.0, "ohm")},
        "lead{i}: {kind: voltage, storage: 0, terms: {supply: {u}, drop: -R{i} * i{i}}, current: i{i}}",
        {"amps{i}": ("i{i}", "A")}, {}, 0.005, 8.0, driven_only=True,
    ),
    "oven": Balance(
        "W", {"T{i}": "{unit: °C}"}, {"C{i}": (400.0, "J/K"), "h{i}": (4.0, "W/K"), "A{i}": (20.0, "°C")},
        "room{i}: {kind: heat, storage: C{i} * der(T{i}), terms: {heater: {u}, loss: -h{i} * (T{i} - A{i})}, "
        "temperature: T{i}, ambient: A{i}}",
        {"temp{i}": ("T{i}", "°C")}, {"T{i}": 60.0}, 2.0, 200.0,
    ),
    "tank": Balance(
        "m**3/s", {"l{i}": "{unit: m}"}, {"S{i}": (0.02, "m**2"), "c{i}": (4e-4, "m**2.5/s")},
        "tank{i}: {kind: volume, storage: S{i} * der(l{i}), terms: {inflow: {u}, outflow: -c{i} * sqrt(max(l{i}, 0))}, "
        "level: l{i}}",
        {"level{i}": ("l{i}", "m")}, {"l{i}": 0.4}, 1.0, 3e-4,
    ),
    "signal": Balance(
        "V", {"x{i}": "{unit: V}"}, {"tau{i}": (0.5, "s")},
        "filter{i}: {kind: signal, storage: tau{i} * der(x{i}), terms: {in: {u}, out: -x{i}}}",
        {"y{i}": ("x{i}", "V")}, {"x{i}": 1.0}, 0.05, 5.0,
    ),
}  # fmt: skip
"""Parts by name."""
_DRIVE = re.compile(r"\w+: \{u\}, ")
_SECTIONS = ("inputs", "states", "parameters", "balances", "outputs", "initial")


@dataclass(frozen=True)
class Drawn:
    """A case: the first model's text with the effects that it has already, what the machine has besides, and its records."""

    text: str
    inside: Sequence[Key]
    hidden: Key | None
    records: Sequence[Record]
    effects: Sequence[str] | None

    @property
    def model(self) -> rs.Model:
        """The model that a user has."""
        return rs.Model(_with(read_model(self.text), self.inside))


def drawn(seed: int, effects: int = 0, samples: int = MOST_SAMPLES, parts: int = 3) -> Drawn:
    """The case of a seed; `effects` of the catalogue are considered (0: all), records have at most so many `samples`."""
    rng = np.random.default_rng(seed)
    while True:
        text, drive, step = _machine(rng, parts)
        model = read_model(text)
        inside = _some(rng, model, int(rng.choice([0, 0, 0, 1, 1, 2])))
        truth = _with(_perturbed(rng, model), inside)
        hidden = next(iter(_some(rng, truth, int(rng.random() < 0.6))), None)
        machine = _with(truth, () if hidden is None else (hidden,))
        records = [
            _recorded(rng, machine, drive, step, samples, k)
            for k in range(int(rng.choice([1, 1, 2, 3])))
        ]
        if all(record is not None for record in records):
            there = sorted(
                {key.effect for key in candidates(model)} | {key.effect for key in inside}
            )
            wanted = [str(id) for id in rng.permutation(there)[:effects]] if effects else None
            return Drawn(text, inside, hidden, [r for r in records if r is not None], wanted)


def _machine(rng: np.random.Generator, parts: int) -> tuple[str, dict[str, float], float]:
    """A model file's text, how strongly each input drives, and the sample time of the fastest part."""
    names = [
        str(name) for name in rng.choice(list(BALANCES), min(int(rng.choice([1, 1, 2, 3])), parts))
    ]
    sections: dict[str, list[str]] = {name: [] for name in _SECTIONS}
    drive = {}
    for i, name in enumerate(names):
        part, driven = BALANCES[name], BALANCES[name].driven_only or rng.random() < 0.75
        seen = list(part.outputs.items())[: int(rng.integers(1, len(part.outputs) + 1))]
        said = {
            "inputs": [f"u{i}: {part.unit}"] if driven else [],
            "states": [f"{n}: {s}" for n, s in part.states.items()],
            "parameters": [
                f"{n}: {{value: {v}, unit: {unit}, lower: 0}}"
                for n, (v, unit) in part.parameters.items()
            ],
            "balances": [part.balances if driven else _DRIVE.sub("", part.balances)],
            "outputs": [f"{n}: {{value: {v}, unit: {unit}}}" for n, (v, unit) in seen],
            "initial": [f"{n}: {v}" for n, v in part.initial.items()],
        }
        for section, lines in said.items():
            sections[section] += [
                line.replace("{i}", str(i)).replace("{u}", f"u{i}") for line in lines
            ]
        if driven:
            drive[f"u{i}"] = part.drive
    text = "\n".join(
        f"{name}:\n  " + "\n  ".join(lines) if lines else f"{name}: {{}}"
        for name, lines in sections.items()
    )
    return f"name: drawn\n{text}\n", drive, min(BALANCES[name].sample_time for name in names)


def _perturbed(rng: np.random.Generator, model: PhysicalModel) -> PhysicalModel:
    return model.with_values(
        {n: v * float(rng.uniform(0.8, 1.25)) for n, v in model.values.items() if n[0] not in "A"}
    )


def _some(rng: np.random.Generator, model: PhysicalModel, count: int) -> list[Key]:
    keys = [key for key in candidates(model) if "(" not in key.target]
    return [keys[k] for k in rng.choice(len(keys), min(count, len(keys)), replace=False)]


def _with(model: PhysicalModel, keys: Sequence[Key]) -> PhysicalModel:
    for key in keys:
        model = model.with_effect(*key)
    return model


def _profile(rng: np.random.Generator, n: int, amplitude: float) -> Array:
    t = np.arange(n)
    kind = rng.choice(["steps", "sine", "noise", "still", "ramp", "switched"])
    one_way = rng.random() < 0.3
    shape = {
        "steps": lambda: rng.normal(size=12)[t * 12 // n],
        "sine": lambda: np.sin(2 * np.pi * t / max(n // 5, 4)),
        "noise": lambda: rng.normal(size=n),
        "still": lambda: np.full(n, 0.7),
        "ramp": lambda: t / n,
        "switched": lambda: np.sign(np.sin(2 * np.pi * t / max(n // 7, 4)) + 0.3),
    }[str(kind)]()
    return np.asarray(amplitude * (np.abs(shape) if one_way else shape))


def _recorded(
    rng: np.random.Generator,
    machine: PhysicalModel,
    drive: Mapping[str, float],
    step: float,
    samples: int,
    number: int,
) -> Record | None:
    """One record of the machine as it comes; None where the machine runs away."""
    n = int(np.exp(rng.uniform(np.log(FEWEST_SAMPLES), np.log(samples))))
    U = np.column_stack(
        [np.zeros((n, 0)), *(_profile(rng, n, drive[name]) for name in machine.inputs)]
    )
    experiment = Experiment(
        U, np.full((n, len(machine.outputs)), np.nan), np.zeros(len(machine.inputs)), step
    )
    run = Simulator(machine).run(experiment)
    if not run.finite or not np.all(np.abs(run.Y) < LIMIT):
        return None
    channels = {name: U[:, k] for k, name in enumerate(machine.inputs)}
    for k, name in enumerate(machine.outputs):
        y = run.Y[:, k]
        size = float(np.std(y)) or float(np.abs(y).max()) or 1.0
        noise = rng.normal(size=n)
        coloured = noise if rng.random() < 0.7 else np.cumsum(noise) / np.sqrt(n)
        y = y + size * float(rng.choice([0.0, 0.002, 0.02, 0.1])) * coloured
        habit = rng.choice(
            ["plain", "plain", "plain", "holes", "still", "drift", "spikes", "rounded", "held"]
        )
        at = rng.integers(0, n, max(n // 30, 1))
        if habit == "holes":
            y[at] = np.nan
        elif habit == "still":
            y[:] = y[0]
        elif habit == "drift":
            y += size * np.arange(n) / n
        elif habit == "spikes":
            y[at[:3]] += 20.0 * size
        elif habit == "rounded":
            y = np.round(y / (0.05 * size)) * 0.05 * size
        elif habit == "held":
            y[n // 3 : n // 2] = y[n // 3]
        channels[name] = y
    units = {
        name: signal.unit for name, signal in [*machine.inputs.items(), *machine.outputs.items()]
    }
    return Record(
        {name: np.asarray(v) for name, v in channels.items()}, units, step, source=f"drawn {number}"
    )


def broken(case: Drawn, answers: Mapping[str, Any]) -> Iterator[str]:
    """The rules that the answers break."""
    for name, answer in answers.items():
        yield from (f"{name}: {what}" for what in _no_number(answer.to_dict()))
        text = str(answer)
        yield from (
            f"{name}: prints {word}"
            for word in ("nan", "inf ", "1j")
            if word in text.lower().split()
        )
    if (why := answers.get("explain")) is not None:
        said = why.to_dict()
        total = said["probability_nothing_missing"] + said["probability_unknown_effect"]
        total += sum(c["probability"] for c in said["candidates"])
        if not -1e-9 <= total <= 1.0 + 1e-6:
            yield f"explain: probabilities sum to {total}"
    if (better := answers.get("improve")) is not None:
        errors = [step["error"] for step in better.history]
        if errors and errors[-1] > errors[0] * 1.002:
            yield f"improve: the error on data kept aside rose, {errors[0]:.4g} -> {errors[-1]:.4g}"
        if better.verdict == "adequate" and better.model.compare(list(case.records)).structured:
            yield "improve: says adequate where compare finds structure"


def _no_number(said: Any, where: str = "") -> Iterator[str]:
    if isinstance(said, Mapping):
        for key, value in said.items():
            yield from _no_number(value, f"{where}.{key}")
    elif isinstance(said, list | tuple):
        for value in said:
            yield from _no_number(value, where)
    elif isinstance(said, complex) or (isinstance(said, float) and math.isnan(said)):
        yield f"{where[1:]} is {said}"


def asked(case: Drawn) -> tuple[dict[str, Any], dict[str, str]]:
    """The answers of each question that gave one, and the refusals of the others."""
    questions = {
        "compare": lambda: case.model.compare(list(case.records)),
        "estimate": lambda: case.model.estimate(list(case.records)),
        "explain": lambda: case.model.explain(list(case.records), effects=case.effects),
        "improve": lambda: case.model.improve(list(case.records), effects=case.effects),
    }
    answers, refused = {}, {}
    for name, question in questions.items():
        try:
            answers[name] = question()
        except BadInput as error:
            refused[name] = str(error)
    return answers, refused


def main() -> None:
    arguments = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    arguments.add_argument("--first", type=int, default=0)
    arguments.add_argument("--count", type=int, default=100)
    arguments.add_argument("--effects", type=int, default=5)
    arguments.add_argument("--samples", type=int, default=MOST_SAMPLES)
    arguments.add_argument("--parts", type=int, default=3)
    given, faults, told = arguments.parse_known_args()[0], 0, 0
    for seed in range(given.first, given.first + given.count):
        began, case = time.process_time(), drawn(seed, given.effects, given.samples, given.parts)
        try:
            answers, refused = asked(case)
            wrong = list(broken(case, answers))
        except Exception:
            answers, refused, wrong = {}, {}, []
            faults += 1
            print(f"seed {seed}: FAULT\n{traceback.format_exc()}", flush=True)
        told += bool(wrong)
        what = f"{[r.n for r in case.records]} samples, hidden {case.hidden}, inside {[str(k) for k in case.inside]}"
        print(
            f"seed {seed}: {what}, {len(answers)} answers, {time.process_time() - began:.1f} s {refused or ''}",
            flush=True,
        )
        for line in wrong:
            print(f"  BROKEN {line}", flush=True)
    print(f"{given.count} cases: {faults} faults, {told} with a broken rule")


if __name__ == "__main__":
    main()
