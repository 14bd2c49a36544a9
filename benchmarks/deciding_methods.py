"""The source's method against ours as the one that decides, on exemplars and records that were not trained on.

gate-actuator: the support vector machine on F1 and F2 against limits in shaft angle; half of the simulated exemplars train, the
others are judged. robust-residual: Algorithm 6 with its automatic threshold against the likelihood-ratio test, on (4.10).

python -m benchmarks.deciding_methods --exemplars 12 --movements 3 --records 20
python -m benchmarks.deciding_methods --tooth-errors 0.3 --records 0      # gears of ISO 1328 grade 9, the gate alone
"""

from __future__ import annotations

import argparse
from collections import Counter

import numpy as np
from scipy.signal import lfilter

from residuum.diagnosis.diagnosers.base import Diagnoser
from residuum.diagnosis.diagnosers.gate_actuator import GateActuator
from residuum.diagnosis.diagnosers.robust_residual import RobustResidual
from residuum.diagnosis.finding import Verdict
from residuum.identification.linear_models.transfer_function import TransferFunction
from residuum.identification.record import Record
from residuum.simulation import MACHINES

FAULTS = {
    None: "healthy",
    "gear-notch": "pinion-or-gear",
    "pinion-tooth": "pinion-or-gear",
    "rack-tooth": "rack",
}
PERIOD, PAUSE = 19.5, 8.0
PLANT = TransferFunction(np.array([47619.0]), np.array([1.0, 234.0136, 6857.1, 5442.2])).discretise(
    0.1
)
SAMPLES, JUDGED, ONSET = 5000, 2000, 1000
OFFSETS = (0.0, 0.5, 1.0, 3.0, 30.0)


def gate_record(exemplar: int, fault: str | None, movements: int, tooth_errors: float) -> Record:
    """The first movements of an exemplar's life."""
    faults = {fault: None} if fault else {}
    machine = MACHINES["gate-actuator"](
        seed=1000 + exemplar, exemplar=exemplar, faults=faults, tooth_errors=tooth_errors
    )
    signals = machine.simulate(movements * PERIOD + PAUSE)
    return Record(signals.channels, signals.units, signals.sample_time)


def gate(exemplars: int, movements: int, tooth_errors: float = 1.0) -> None:
    """Movements judged right, by class and method."""
    half = exemplars // 2
    training = [
        (gate_record(e, fault, movements, tooth_errors), label, e)
        for e in range(half)
        for fault, label in FAULTS.items()
    ]
    records, labels, groups = zip(*training, strict=True)
    trained = GateActuator().fit(records, labels, groups)
    right: Counter[tuple[str, str | None]] = Counter()
    total: Counter[str | None] = Counter()
    for exemplar in range(half, exemplars):
        for fault, label in FAULTS.items():
            for movement in trained.score(
                gate_record(exemplar, fault, movements, tooth_errors)
            ).evidence["movements"]:
                if movement["class"] == "not-assessable":
                    continue
                total[fault] += 1
                right["source", fault] += movement["source_class"] == label
                right["default", fault] += movement["class"] == label
    print(
        f"gate-actuator, tooth errors {tooth_errors:g}: {half} exemplars trained, {exemplars - half} others judged;",
        end=" ",
    )
    print("movements with the right class [%]\n")
    print(
        "| method | "
        + " | ".join(f"{fault or 'healthy'} ({total[fault]})" for fault in FAULTS)
        + " |"
    )
    print("|---" * (len(FAULTS) + 1) + "|")
    for method in ("source", "default"):
        print(
            f"| {method} | "
            + " | ".join(f"{100 * right[method, fault] / total[fault]:.1f}" for fault in FAULTS)
            + " |"
        )


def plant_record(rng: np.random.Generator, n: int, offset: float) -> Record:
    """White input of variance 1 through (4.10), SNR 9, a sensor offset from `ONSET` on."""
    u = rng.standard_normal(n + 1000)
    y = (
        lfilter(np.r_[0.0, PLANT.num], PLANT.den, u)
        if len(PLANT.num) < len(PLANT.den)
        else PLANT.simulate(u)
    )
    y = y + np.std(y) / 3.0 * rng.standard_normal(len(y))
    y = y[1000:]
    y[ONSET:] += offset * np.std(y)
    return Record({"u": u[1000:], "y": y}, {"u": "", "y": ""}, 0.1)


def residual(records: int) -> None:
    """Records called faulty by each method, an offset (in standard deviations of y) a column."""
    found: Counter[tuple[str, float]] = Counter()
    for k in range(records):
        rng = np.random.default_rng([4, k])
        trained = RobustResidual().fit([plant_record(rng, SAMPLES, 0.0)])
        both: list[Diagnoser] = [trained, trained.with_settings(method="source")]
        for offset in OFFSETS:
            record = plant_record(rng, JUDGED, offset)
            for judge in both:
                found[judge.method, offset] += judge.score(record).verdict is Verdict.FAULTY
    print(
        f"\nrobust-residual: (4.10), SNR 9, {records} identifications; records called faulty [%], offset in deviations of y\n"
    )
    print(
        "| method | "
        + " | ".join("healthy" if not offset else f"offset {offset:g}" for offset in OFFSETS)
        + " |"
    )
    print("|---" * (len(OFFSETS) + 1) + "|")
    for method in ("source", "default"):
        print(
            f"| {method} | "
            + " | ".join(f"{100 * found[method, offset] / records:.0f}" for offset in OFFSETS)
            + " |"
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--exemplars", type=int, default=12)
    parser.add_argument("--movements", type=int, default=3)
    parser.add_argument("--records", type=int, default=20)
    parser.add_argument(
        "--tooth-errors",
        type=float,
        default=1.0,
        help="of the simulated gears; 0.3 is ISO 1328 grade 9",
    )
    given = parser.parse_args()
    gate(given.exemplars, given.movements, given.tooth_errors)
    if given.records:
        residual(given.records)


if __name__ == "__main__":
    main()
