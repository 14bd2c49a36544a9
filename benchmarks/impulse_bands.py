"""How many of the coefficients of an impulse response its 95 % bands hold, lag by lag.

python -m benchmarks.impulse_bands --systems 500 --first 30000 --kernels tc dc
"""

from __future__ import annotations

import argparse
import math

import numpy as np
from scipy import signal

from benchmarks.identification import random_system
from residuum.identification.errors import NotIdentifiable
from residuum.identification.kernel_based.impulse_response import identify_impulse_response
from residuum.identification.record import Record

RATIOS = (1.0, 10.0, 100.0)
ORDER, SAMPLES, SHOWN = 80, 500, (1, 5, 10, 20, 40, 80)


def held(kernel: str, ratio: float, seed: int) -> np.ndarray:
    """Which coefficients lie within 1.96 standard deviations, by the marginal ones and by those at the estimate, shape (2, m)."""
    rng = np.random.default_rng(seed)
    numerator, denominator = random_system(rng)
    u = rng.standard_normal(2 * SAMPLES)
    y = signal.lfilter(numerator, denominator, u)
    y += rng.standard_normal(len(y)) * math.sqrt(y.var() / ratio)
    record = Record({"u": u[SAMPLES:], "y": y[SAMPLES:]}, {"u": "", "y": ""}, 1.0)
    model = identify_impulse_response(record, "u", "y", kernel=kernel, order=ORDER)
    error = np.abs(
        model.impulse_response - signal.lfilter(numerator, denominator, np.eye(1, ORDER + 1)[0])[1:]
    )
    return np.stack([error < 1.96 * model.std, error < 1.96 * model.conditional_std])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--systems", type=int, default=500)
    parser.add_argument("--kernels", nargs="+", default=["tc", "dc", "ss", "di"])
    parser.add_argument("--first", type=int, default=0, help="the first system's seed")
    given = parser.parse_args()
    print("| kernel | variance ratio | all coefficients | at the estimated hyper-parameters | "
          + " | ".join(f"lag {k}" for k in SHOWN) + " |")  # fmt: skip
    print("|---" * (4 + len(SHOWN)) + "|")
    for kernel in given.kernels:
        for ratio in RATIOS:
            found = []
            for seed in range(given.first, given.first + given.systems):
                try:
                    found.append(held(kernel, ratio, seed))
                except NotIdentifiable:
                    continue
            share = 100 * np.mean(found, axis=0)
            lags = " | ".join(f"{share[0, k - 1]:.0f} %" for k in SHOWN)
            print(
                f"| {kernel} | {ratio:g} | {share[0].mean():.1f} % | {share[1].mean():.1f} % | {lags} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
