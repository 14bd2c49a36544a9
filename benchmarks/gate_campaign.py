"""Gate actuator, the long campaigns: false alarms of thousands of healthy gears, a notch that grows, calibrated probabilities,
gear or pinion, what the motor current adds, and how white the residual of a healthy gate can be made.

`python -m benchmarks.gate_campaign [alarms|faults|growth|known|calibration|parts|current|whiteness|physics]`; about twenty
minutes of one core together. Features and limits were chosen without the exemplars of `alarms`, `faults` and `growth`: on
20000–21499 (healthy), 20000–20149 (notch) and 20000–20039 (missing teeth).
"""

import os
import sys
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.stats import binom

from benchmarks.gate_actuator import (
    CLASS_OF,
    HEALTHY_MOVEMENTS,
    TRAINED,
    UNSEEN,
    Observed,
    movements_of,
    observe,
    observe_all,
    percent,
    trained,
)
from residuum.diagnosis.gate.actuator_model import (
    ActuatorConstants,
    AdaptedModel,
    adapt,
    first_order_response,
    from_data_sheet,
)
from residuum.diagnosis.gate.gate_baseline import NOTCH, GateBaseline
from residuum.diagnosis.gate.movement_features import RATE, MovementFeatures, movement_features
from residuum.diagnosis.gate.movements import Direction, Movement, cut_movements, flat_part
from residuum.diagnosis.learning.diagnoser_validation import (
    balanced_accuracy,
    object_wise,
    proportion_interval,
)
from residuum.diagnosis.learning.reliability import expected_calibration_error, reliability_table
from residuum.diagnosis.residuals.fault_isolation import (
    HEALTHY,
    PINION_OR_GEAR,
    isolation_classifier,
)
from residuum.identification.discrepancy.improve import improve
from residuum.identification.physics import load_model
from residuum.identification.record import Record
from residuum.simulation import MACHINES

CONSTANTS = ActuatorConstants()
FAULTS = ("gear-notch", "pinion-tooth", "rack-tooth")
MANY_GEARS = range(60)  # trained for what is said of gears never seen
FIRST_HEALTHY = int(os.environ.get("GATE_FIRST", "10000"))
HEALTHY_EXEMPLARS = range(
    FIRST_HEALTHY, FIRST_HEALTHY + int(os.environ.get("GATE_EXEMPLARS", "4000"))
)
MOVEMENTS = int(os.environ.get("GATE_MOVEMENTS", "1"))  # of each healthy exemplar
FAULTY = range(3000, 3100)
KNOWN_DEPTHS = (0.2, 0.3, 0.4, 0.5, 0.6, 0.8)
GROWING = range(1500, 1560)
DEPTHS = np.round(np.arange(0.3, 1.001, 0.05), 2)
SMALL = range(80, 120)
ANY_SIZE = range(120, 200)
MODELLED_RATE, SETTLING = 100.0, 30  # Hz, samples


def interval(events: int, trials: int) -> str:
    low, high = proportion_interval(events, trials)
    return f"{events} of {trials}, 95 % {percent(low)}–{percent(high)}"


@cache
def of_many_gears() -> GateBaseline:
    """Trained on two healthy movements and one of each default fault of 60 gears."""
    return trained(
        [
            one
            for exemplar in MANY_GEARS
            for fault in CLASS_OF
            for one in observe(exemplar, fault, 1 if fault else 2)
        ]
    )


def alarms() -> None:
    """Every healthy movement of exemplars never trained, judged one by one."""
    baseline = of_many_gears()
    said: Counter[str] = Counter()
    pushed, touched, matches = 0, set(), []
    for exemplar in HEALTHY_EXEMPLARS:
        for one in observe(exemplar, None, MOVEMENTS):
            verdict = baseline.judge(one.features).fault_class or HEALTHY
            said[verdict] += 1
            matches.append((baseline.indicators(one.features)[NOTCH], exemplar))
            pushed += baseline.pushed(one.features) is not None
            touched |= {exemplar} if verdict != HEALTHY else set()
    total = said.total()
    false = total - said[HEALTHY]
    print(
        f"\n## False alarms, {len(HEALTHY_EXEMPLARS)} healthy exemplars never trained × {MOVEMENTS} movements\n"
    )
    print(f"- by movements {interval(false, total)}; said {dict(said)}")
    print(f"- exemplars that alarm: {interval(len(touched), len(HEALTHY_EXEMPLARS))}")
    largest = np.sort(
        [
            max(match for match, owner in matches if owner == exemplar)
            for exemplar in HEALTHY_EXEMPLARS
        ]
    )
    print(
        f"- largest match with a notch of the five worst exemplars {np.round(largest[-5:], 2)}, median {np.median(largest):.2f};"
    )
    print(f"  limit {baseline.notch_limit:.2f}")
    print(f"- called pushed, hence not assessed: {interval(pushed, total)}")


def faults() -> None:
    """One movement of each default fault, and of a smaller notch, of exemplars never trained."""
    baseline = of_many_gears()
    print(f"\n## Faults of {len(FAULTY)} exemplars never trained\n")
    for fault, size in (
        *((fault, None) for fault in FAULTS),
        ("gear-notch", 0.5),
        ("pinion-tooth", 0.4),
        ("rack-tooth", 0.4),
    ):
        said = Counter(_said(baseline, exemplar, fault, size) for exemplar in FAULTY)
        print(
            f"- {fault} {size or 'default'}: named {interval(said[CLASS_OF[fault]], said.total())}; said {dict(said)}"
        )


def _said(baseline: GateBaseline, exemplar: int, fault: str, size: float | None) -> str:
    return baseline.judge(observe(exemplar, fault, 1, size)[0].features).fault_class or HEALTHY


def growth() -> None:
    """The depth at which a notch is first seen; the source saws 0.8 and finds the break at 1 a hundred movements later."""
    baseline = of_many_gears()
    first = [_first_seen(baseline, exemplar) for exemplar in GROWING]
    n = len(first)
    print(
        f"\n## A notch that grows from {DEPTHS[0]:g} to 1 of the radius, {n} exemplars, one movement each {0.05:g}\n"
    )
    for depth in (0.5, 0.6, 0.7, 0.8, 0.9, 0.95):
        print(
            f"- seen at a depth of {depth:g} or before: {interval(sum(seen <= depth for seen in first), n)}"
        )
    k = int(binom.ppf(0.025, n, 0.5))
    ordered = np.sort(first)
    print(
        f"- median depth {np.median(ordered):.2f}, 95 % {ordered[k - 1]:.2f}–{ordered[n - k]:.2f} (order statistics)"
    )


def _first_seen(baseline: GateBaseline, exemplar: int) -> float:
    for depth in DEPTHS:
        if baseline.judge(observe(exemplar, "gear-notch", 1, float(depth))[0].features).fault_class:
            return float(depth)
    return float("inf")


def known() -> None:
    """Gears that were trained healthy: other movements of theirs, at other temperatures and worn too, and small notches."""
    baseline = trained(observe_all(TRAINED))
    print(f"\n## {len(TRAINED)} gears whose healthy movements were trained\n")
    for name, settings in KNOWN_STATES.items():
        found = [features for exemplar in TRAINED for features in _aged(exemplar, settings)]
        recognised = [turn.match for features in found if (turn := baseline.known(features))]
        false = sum(baseline.judge(features).fault_class is not None for features in found)
        largest = max(recognised, default=float("nan"))
        print(
            f"- {name}: recognised {len(recognised)} of {len(found)}, largest match {largest:.2f};",
            end=" ",
        )
        print(f"alarms {interval(false, len(found))}")
    for depth in KNOWN_DEPTHS:
        said = [
            baseline.judge(
                observe(exemplar, "gear-notch", 1, depth, seed=9000 + exemplar)[0].features
            )
            for exemplar in TRAINED
        ]
        named = sum(judgement.fault_class == PINION_OR_GEAR for judgement in said)
        print(f"- notch of {depth:g}: named {interval(named, len(said))}")


KNOWN_STATES: dict[str, dict[str, float]] = {
    "as trained": {},
    "at −10 °C": {"temperature": -10.0},
    "at 45 °C": {"temperature": 45.0},
    "half worn": {"wear": 0.5},
    "worn out": {"wear": 1.0},
}


def _aged(exemplar: int, settings: dict[str, float]) -> list[MovementFeatures]:
    machine = MACHINES["gate-actuator"](seed=9000 + exemplar, exemplar=exemplar, **settings)
    signals = machine.simulate(47.0)
    record = Record(signals.channels, signals.units, signals.sample_time)
    return [movement_features(movement, CONSTANTS) for movement in cut_movements(record)[:2]]


@dataclass(frozen=True)
class Light:
    """What a classifier needs of one movement."""

    exemplar: int
    fault: str | None
    vector: np.ndarray

    @classmethod
    def of(cls, observed: Sequence[Observed]) -> list["Light"]:
        return [cls(one.exemplar, one.fault, one.features.vector()) for one in observed]

    @property
    def label(self) -> str:
        return CLASS_OF[self.fault]


@cache
def of_default_size(exemplars: range) -> list[Light]:
    """Three movements of each fault of its default size and GATE_HEALTHY healthy ones for each exemplar."""
    return [
        one
        for exemplar in exemplars
        for one in Light.of(observe_all(range(exemplar, exemplar + 1)))
    ]


@cache
def of_any_size() -> list[Light]:
    """Two movements of each fault, its size uniform in 0.2 … 1, and four healthy ones for each exemplar of ANY_SIZE."""
    rng, observed = np.random.default_rng(0), []
    for exemplar in ANY_SIZE:
        for fault in FAULTS:
            for k in range(2):
                size = float(rng.uniform(0.2, 1.0))
                observed += Light.of(
                    observe(exemplar, fault, 1, size, seed=5000 + 10 * exemplar + k)
                )
        observed += Light.of(observe(exemplar, None, 4, seed=5000 + 10 * exemplar))
    return observed


def calibration() -> None:
    """Said against true, on exemplars never trained: default sizes, and sizes from hardly visible to gross."""
    gross, unseen = of_default_size(TRAINED), of_default_size(UNSEEN)
    sizes = of_any_size()
    taught = [one for one in sizes if one.exemplar < ANY_SIZE[len(ANY_SIZE) // 2]]
    judged = sizes[len(taught) :]
    for name, training, test in (
        ("trained and judged on default sizes", gross, unseen),
        ("trained and judged on sizes 0.2 … 1", taught, judged),
        ("trained on default sizes, judged on sizes 0.2 … 1", gross, judged),
    ):
        classifier = isolation_classifier().fit(vectors(training), [one.label for one in training])
        healthy = list(classifier.classes_).index(HEALTHY)
        said = 1.0 - classifier.predict_proba(vectors(test))[:, healthy]
        true = np.array([one.label != HEALTHY for one in test])
        print(
            f"\n## Probability of a fault, {name}\n\n| said | movements | mean said | faulty | 95 % |\n|---|---|---|---|---|"
        )
        for line in reliability_table(said, true):
            bounds = f"{line.interval[0]:.3f}–{line.interval[1]:.3f}"
            print(
                f"| {line.low:g}–{line.high:g} | {line.n} | {line.predicted:.3f} | {line.observed:.3f} | {bounds} |"
            )
        print(f"\nexpected calibration error {expected_calibration_error(said, true):.3f}")


def vectors(observed: Sequence[Light]) -> np.ndarray:
    return np.array([one.vector for one in observed])


def parts() -> None:
    """Pinion against gear by the same features and classifier, exemplar-wise."""
    print("\n## Gear or pinion, told by a classifier of its own (exemplars left out)\n")
    sizes = [one for one in of_any_size() if one.label == PINION_OR_GEAR]
    default = [
        one
        for half in (TRAINED, UNSEEN)
        for one in of_default_size(half)
        if one.label == PINION_OR_GEAR
    ]
    for name, observed in (("default sizes", default), ("sizes 0.2 … 1", sizes)):
        faults, exemplars = [str(one.fault) for one in observed], [one.exemplar for one in observed]
        found = object_wise(isolation_classifier(), vectors(observed), faults, exemplars)
        low, high = found.interval(balanced_accuracy)
        print(
            f"- {name}: {percent(found.balanced_accuracy)} balanced of {len(faults)}, 95 % {percent(low)}–{percent(high)}"
        )


@dataclass(frozen=True)
class CurrentDriven(AdaptedModel):
    """The adapted model driven by the measured current: V is replaced by R i + K ω, with R i's scale and the load fitted."""

    def residual(self, movement: Movement) -> np.ndarray:
        """ω − ω_f − ρ i_f − load_f, with _f the drive's first-order lag."""
        if movement.current is None:
            raise ValueError("the movement has no current")
        way = movement.motor_angle / movement.motor_angle[-1]
        inputs = [movement.current, np.ones_like(way), way, way**2]
        lagged = np.column_stack(
            [
                first_order_response(x, self.time_constant, movement.sample_time, x[0])
                for x in inputs
            ]
        )
        fast = movement.speed - first_order_response(
            movement.speed, self.time_constant, movement.sample_time, movement.speed[0]
        )
        moving = movement.speed > 0.3 * np.median(movement.speed)
        return np.asarray(
            fast - lagged @ np.linalg.lstsq(lagged[moving], fast[moving], rcond=None)[0]
        )


def current() -> None:
    """The same features from the residual of the current-driven model, alone and beside the usual ones."""
    print(
        "\n## What the motor current adds (trained on default sizes, judged on sizes of 0.4 of unseen exemplars)\n"
    )
    print(
        "| residual | balanced accuracy, logistic, exemplar-wise, default sizes | notch 0.4 | pinion 0.4 | rack 0.4 |"
    )
    print("|---|---|---|---|---|")
    taught = {how: _observed(TRAINED, None, how) for how in ("voltage", "current")}
    small = {how: _observed(SMALL, 0.4, how) for how in taught}
    for name, hows in (
        ("voltage", ["voltage"]),
        ("current", ["current"]),
        ("both", ["voltage", "current"]),
    ):
        X, Z = (np.hstack([vectors(found[how]) for how in hows]) for found in (taught, small))
        labels, exemplars = (
            [one.label for one in taught["voltage"]],
            [one.exemplar for one in taught["voltage"]],
        )
        held_out = object_wise(isolation_classifier(), X, labels, exemplars)
        said = isolation_classifier().fit(X, labels).predict(Z)
        right = Counter(
            one.fault for a, one in zip(said, small["voltage"], strict=True) if a == one.label
        )
        total = len(small["voltage"]) // len(FAULTS)
        cells = " | ".join(f"{right[fault]} of {total}" for fault in FAULTS)
        print(f"| {name} | {percent(held_out.balanced_accuracy)} | {cells} |")


def _observed(exemplars: range, size: float | None, how: str) -> list[Light]:
    observed = []
    for exemplar in exemplars:
        for fault in FAULTS if size else CLASS_OF:
            count = 2 if size else 3 if fault else HEALTHY_MOVEMENTS
            for record in movements_of(exemplar, fault, count, size, seed=1000 + exemplar):
                movement = cut_movements(record)[0]
                own = adapt([movement.reduced(RATE)], CONSTANTS)
                model = (
                    own
                    if how == "voltage"
                    else CurrentDriven(own.gain, own.time_constant, own.delay, own.load)
                )
                features = movement_features(movement, CONSTANTS, model)
                observed.append(Light(exemplar, fault, features.vector()))
    return observed


def whiteness() -> None:
    """RMS of the residual, whole and by bands, at flat voltage, as effects are added one by one."""
    print(
        "\n## The residual of a healthy gate as effects are added (opening, flat voltage, at 100 Hz; medians)\n"
    )
    print("| model | RMS [rad/s] | slower than the shaft | orders of gear and pinion | above |")
    print("|---|---|---|---|---|")
    table: dict[str, list[tuple[float, ...]]] = {}
    for exemplar in range(60, 66):
        for name, residual, turns in _stages(exemplar):
            table.setdefault(name, []).append(
                (float(np.sqrt(np.mean(residual**2))), *_bands(residual, turns))
            )
    for name, rows in table.items():
        print(
            f"| {name} | " + " | ".join(f"{value:.2f}" for value in np.median(rows, axis=0)) + " |"
        )


def _stages(exemplar: int) -> list[tuple[str, np.ndarray, np.ndarray]]:
    openings = [
        movement.reduced(MODELLED_RATE)
        for record in movements_of(exemplar, None, 20, seed=1000 + exemplar)
        if (movement := cut_movements(record)[0]).direction is Direction.OPENING
    ]
    runs = [
        slice(flat_part(movement)[0].start + SETTLING, flat_part(movement)[0].stop - 5)
        for movement in openings
    ]
    own = [
        adapt([movement], CONSTANTS).residual(movement)[run]
        for movement, run in zip(openings, runs, strict=True)
    ]
    angles = [movement.motor_angle[run] for movement, run in zip(openings, runs, strict=True)]
    turns = [angle / (2 * np.pi * CONSTANTS.gear_teeth) for angle in angles]
    sheet, first = from_data_sheet(CONSTANTS), adapt(openings[:1], CONSTANTS)
    stages = []
    for k in range(1, len(openings)):
        others = [j for j in range(len(openings)) if j != k]
        grid = np.arange(angles[k][0], angles[k][-1], 2 * np.pi / 8)
        shared = np.mean([np.interp(grid, angles[j], own[j]) for j in others], axis=0)
        run, m = runs[k], openings[k]
        models = {
            "data sheet, constant friction": sheet.residual(m)[run],
            "adapted to the gate's first movement: gain, delay, friction along the way": first.residual(
                m
            )[run],
            "adapted to the movement itself (what the diagnoser uses)": own[k],
            "and teeth and rail by place, from nine other movements": own[k]
            - np.interp(angles[k], grid, shared),
        }
        stages += [(name, residual, turns[k]) for name, residual in models.items()]
    return stages


def _bands(residual: np.ndarray, turns: np.ndarray) -> tuple[float, float, float]:
    """RMS of the orders of the shaft below 0.5, from 0.5 to 15 (gear and pinion), and above."""
    even = np.interp(np.linspace(turns[0], turns[-1], len(turns)), turns, residual)
    power = np.abs(np.fft.rfft(even - even.mean()) / len(even)) ** 2 * 2
    order = np.arange(len(power)) / (turns[-1] - turns[0])
    edges = ((0.0, 0.5), (0.5, 15.0), (15.0, np.inf))
    low, middle, high = (float(np.sqrt(power[(order >= a) & (order < b)].sum())) for a, b in edges)
    return low, middle, high


def physics() -> None:
    """What the catalogue of physical effects finds missing in the motor without friction."""
    records = [
        cut_movements(record)[0].reduced(MODELLED_RATE)
        for record in movements_of(0, None, 4, seed=1000)
    ]
    openings = [
        _as_record(movement) for movement in records if movement.direction is Direction.OPENING
    ]
    found = improve(load_model("gate-drive"), openings)
    print(
        f"\n## Effects that `improve` adds to `gate-drive` on two openings (held-out error of the {found.output})\n"
    )
    for step in found.history:
        print(f"- {step.added or 'as it was'}: {step.error:.3g} {found.error_unit}")
    print(f"- verdict: {found.verdict}")


def _as_record(movement: Movement) -> Record:
    channels = {"voltage": movement.voltage, "speed": movement.speed}
    units = {"voltage": "V", "speed": "rad/s"}
    if movement.current is not None:
        channels["current"], units["current"] = movement.current, "A"
    return Record(channels, units, movement.sample_time)


def main() -> None:
    names: dict[str, Callable[[], None]] = {
        "alarms": alarms,
        "faults": faults,
        "growth": growth,
        "known": known,
        "calibration": calibration,
        "parts": parts,
        "current": current,
        "whiteness": whiteness,
        "physics": physics,
    }
    for name in [argument for argument in sys.argv[1:] if argument in names] or names:
        names[name]()


if __name__ == "__main__":
    main()
