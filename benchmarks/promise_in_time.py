"""What a control design reports in time against what is measured, on plants drawn at random.

python -m benchmarks.promise_in_time --plants 20

Each plant is identified from 2000 samples (kernel, 80 lags, variance ratio 10), a PIDN controller is designed by Algorithm 2 and
with `in_time`, and the loop is simulated sample by sample: with the nominal model, with the true plant, and with 40 000 plants of
the posterior that neither the design nor its report has drawn.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from benchmarks.identification import random_system
from residuum.identification.errors import BadInput
from residuum.identification.kernel_based.impulse_response import identify_impulse_response
from residuum.identification.linear_models.identified_model import IdentifiedModel
from residuum.identification.linear_models.transfer_function import TransferFunction
from residuum.identification.record import Record
from residuum.library.answers.control_design import promise_and_measurement
from residuum.robust_control.control_problem import ControlProblem, Wishes
from residuum.robust_control.synthesis.constrained_structure import PIDN

SAMPLES, RATIO, LAGS, FRESH = 2000, 10.0, 80, 40_000
NEAR = 0.1
_COLUMNS = (
    "plant", "design", "promised o, ℓ", "nominal", "reported of 95 % (plants)", "95 % of fresh plants", "true plant",
    "the answer says", "CPU [s]",
)  # fmt: skip
FIRST = 4000


@dataclass(frozen=True)
class Case:
    """A true plant and its model."""

    seed: int
    truth: TransferFunction
    model: IdentifiedModel


def cases() -> Iterator[Case]:
    """Plants of positive gain whose model is certain enough to design with."""
    for seed in range(FIRST, FIRST + 10_000):
        rng = np.random.default_rng(seed)
        numerator, denominator = random_system(rng)
        gain = float(np.sum(numerator) / np.sum(denominator))
        if abs(gain) < 0.3:
            continue
        truth = TransferFunction(numerator[1:] / gain, denominator, 1.0)
        u = rng.standard_normal(SAMPLES)
        y = truth.simulate(u)
        y = y + rng.standard_normal(SAMPLES) * np.std(y) / np.sqrt(RATIO)
        record = Record({"u": u, "y": y}, {"u": "", "y": ""}, 1.0, source=f"plant {seed}")
        yield Case(
            seed, truth, identify_impulse_response(record, "u", "y", order=LAGS, offset=False)
        )


def step_by_recursion(plant: TransferFunction, controller: TransferFunction, n: int) -> np.ndarray:
    """Unit step of the loop by its two difference equations, one after the other; no closed-loop polynomial is formed."""
    y, u, e = np.zeros(n), np.zeros(n), np.zeros(n)
    lag = len(plant.den) - len(plant.num)
    b, a = np.r_[np.zeros(lag), plant.num] / plant.den[0], plant.den / plant.den[0]
    gap = len(controller.den) - len(controller.num)
    c, d = (
        np.r_[np.zeros(gap), controller.num] / controller.den[0],
        controller.den / controller.den[0],
    )
    for k in range(n):
        y[k] = _past(b, u, k) - _past(np.r_[0.0, a[1:]], y, k)
        e[k] = 1.0 - y[k]
        u[k] = _past(c, e, k) - _past(np.r_[0.0, d[1:]], u, k)
    return y


def _past(weights: np.ndarray, signal: np.ndarray, k: int) -> float:
    length = min(len(weights), k + 1)
    return float(weights[:length] @ signal[k - length + 1 : k + 1][::-1])


def figures(y: np.ndarray) -> tuple[float, float]:
    """Overshoot, and settling time into 2 %."""
    outside = np.flatnonzero(np.abs(y - 1.0) > 0.02)
    settled = float(outside[-1] + 1) if len(outside) else 0.0
    return max(0.0, float(y.max() - 1.0)), settled if settled < len(y) else np.inf


def fresh_steps(case: Case, controller: TransferFunction, n: int) -> np.ndarray:
    """(overshoot, settling time) of fresh plants, shape (plants, 2)."""
    den = np.r_[1.0, np.zeros(case.model.delay + case.model.order - 1)]
    found = []
    for g in case.model.sample(FRESH, np.random.default_rng([case.seed, 99])):
        plant = TransferFunction(g, den, 1.0)
        closed = np.polymul(plant.num, controller.num)
        characteristic = np.polyadd(np.polymul(plant.den, controller.den), closed)
        y = lfilter(
            np.r_[np.zeros(len(characteristic) - len(closed)), closed], characteristic, np.ones(n)
        )
        found.append(figures(y) if np.isfinite(y).all() else (np.inf, np.inf))
    return np.array(found)


def near(reported: float | None, measured: float, least: float) -> bool:
    """Within 10 % of the measured value, or nearer than `least` (a sample, or a hundredth of an overshoot)."""
    return reported is not None and abs(reported - measured) <= max(NEAR * measured, least)


def _row(case: Case, in_time: bool) -> tuple[str, dict[str, bool]]:
    problem, wishes = (
        ControlProblem([case.model], case.seed),
        Wishes(in_time=in_time, overshoot=0.05 if in_time else 0.01),
    )
    begun = time.process_time()
    found = problem.solve(PIDN(1.0), wishes)
    seconds = time.process_time() - begun
    answer = promise_and_measurement(found, wishes, problem.measured(found, wishes))
    K, n = found.chosen.design.controller, round(max(problem.horizon, 3 * found.chosen.second))
    nominal = figures(step_by_recursion(problem.plant, K, n))
    truth = figures(step_by_recursion(case.truth, K, n))
    reach = np.quantile(fresh_steps(case, K, n), 0.95, axis=0, method="higher")
    said, measured = answer["promised"], answer["measured"]
    reported, by_most = measured["nominal"], measured["random_plants"]["reached_by_95_percent"]
    verdict = {
        "nominal": near(reported["overshoot"], nominal[0], 0.01)
        and near(reported["settling_time_s"], nominal[1], 1.0),
        "plants": near(by_most["overshoot"], reach[0], 0.01)
        and near(by_most["settling_time_s"], reach[1], 1.0),
        "promise": nominal[0] <= said["overshoot"] * (1 + NEAR)
        and nominal[1] <= said["settling_time_s"] * (1 + NEAR),
        "promise of most": reach[0] <= said["overshoot"] * (1 + NEAR)
        and reach[1] <= said["settling_time_s"] * (1 + NEAR),
        "truth": truth[0] <= max(by_most["overshoot"] or np.inf, 0.0) * (1 + NEAR) + 0.01
        and truth[1] <= (by_most["settling_time_s"] or np.inf) * (1 + NEAR) + 1.0,
        "said": measured["kept"]
        == (nominal[0] <= said["overshoot"] and nominal[1] <= said["settling_time_s"]),
    }
    text = (
        f"| {case.seed} | {'in time' if in_time else 'weights'} | {_both(said['overshoot'], said['settling_time_s'])} "
        f"| {_both(*nominal)} | {_reported(by_most)} ({measured['random_plants']['count']}) | {_both(*reach)} | {_both(*truth)} "
        f"| {'kept' if measured['kept'] else 'not kept'} | {seconds:.1f} |"
    )
    return text, verdict


def _reported(most: dict[str, float | None]) -> str:
    return _both(
        *(np.inf if most[name] is None else most[name] for name in ("overshoot", "settling_time_s"))
    )


def _both(overshoot: float, settling_time: float) -> str:
    return f"{100 * overshoot:.3g} %, {settling_time:.4g}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--plants", type=int, default=20)
    wanted = parser.parse_args().plants
    print("| " + " | ".join(_COLUMNS) + " |")
    print("|---" * len(_COLUMNS) + "|")
    verdicts: dict[bool, list[dict[str, bool]]] = {False: [], True: []}
    refused = {False: 0, True: 0}
    for case in cases():
        if len(verdicts[False]) >= wanted:
            break
        for in_time in (False, True):
            try:
                text, verdict = _row(case, in_time)
            except BadInput:
                refused[in_time] += 1
                if not in_time:
                    break
                continue
            print(text, flush=True)
            verdicts[in_time].append(verdict)
    print(
        "\n| within 10 % (or a sample, a hundredth of overshoot) | weights | in time |\n|---|---|---|"
    )
    told = {
        "nominal": "reported nominal figures against the simulated nominal loop",
        "plants": "reported 95 % of plants against 95 % of fresh ones",
        "promise": "promised figures kept by the nominal loop",
        "promise of most": "promised figures kept by 95 % of fresh plants",
        "truth": "true plant within what 95 % of plants are reported to reach",
        "said": "the answer says rightly whether the promise is kept",
    }
    for name, line in told.items():
        counts = [
            f"{sum(verdict[name] for verdict in verdicts[kind])} of {len(verdicts[kind])}"
            for kind in (False, True)
        ]
        print(f"| {line} | {' | '.join(counts)} |")
    print(
        f"\nRefused as infeasible or too uncertain: {refused[False]} by weights, {refused[True]} in time."
    )


if __name__ == "__main__":
    main()
