"""Models that engineers published, written as model files: do they simulate as their equations do, and is what they lack named?

    python -m benchmarks.published_models [NAME…] [--seed 0]

Each file of `published_models/` stands for a publication that its notes name. It is simulated beside `published_equations`,
which solves the same equations by LSODA at a relative tolerance of 1e-10; told is the largest difference of an output, as part of
the span of that output, at as many steps a sample as are allowed. Then the solver's machine hides an effect, its noisy record
is explained by the file, and told is whether the hidden effect is the first candidate or in its group.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np

import residuum as rs
from benchmarks.published_equations import PLANTS, Plant
from residuum.identification.physics import Experiment, PhysicalModel, Simulator, load_model
from residuum.identification.physics.simulate.simulation import MOST_SUBSTEPS
from residuum.identification.record import Record

FILES = Path(__file__).parent / "published_models"
AGREEMENT = 1e-6


def model_of(name: str) -> PhysicalModel:
    return load_model(FILES / f"{name}.yaml")


def difference(name: str, seed: int = 0) -> float:
    """Largest difference between the file's outputs and the equations', as part of each output's span."""
    plant, simulator = PLANTS[name], Simulator(model_of(name))
    U = plant.driven(seed)
    Y = plant.simulated(U, 0.0)
    still = np.zeros(U.shape[1])
    experiment = Experiment(U, np.full_like(Y, np.nan), still, plant.sample_time)
    run = simulator.run(experiment, plant.start, substeps=MOST_SUBSTEPS)
    return float(np.max(np.abs(run.Y - Y) / np.ptp(Y, axis=0)))


def hidden_record(name: str, seed: int = 0) -> Record:
    """What the machine with its hidden effect shows, with noise."""
    plant, model = PLANTS[name], model_of(name)
    U = plant.driven(seed)
    Y = plant.simulated(U, plant.size)
    rng = np.random.default_rng([seed, 1])
    Y += plant.noise * np.std(Y, axis=0) * rng.normal(size=Y.shape)
    signals = [*model.inputs.values(), *model.outputs.values()]
    channels = {s.name: np.column_stack([U, Y])[:, k].copy() for k, s in enumerate(signals)}
    units = {s.name: s.unit for s in signals}
    return Record(channels, units, plant.sample_time, source=f"{name}, {plant.hidden}")


def named(plant: Plant, why: rs.Explanation) -> str:
    """By the first candidate: `named` at its place, in its `group`, named `elsewhere`, or `missed`."""
    effect, first = plant.hidden.split("@")[0], why.best
    if first is None or why.verdict != "missing-effect":
        return "missed"
    if str(first.key) == plant.hidden:
        return "named"
    if effect in first.indistinguishable_from:
        return "group"
    return "elsewhere" if first.effect == effect else "missed"


def main() -> None:
    arguments = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    arguments.add_argument("names", nargs="*")
    arguments.add_argument("--seed", type=int, default=0)
    given = arguments.parse_known_args()[0]
    chosen = [name for name in given.names if name in PLANTS] or list(PLANTS)
    print("| model | difference | hidden | answer | first candidate | group | seconds |")
    print("|---|---|---|---|---|---|---|")
    told = [_told(name, given.seed) for name in chosen]
    agree = sum(one <= AGREEMENT for one, _ in told)
    right = sum(answer in ("named", "group") for _, answer in told)
    print(f"\nAgree to {AGREEMENT:g}: {agree} of {len(told)}; named or in the group: {right}")


def _told(name: str, seed: int) -> tuple[float, str]:
    plant, apart, began = PLANTS[name], difference(name, seed), time.perf_counter()
    why = rs.model(FILES / f"{name}.yaml").explain(hidden_record(name, seed))
    seconds, first = time.perf_counter() - began, why.best
    answer = named(plant, why)
    found = f"{first.effect}@{first.balance} {first.probability:.2f}" if first else why.verdict
    group = ", ".join(first.indistinguishable_from) if first else ""
    cells = [name, f"{apart:.1e}", plant.hidden, answer, found, group, f"{seconds:.0f}"]
    print(f"| {' | '.join(cells)} |", flush=True)
    return apart, answer


if __name__ == "__main__":
    main()
