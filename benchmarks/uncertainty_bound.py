"""Whether the uncertainty weight lies above what it bounds, at frequencies that its fit never saw.

The system (2.38), and random stable ones of infinite and of finite impulse response in turn; records of each, one identified
impulse response and weight a record; then new models are drawn from the posterior, and the truth is compared, at frequencies
drawn at random.

python -m benchmarks.uncertainty_bound --systems 20 --records 6 --draws 100
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from residuum.identification.kernel_based.impulse_response import identify_impulse_response
from residuum.identification.linear_models.error_bounds.error_models import magnitude
from residuum.identification.linear_models.transfer_function import TransferFunction
from residuum.identification.linear_models.uncertainty import (
    design_uncertainty_weight,
    drawn_errors,
)
from residuum.identification.record import Record

SAMPLE_TIME, ORDER = 0.01, 100
SIZES, RATIOS = (1000, 5000), (1.0, 10.0, 100.0)
"""Lengths of the records and variance ratios of signal and noise; each record is one of the six pairs."""
UNSEEN = 20_000
BENCHMARK = TransferFunction(
    [0.28261, 0.50666], [1, -1.41833, 1.58939, -1.31608, 0.88642], SAMPLE_TIME
)
"""(2.38) of the source: two resonances that last longer than the order."""


@dataclass(frozen=True)
class Case:
    """One record: share of new models above the weight anywhere, the largest of them, and the true error over the weight."""

    drawn_above: float
    drawn_worst: float
    true_worst: float
    certified: bool
    seconds: float


def random_system(rng: np.random.Generator) -> TransferFunction:
    """One to three pairs of poles of modulus .6 to .96, and as many zeros less one inside the unit circle, gain 1 in variance."""
    pairs = int(rng.integers(1, 4))
    radius, angle = rng.uniform(0.6, 0.96, pairs), rng.uniform(0.05, 2.8, pairs)
    den = np.poly(np.concatenate([radius * np.exp(1j * angle), radius * np.exp(-1j * angle)])).real
    num = np.poly(rng.uniform(-0.95, 0.95, 2 * pairs - 1))
    size = np.linalg.norm(lfilter(np.r_[0.0, num], den, np.r_[1.0, np.zeros(2000)]))
    return TransferFunction(num / size, den, SAMPLE_TIME)


def finite_system(rng: np.random.Generator) -> TransferFunction:
    """The first 30 to 90 coefficients of a random system: its response ends at once, resonant or not."""
    endless = random_system(rng)
    g = endless.simulate(np.r_[1.0, np.zeros(int(rng.integers(30, 91)))])[1:]
    return TransferFunction(g / np.linalg.norm(g), np.r_[1.0, np.zeros(len(g))], SAMPLE_TIME)


def system(number: int) -> TransferFunction:
    """System 0 is (2.38) at gain 1 in variance; then finite responses at odd, infinite ones at even numbers."""
    if number == 0:
        size = np.linalg.norm(BENCHMARK.simulate(np.r_[1.0, np.zeros(2000)]))
        return TransferFunction(BENCHMARK.num / size, BENCHMARK.den, SAMPLE_TIME)
    rng = np.random.default_rng([28, number])
    return finite_system(rng) if number % 2 else random_system(rng)


def judge(truth: TransferFunction, n: int, ratio: float, draws: int, seed: list[int]) -> Case:
    """Identify a record, make its weight, and look at it where nobody looked."""
    rng = np.random.default_rng(seed)
    u = rng.normal(size=n + 1000)
    y = truth.simulate(u) + rng.normal(size=len(u)) / np.sqrt(ratio)
    record = Record({"u": u[1000:], "y": y[1000:]}, {"u": "", "y": ""}, SAMPLE_TIME)
    model = identify_impulse_response(record, "u", "y", order=ORDER, offset=False)
    begun = time.perf_counter()
    made = design_uncertainty_weight(model, order=2, seed=seed[0])
    seconds = time.perf_counter() - begun
    nyquist = np.pi / SAMPLE_TIME
    omega = np.concatenate(
        [rng.uniform(0, nyquist, UNSEEN // 2), nyquist * 10 ** rng.uniform(-5, 0, UNSEEN // 2)]
    )
    bound = np.abs(made.weight.frequency_response(omega))
    errors = drawn_errors(model, draws, seed=rng)
    above = np.zeros(draws)
    for part in np.array_split(np.arange(len(omega)), 20):
        angle = omega[part] * SAMPLE_TIME
        error = magnitude(errors.numerators, angle) / magnitude(errors.denominators, angle)
        above = np.maximum(above, (error / bound[part]).max(axis=1))
    error = np.abs(truth.frequency_response(omega) / model.frequency_response(omega) - 1.0)
    return Case(
        float(np.mean(above > 1.0)),
        float(above.max()),
        float(np.max(error / bound)),
        made.certified,
        seconds,
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--systems", type=int, default=20)
    parser.add_argument("--records", type=int, default=6)
    parser.add_argument("--draws", type=int, default=100)
    given = parser.parse_args()
    pairs = [(n, ratio) for n in SIZES for ratio in RATIOS]
    found: dict[tuple[int, float], list[Case]] = {}
    of_benchmark: list[Case] = []
    for number in range(given.systems):
        truth = system(number)
        for record in range(given.records):
            n, ratio = pairs[record % len(pairs)]
            case = judge(truth, n, ratio, given.draws, [28, number, record])
            found.setdefault((n, ratio), []).append(case)
            of_benchmark += [case] * (number == 0)
    every = [case for cases in found.values() for case in cases]
    print("| n | variance ratio | records | new models above anywhere [%] | largest of them | true error above [records] |"
          " largest of it | certified | median design [s] |")  # fmt: skip
    print("|---|---|---|---|---|---|---|---|---|")
    for name, cases in [
        *((f"{n} | {ratio:g}", cases) for (n, ratio), cases in found.items()),
        ("(2.38) | ", of_benchmark),
        ("all | ", every),
    ]:
        print(
            f"| {name} | {len(cases)} | {100 * np.mean([case.drawn_above for case in cases]):.2f} | "
            f"{max(case.drawn_worst for case in cases):.3f} | {sum(case.true_worst > 1 for case in cases)} | "
            f"{max(case.true_worst for case in cases):.3f} | {sum(case.certified for case in cases)} | "
            f"{np.median([case.seconds for case in cases]):.2f} |"
        )


if __name__ == "__main__":
    main()
