"""Gate actuator: accuracy on actuators never seen, false alarms, a growing notch, speed; currents of a real motor.

Movements come from the simulated actuator (`residuum.simulation`), whose settings were fixed before the features were.
Run `python -m benchmarks gate_actuator`; set GATE_HEALTHY to change the number of healthy movements an unseen exemplar
(default 10).
"""

import os
import statistics
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from residuum.diagnosis.diagnosers.gate_actuator import GateActuator as Diagnoser
from residuum.diagnosis.gate.actuator_model import ActuatorConstants
from residuum.diagnosis.gate.gate_baseline import GateBaseline, TrainingMovement
from residuum.diagnosis.gate.movement_features import MovementFeatures, movement_features
from residuum.diagnosis.gate.movements import average_profile, cut_movements
from residuum.diagnosis.learning.diagnoser_validation import (
    Validation,
    balanced_accuracy,
    learning_curve,
    mixed_folds,
    object_wise,
    proportion_interval,
)
from residuum.diagnosis.residuals.fault_isolation import (
    HEALTHY,
    PINION_OR_GEAR,
    RACK,
    isolation_classifier,
    source_classifier,
)
from residuum.identification.record import Record
from residuum.simulation import MACHINES

CLASS_OF = {
    None: HEALTHY,
    "gear-notch": PINION_OR_GEAR,
    "pinion-tooth": PINION_OR_GEAR,
    "rack-tooth": RACK,
}
CLASSES = (HEALTHY, PINION_OR_GEAR, RACK)
TRAINED, UNSEEN = range(20), range(20, 60)
HEALTHY_MOVEMENTS, FAULTY_MOVEMENTS = int(os.environ.get("GATE_HEALTHY", "10")), 3
_CONSTANTS = ActuatorConstants()


@dataclass(frozen=True)
class Observed:
    """One simulated movement: its exemplar, fault id (None healthy), features and travel."""

    exemplar: int
    fault: str | None
    features: MovementFeatures
    travel: float

    @property
    def label(self) -> str:
        return CLASS_OF[self.fault]


def movements_of(
    exemplar: int, fault: str | None, count: int, size: float | None = None, seed: int = 0
) -> Iterator[Record]:
    """The first whole movements of an actuator's life, one record each."""
    machine = MACHINES["gate-actuator"](
        seed=seed, exemplar=exemplar, faults={fault: size} if fault else {}
    )
    # a movement with its pause takes at most 19.5 s, 1 s before the first
    signals = machine.simulate((count - 1) * 19.5 + 19.0)
    record = Record(signals.channels, signals.units, signals.sample_time)
    for movement in cut_movements(record)[:count]:
        yield record.window(movement.start, movement.start + movement.n)


def observe(
    exemplar: int, fault: str | None, count: int, size: float | None = None, seed: int | None = None
) -> list[Observed]:
    observed = []
    for record in movements_of(
        exemplar, fault, count, size, seed=1000 + exemplar if seed is None else seed
    ):
        movement = cut_movements(record)[0]
        features = movement_features(movement, _CONSTANTS)
        observed.append(Observed(exemplar, fault, features, float(movement.motor_angle[-1])))
    return observed


def observe_all(exemplars: range) -> list[Observed]:
    return [
        one
        for exemplar in exemplars
        for fault in CLASS_OF
        for one in observe(exemplar, fault, FAULTY_MOVEMENTS if fault else HEALTHY_MOVEMENTS)
    ]


def trained(observed: list[Observed]) -> GateBaseline:
    movements = [
        TrainingMovement(one.features, one.label, one.exemplar, one.travel) for one in observed
    ]
    return GateBaseline.of(movements, _CONSTANTS, 5000.0)


def predict(baseline: GateBaseline, observed: list[Observed]) -> Validation:
    predicted = [baseline.judge(one.features).fault_class or HEALTHY for one in observed]
    return Validation(
        np.array([one.label for one in observed]),
        np.array(predicted),
        np.array([one.exemplar for one in observed]),
    )


def folds_object_wise(observed: list[Observed], folds: int = 10) -> Validation:
    """The whole baseline trained without a tenth of the exemplars, which it then judges; every exemplar is judged once."""
    exemplars = sorted({one.exemplar for one in observed})
    parts = []
    for k in range(folds):
        held_out = set(exemplars[k::folds])
        baseline = trained([one for one in observed if one.exemplar not in held_out])
        parts.append(predict(baseline, [one for one in observed if one.exemplar in held_out]))
    fields = ("truth", "predicted", "objects")
    return Validation(
        *(np.concatenate([getattr(part, field) for part in parts]) for field in fields)
    )


def percent(value: float) -> str:
    return f"{100 * value:.2f} %"


def report_validation(name: str, validation: Validation) -> None:
    low, high = validation.interval(balanced_accuracy)
    bounds = f"{percent(low)}–{percent(high)}"
    print(
        f"| {name} | {percent(validation.accuracy)} | {percent(validation.balanced_accuracy)} | {bounds} |"
    )


def report_confusion(validation: Validation) -> None:
    labels = [*CLASSES, "unknown"]
    print(
        f"\nrows said, columns true ({len(np.unique(validation.objects))} exemplars)\n\n| | {' | '.join(CLASSES)} |\n|---|"
        + "---|" * 3
    )
    for label, row in zip(labels, validation.confusion(labels), strict=True):
        print(f"| {label} | {' | '.join(map(str, row[:3]))} |")


def accuracy(seen: list[Observed], unseen: list[Observed]) -> None:
    everything = seen + unseen
    labels, exemplars = [one.label for one in everything], [one.exemplar for one in everything]
    source = np.array([one.features.source_vector() for one in everything])
    ours = np.array([one.features.vector() for one in everything])
    print(
        "\n## Accuracy\n\n| method | accuracy | balanced | 95 % (exemplars drawn) |\n|---|---|---|---|"
    )
    report_validation(
        "source: F1, F2, linear SVM; 10-fold, exemplars mixed",
        mixed_folds(source_classifier(), source, labels, exemplars),
    )
    report_validation(
        "source: object-wise", object_wise(source_classifier(), source, labels, exemplars)
    )
    report_validation(
        "logistic regression on all features; 10-fold, mixed",
        mixed_folds(isolation_classifier(), ours, labels, exemplars),
    )
    report_validation(
        "logistic regression, object-wise",
        object_wise(isolation_classifier(), ours, labels, exemplars),
    )
    report_validation("diagnoser, object-wise in ten parts", folds_object_wise(everything))
    validation = predict(trained(seen), unseen)
    report_validation(
        f"diagnoser trained on {len(TRAINED)}, judged on {len(UNSEEN)} others", validation
    )
    report_confusion(validation)
    for fault in ("gear-notch", "pinion-tooth", "rack-tooth"):
        chosen = np.array([one.fault == fault for one in unseen])
        hits = int(np.count_nonzero(validation.predicted[chosen] == CLASS_OF[fault]))
        low, high = proportion_interval(hits, int(chosen.sum()))
        print(f"- {fault}: {hits} of {chosen.sum()} named, {percent(low)}–{percent(high)}")
    healthy = validation.truth == HEALTHY
    alarms = int(np.count_nonzero(validation.predicted[healthy] != HEALTHY))
    low, high = proportion_interval(alarms, int(healthy.sum()))
    print(
        f"- false alarms: {alarms} of {healthy.sum()} healthy movements, 95 % {percent(low)}–{percent(high)}"
    )
    print("\n| exemplars trained | source, balanced | logistic, balanced |\n|---|---|---|")
    sizes = (2, 4, 8, 16, 32)
    curves = [
        learning_curve(make(), X, labels, exemplars, sizes)
        for make, X in ((source_classifier, source), (isolation_classifier, ours))
    ]
    for (size, *reference), (_, *better) in zip(*curves, strict=True):
        print(
            f"| {size} | {percent(reference[0])} ± {percent(reference[1])} | {percent(better[0])} ± {percent(better[1])} |"
        )


def parts(unseen: list[Observed], baseline: GateBaseline) -> None:
    said = Counter(
        (one.fault, baseline.judge(one.features).likely_part)
        for one in unseen
        if one.label == PINION_OR_GEAR
    )
    print("\n## Gear or pinion (a hint, not a class)\n")
    for (fault, part), count in sorted(said.items(), key=str):
        print(f"- {fault}: {part or 'no hint'} {count}")


def growing_notch(baseline: GateBaseline) -> None:
    print("\n## A notch that grows (fraction of the radius; the source breaks the gear at 1)\n")
    sizes, exemplars = np.round(np.arange(0.3, 1.01, 0.1), 1), UNSEEN[:10]
    first = []
    for exemplar in exemplars:
        found = (
            size
            for size in sizes
            if baseline.judge(
                observe(exemplar, "gear-notch", 1, float(size))[0].features
            ).fault_class
        )
        first.append(next(found, None))
    late = sum(size is None for size in first)
    seen = [size for size in first if size is not None]
    depths = [size and float(size) for size in first]
    print(f"- first alarm at depth {depths}: median {np.median(seen):.2f}")
    print(f"- never before 1.0 on {late} of {len(exemplars)} exemplars")


def small_rack_damage() -> None:
    print("\n## A small rack damage, averaged over the way (size 0.2)\n")
    print("| movements | place right (of 10 exemplars) | contrast, median |\n|---|---|---|")
    observed = [observe(exemplar, "rack-tooth", 8, 0.2) for exemplar in UNSEEN[:10]]
    for count in (1, 2, 4, 8):
        averages = [
            average_profile([one.features.profile for one in life[:count]]) for life in observed
        ]
        right = sum(abs(average.place - 1.2 / 2.85) < 0.02 for average in averages)
        print(
            f"| {count} | {right} | {np.median([average.contrast for average in averages]):.1f} |"
        )


def speed(seen: list[Observed]) -> None:
    records = list(movements_of(0, None, 4))
    diagnoser = Diagnoser().fit(
        [*records, *movements_of(0, "rack-tooth", 3)], [HEALTHY] * 4 + [RACK] * 3
    )
    short = records[0]
    machine = MACHINES["gate-actuator"](seed=5)
    machine.actuator = machine.actuator._replace(travel=7.9)  # a longer gate: a movement of 30 s
    signals = machine.simulate(40.0)
    long = cut_movements(Record(signals.channels, signals.units, signals.sample_time))[0]
    began = time.process_time()
    for _ in range(20):
        diagnoser.score(short)
    print("\n## Speed (processor time of one core)\n")
    print(
        f"- scoring a movement of {short.duration:.1f} s: {1e3 * (time.process_time() - began) / 20:.0f} ms"
    )
    times = []
    for _ in range(9):
        began = time.process_time()
        movement_features(long, _CONSTANTS)
        times.append(time.process_time() - began)
    print(
        f"- features of a movement of {long.duration:.1f} s: {1e3 * statistics.median(times):.0f} ms (median of 9)"
    )
    began = time.process_time()
    trained(seen)
    fitting = time.process_time() - began
    began = time.process_time()
    Diagnoser().fit(records * 5, None)
    each = (time.process_time() - began) / 20
    rest = f"{fitting:.1f} s of limits and classifiers ({len(seen)} movements)"
    print(f"- training on 500 movements: {500 * each:.0f} s of features + {rest}")


def main() -> None:
    print("# Gate actuator")
    seen, unseen = observe_all(TRAINED), observe_all(UNSEEN)
    accuracy(seen, unseen)
    baseline = trained(seen)
    parts(unseen, baseline)
    growing_notch(baseline)
    small_rack_damage()
    speed(seen)


if __name__ == "__main__":
    main()
