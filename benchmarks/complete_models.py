"""Models that lack nothing, on records that have the faults of recording: is any effect blamed?

    python -m benchmarks.complete_models [--first 0] [--count 100] [--effects N] [--samples 1000] [--parts 2]

Each case draws a machine (`drawn_answers`), simulates it with values other than those of the file, adds noise, and records it
with one fault of recording: a clock that runs 1 in 5000 wrong and whose stamps jitter, twelve rows far beside their neighbours,
a span in which a sensor repeats its last value, or the hour that summer time takes away or gives back. Blamed is a model of
which explain names an effect with a probability above one half.
"""

from __future__ import annotations

import argparse
import datetime
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

import residuum as rs
from benchmarks import drawn_answers
from residuum.identification.errors import BadInput
from residuum.identification.physics import (
    Experiment,
    PhysicalModel,
    Simulator,
    candidates,
    read_model,
)
from residuum.identification.record import Record
from residuum.identification.record_formats.loggers.logger_file import understand
from residuum.identification.record_formats.loggers.logger_mapping import parse_logger

Array = npt.NDArray[np.float64]
FAULTS = ("clock", "outliers", "held", "summer time begins", "summer time ends")
FEWEST_SAMPLES = 300
NOISE = (0.002, 0.02, 0.1)
"""Sizes of the noise, parts of an output's standard deviation."""
CODES = (-127.0, 85.0, -999.9, 850.0)


def drawn(
    seed: int, parts: int, samples: int
) -> tuple[str, PhysicalModel, dict[str, Array], dict[str, str], float]:
    """A model file's text, the machine, its channels, their units and the sample time."""
    rng = np.random.default_rng(seed)
    while True:
        text, drive, step = drawn_answers._machine(rng, parts)
        model = read_model(text)
        machine = drawn_answers._perturbed(rng, model)
        n = int(rng.integers(FEWEST_SAMPLES, samples))
        U = np.column_stack(
            [
                np.zeros((n, 0)),
                *(drawn_answers._profile(rng, n, drive[name]) for name in machine.inputs),
            ]
        )
        run = Simulator(machine).run(
            Experiment(
                U, np.full((n, len(machine.outputs)), np.nan), np.zeros(len(machine.inputs)), step
            )
        )
        if (
            not run.finite
            or not np.all(np.abs(run.Y) < drawn_answers.LIMIT)
            or not np.all(np.std(run.Y, axis=0) > 1e-9 * np.abs(run.Y).max(axis=0))
        ):
            continue
        size = np.std(run.Y, axis=0)
        Y = run.Y + float(rng.choice(NOISE)) * size * rng.normal(size=run.Y.shape)
        signals = [*machine.inputs.items(), *machine.outputs.items()]
        channels = {
            name: np.column_stack([U, Y])[:, k].copy() for k, (name, _) in enumerate(signals)
        }
        return text, machine, channels, {name: signal.unit for name, signal in signals}, step


def recorded(
    seed: int,
    fault: str,
    machine: PhysicalModel,
    channels: dict[str, Array],
    units: dict[str, str],
    step: float,
    folder: Path,
) -> Sequence[Record]:
    """The record with its fault, as a user gets it: through a file where time is at fault."""
    rng = np.random.default_rng([seed, 1])
    n = len(next(iter(channels.values())))
    name = str(rng.choice(list(machine.outputs)))
    if fault == "outliers":
        rows = rng.choice(n, 12, replace=False)
        far = 30.0 * np.std(channels[name]) * rng.choice([-1.0, 1.0], 12)
        channels[name][rows] = (
            channels[name][rows] + far if rng.random() < 0.5 else float(rng.choice(CODES))
        )
    if fault == "held":
        begin, length = int(rng.integers(n // 10, n // 2)), int(rng.integers(n // 20, n // 6))
        channels[name][begin : begin + length] = channels[name][begin]
    if fault in ("outliers", "held"):
        return [Record(channels, units, step, source=f"complete {seed}")]
    t = step * np.arange(n)
    if fault == "clock":
        stamps = [f"{x:.9g}" for x in t * 1.0002 + 0.02 * step * rng.normal(size=n)]
        return [rs.read(_written(folder, stamps, "time [s]", channels, units), resample=True)]
    change = (
        datetime.datetime(2024, 3, 31, 2)
        if fault == "summer time begins"
        else datetime.datetime(2024, 10, 27, 3)
    )
    middle = t[int(rng.integers(n // 4, 3 * n // 4))]
    hour = datetime.timedelta(hours=1 if fault == "summer time begins" else -1)
    local = [
        change + datetime.timedelta(seconds=x - middle) + (hour if x >= middle else 0 * hour)
        for x in t
    ]
    path = _written(folder, [f"{at:%Y-%m-%d %H:%M:%S.%f}" for at in local], "time", channels, units)
    content = path.read_bytes()
    mapping = understand(content, str(path)).mapping
    return [parse_logger(content, str(path), replace(mapping, reordered="bridge"))]


def _written(
    folder: Path, stamps: list[str], head: str, channels: dict[str, Array], units: dict[str, str]
) -> Path:
    names = [f"{name} [{units[name]}]" if units[name] else name for name in channels]
    rows = zip(
        stamps, *([f"{x:.12g}" for x in values] for values in channels.values()), strict=True
    )
    path = folder / "record.csv"
    path.write_text(
        "\n".join([",".join([head, *names]), *(",".join(row) for row in rows)]) + "\n",
        encoding="utf-8",
    )
    return path


def main() -> None:
    arguments = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    arguments.add_argument("--first", type=int, default=0)
    arguments.add_argument("--count", type=int, default=100)
    arguments.add_argument("--effects", type=int, default=0)
    arguments.add_argument("--samples", type=int, default=1000)
    arguments.add_argument("--parts", type=int, default=2)
    given, verdicts = arguments.parse_known_args()[0], Counter[str]()
    for seed in range(given.first, given.first + given.count):
        fault, began = FAULTS[seed % len(FAULTS)], time.process_time()
        try:
            said = judged(seed, fault, given.effects, given.samples, given.parts)
        except Exception:
            said = f"FAULT {traceback.format_exc()}"
        verdicts[said.split()[0]] += 1
        print(f"seed {seed}: {fault}: {said} ({time.process_time() - began:.1f} s)", flush=True)
    print(dict(verdicts))


def judged(seed: int, fault: str, effects: int, samples: int, parts: int) -> str:
    """`none` where nothing is said to be missing, `unknown`, `blamed` with the effects, or `refused` with the reason."""
    text, machine, channels, units, step = drawn(seed, parts, samples)
    there = sorted({key.effect for key in candidates(machine)})
    wanted = (
        [str(id) for id in np.random.default_rng(seed).permutation(there)[:effects]]
        if effects
        else None
    )
    with tempfile.TemporaryDirectory() as folder:
        records = recorded(seed, fault, machine, channels, units, step, Path(folder))
    try:
        why = rs.Model(read_model(text)).explain(records, effects=wanted)
    except BadInput as error:
        return f"refused {error}"
    said = why.to_dict()
    named = [
        f"{c['effect']}@{c['balance']} {c['probability']:.2f}"
        for c in said["candidates"]
        if c["probability"] > 0.5
    ]
    if named:
        return f"blamed {named}"
    return (
        "none"
        if said["probability_nothing_missing"] > 0.5
        else f"unknown {said['probability_unknown_effect']:.2f}"
    )


if __name__ == "__main__":
    main()
