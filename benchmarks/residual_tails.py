"""Far tails of noise taken from healthy samples: measured over chosen rate of single samples, and how many samples it takes."""

from collections.abc import Callable

import numpy as np
from scipy import stats

from residuum.diagnosis.thresholds.tails import differing_tail

Draw = Callable[[np.random.Generator, int], np.ndarray]
ERROR = 0.09  # model error beside the noise, in its standard deviations: what 4000 samples of (4.10) leave
FRESH, RECORDS = 4_000_000, 30
PER_SAMPLE = {"100 a day": 100.0 * 0.1 / 86400.0, "10 a day": 10.0 * 0.1 / 86400.0}


def _truncated(rng: np.random.Generator, n: int) -> np.ndarray:
    drawn = rng.standard_normal(int(1.01 * n) + 100)
    return drawn[np.abs(drawn) < 3.0][:n]


NOISES: dict[str, Draw] = {
    "Gaussian": lambda rng, n: rng.standard_normal(n),
    "clipped at ±3 σ": lambda rng, n: np.clip(rng.standard_normal(n), -3.0, 3.0),
    "truncated at ±3 σ": _truncated,
    "uniform": lambda rng, n: np.sqrt(3.0) * rng.uniform(-1.0, 1.0, n),
    "Laplace": lambda rng, n: rng.laplace(size=n) / np.sqrt(2.0),
}


def main() -> None:
    """One row a noise and number of healthy samples; the law that is held against the samples is the Gaussian one."""
    print(
        f"\n### Tails from healthy samples, measured / chosen, mean (5 … 95 %) of {RECORDS} records\n"
    )
    print(
        "| noise | healthy samples | tail fitted | "
        + " | ".join(PER_SAMPLE)
        + " |\n"
        + "|---" * (3 + len(PER_SAMPLE))
        + "|"
    )
    for name, draw in NOISES.items():
        rng = np.random.default_rng(1)
        fresh = np.sort(_sizes(draw, rng, FRESH))
        for n in (4_000, 20_000, 50_000):
            fitted = [differing_tail(_sizes(draw, rng, n), _gaussian) for _ in range(RECORDS)]
            found = [tail for tail in fitted if tail is not None]
            cells = [
                _cell(np.array([_exceeded(fresh, float(tail.level(p))) / p for tail in found]))
                for p in PER_SAMPLE.values()
            ]
            print(
                f"| {name} | {n} | {len(found)} of {RECORDS} | " + " | ".join(cells) + " |",
                flush=True,
            )


def _sizes(draw: Draw, rng: np.random.Generator, n: int) -> np.ndarray:
    return np.abs(draw(rng, n) + ERROR * rng.standard_normal(n))


def _gaussian(x: np.ndarray) -> np.ndarray:
    return np.log(2.0) + stats.norm.logsf(x / np.hypot(1.0, ERROR))


def _exceeded(ascending: np.ndarray, level: float) -> float:
    return 1.0 - float(np.searchsorted(ascending, level)) / len(ascending)


def _cell(ratios: np.ndarray) -> str:
    if not len(ratios):
        return ""
    low, high = np.quantile(ratios, [0.05, 0.95])
    return f"{ratios.mean():.2f} ({low:.2f} … {high:.2f})"


if __name__ == "__main__":
    main()
