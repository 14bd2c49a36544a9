"""Residuals and control of random plants of two inputs and two outputs: false alarms, faults named, loops certified.

python -m benchmarks.multivariable --plants 20
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from benchmarks.identification import random_system
from residuum.diagnosis.residuals.multivariable import design_multivariable_residual
from residuum.diagnosis.residuals.multivariable_detection import (
    MultivariableDetection,
    detect_multivariable,
)
from residuum.identification.errors import BadInput
from residuum.identification.kernel_based.multivariable import (
    MultivariableModel,
    identify_multivariable,
)
from residuum.identification.record import Record
from residuum.robust_control.control_problem import Wishes
from residuum.robust_control.multivariable_control import MultivariableProblem, closed_loop_steps
from residuum.robust_control.synthesis.constrained_structure import PIDN
from residuum.robust_control.weights.performance_weight import Infeasible

SAMPLES, LAGS, HEALTHY = 2000, 80, 5
INPUTS, OUTPUTS = ("u0", "u1"), ("y0", "y1")
RATE = 1e-4
"""False alarms a sample that are asked for."""
FRESH, FOLLOWED = 400, 1500
Path = tuple[np.ndarray, np.ndarray]


@dataclass(frozen=True)
class Plant:
    """Four paths, outputs by inputs, of unit static gain times `gains`, with white noise of deviation `noise` on each output."""

    seed: int
    paths: tuple[tuple[Path, Path], tuple[Path, Path]]
    noise: tuple[float, float]

    def record(
        self,
        stream: int,
        sensor: tuple[int, float] | None = None,
        actuator: tuple[int, float] | None = None,
    ) -> Record:
        """White inputs; a fault begins in the middle."""
        rng = np.random.default_rng([self.seed, stream])
        u = rng.standard_normal((2, 2 * SAMPLES))
        acting = u.copy()
        if actuator is not None:
            acting[actuator[0], SAMPLES + SAMPLES // 2 :] += actuator[1]
        channels = {name: one[SAMPLES:] for name, one in zip(INPUTS, u, strict=True)}
        for i, row in enumerate(self.paths):
            y = sum(lfilter(b, a, v) for (b, a), v in zip(row, acting, strict=True))[SAMPLES:]
            y = y + self.noise[i] * rng.standard_normal(SAMPLES)
            if sensor is not None and sensor[0] == i:
                y[SAMPLES // 2 :] += sensor[1]
            channels[OUTPUTS[i]] = y
        return Record(channels, dict.fromkeys(channels, ""), 1.0, source=f"plant {self.seed}")

    def identified(self) -> MultivariableModel:
        """The kernel model of one record."""
        return identify_multivariable(self.record(0), INPUTS, OUTPUTS, order=LAGS)

    def taps(self, length: int) -> np.ndarray:
        """True impulse responses from lag 0 on, shape (1, 2, 2, length)."""
        impulse = np.eye(1, length)[0]
        return np.array([[lfilter(b, a, impulse) for b, a in row] for row in self.paths])[None]


def plants(first: int, ratio: float) -> Iterator[Plant]:
    """Random plants, one after the other; those that are nearly singular at rest are passed over."""
    seed = first
    while True:
        rng = np.random.default_rng(seed)
        systems = [random_system(rng) for _ in range(4)]
        scale = rng.uniform(0.4, 1.0, 4) * np.array(
            [1.0, rng.choice([-1, 1]) * 0.6, rng.choice([-1, 1]) * 0.6, 1.0]
        )
        made = []
        for (b, a), factor in zip(systems, scale, strict=True):
            gain = float(np.sum(b) / np.sum(a))
            made.append((b * factor / gain, a) if abs(gain) > 0.3 else None)
        seed += 1
        gains = scale.reshape(2, 2)
        if None in made or abs(np.linalg.det(gains)) < 0.2:
            continue
        rows = ((made[0], made[1]), (made[2], made[3]))
        rest = Plant(seed - 1, rows, (0.0, 0.0)).record(99)
        noise = tuple(float(np.std(rest[name]) / np.sqrt(ratio)) for name in OUTPUTS)
        yield Plant(seed - 1, rows, noise)


def _named(found: MultivariableDetection, kind: str, place: str, size: float) -> Sequence[str]:
    if found.fault is None:
        return ["missed"]
    one = found.fault
    right = (one.hypothesis.kind, one.hypothesis.name) == (kind, place)
    alike = (kind, place) in [(other.kind, other.name) for other in one.indistinguishable_from]
    told = ["found", "named" if right else "alike" if alike else "misnamed"]
    if right:
        told.append("in its band" if abs(one.value - size) < 1.96 * one.std else "outside")
    return told


def _residuals(plant: Plant, model: MultivariableModel, tally: Counter[str]) -> None:
    design = design_multivariable_residual(model, [plant.record(0)])
    for k in range(HEALTHY):
        found = detect_multivariable(
            design, plant.record(10 + k), false_alarms_per_day=RATE * 86400
        )
        tally["healthy"] += 1
        tally["alarmed"] += found.alarm.any()
        tally["expected"] += 1 - np.exp(-RATE * found.residual.valid.sum())
    for i, name in enumerate(OUTPUTS):
        size = 0.5 * plant.noise[i]
        tally.update(
            f"sensor {what}"
            for what in _named(
                detect_multivariable(design, plant.record(20 + i, sensor=(i, size))),
                "sensor",
                name,
                size,
            )
        )
    for j, name in enumerate(INPUTS):
        tally.update(
            f"actuator {what}"
            for what in _named(
                detect_multivariable(design, plant.record(30 + j, actuator=(j, 0.3))),
                "actuator",
                name,
                0.3,
            )
        )


def _control(plant: Plant, model: MultivariableModel, tally: Counter[str]) -> str:
    problem = MultivariableProblem(model, plant.seed)
    try:
        found = problem.solve(PIDN(1.0), Wishes())
    except (Infeasible, BadInput) as no:
        tally["refused"] += 1
        return f"refused: {str(no)[:90]}"
    tally["designed"] += 1
    tally["certified"] += found.certified
    fresh = problem.drawn(FRESH, 77)
    ends = [
        closed_loop_steps(fresh, found.decoupler, found.controllers, i, FOLLOWED)[:, -1]
        for i in (0, 1)
    ]
    goals = np.eye(2)
    tally["fresh"] += FRESH
    tally["fresh unstable"] += int(
        np.sum(
            [np.abs(end - goal).max(axis=1) > 0.05 for end, goal in zip(ends, goals, strict=True)]
        )
    )
    truth = [
        closed_loop_steps(plant.taps(400), found.decoupler, found.controllers, i, FOLLOWED)[0]
        for i in (0, 1)
    ]
    tally["truth stable"] += all(
        np.abs(y[-1] - goal).max() < 0.05 for y, goal in zip(truth, goals, strict=True)
    )
    seen = problem.measured(found)
    tally["loops"] += 2
    tally["kept"] += sum(
        one.own.kept(point.first, point.second)[0]
        for one, point in zip(seen, found.points, strict=True)
    )
    coupling = [float(np.abs(truth[i][:, 1 - i]).max()) for i in (0, 1)]
    reach = [float(np.quantile(one.drawn_coupling, 0.95)) for one in seen]
    tally["coupling held"] += sum(c < 1.1 * r + 0.02 for c, r in zip(coupling, reach, strict=True))
    bounds = ", ".join(f"{bound:.2f}" for bound in found.bounds)
    settled = ", ".join(f"{one.own.nominal.settling_time:.3g}" for one in seen)
    return f"bounds {bounds}; settling {settled}; coupling {coupling[0]:.2f}, {coupling[1]:.2f}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--plants", type=int, default=20)
    parser.add_argument("--first", type=int, default=9000)
    parser.add_argument(
        "--ratio", type=float, default=10.0, help="variance of the outputs over that of their noise"
    )
    given = parser.parse_args()
    tally: Counter[str] = Counter()
    print("| plant | relative gain | control | CPU [s] |\n|---|---|---|---|")
    for _, plant in zip(range(given.plants), plants(given.first, given.ratio), strict=False):
        begun = time.process_time()
        model = plant.identified()
        _residuals(plant, model, tally)
        told = _control(plant, model, tally)
        gain = MultivariableProblem(model).relative_gains[0, 0]
        print(
            f"| {plant.seed} | {gain:.2f} | {told} | {time.process_time() - begun:.0f} |",
            flush=True,
        )
    print("\n| what | of how many |\n|---|---|")
    print(
        f"| healthy records alarmed | {tally['alarmed']} of {tally['healthy']} ({tally['expected']:.1f} by the rate asked for) |"
    )
    for kind in ("sensor", "actuator"):
        found, named = tally[f"{kind} found"], tally[f"{kind} named"]
        print(f"| {kind} offsets found | {found} of {found + tally[f'{kind} missed']} |")
        print(f"| … of these named | {named} of {found}; told as alike {tally[f'{kind} alike']} |")
        print(f"| … size in its 95 % band | {tally[f'{kind} in its band']} of {named} |")
    print(
        f"| designs (refused {tally['refused']}) certified | {tally['certified']} of {tally['designed']} |"
    )
    print(
        f"| steps of fresh plants that do not end where they should | {tally['fresh unstable']} of {2 * tally['fresh']} |"
    )
    print(f"| true plants stable | {tally['truth stable']} of {tally['designed']} |")
    print(
        f"| promises of overshoot and settling kept by the nominal whole | {tally['kept']} of {tally['loops']} |"
    )
    print(
        f"| true interaction within what 95 % of plants reach | {tally['coupling held']} of {tally['loops']} |"
    )


if __name__ == "__main__":
    main()
