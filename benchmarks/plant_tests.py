"""What `identify` knows of plants that integrate, of feedback and of dead time: flags on 60 such plants and on 60 plain ones.

    python -m benchmarks.plant_tests

A third of the plants integrates (half of them in a closed loop), a third runs under a PI controller that sees the noise, and a
third is later than its ARX model's input lags; the plain ones are stable, in an open loop, of delay 1 to 3. White, held, binary
and slow inputs, white and coloured noise. Flagged is a model that is unfit for control by the sentence that belongs to the plant,
false a plain one that is unfit at all. The step response is that of the offered remedy.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import signal

import residuum as rs
from residuum.identification.record import Record
from residuum.library.plant import Plant

FloatArray = npt.NDArray[np.float64]
_STEP = 60


@dataclass(frozen=True, eq=False)
class Case:
    """A record and the plant that made it, z^{−delay} num/den in powers of z⁻¹."""

    u: FloatArray
    y: FloatArray
    num: FloatArray
    den: FloatArray
    delay: int

    def response(self, u: FloatArray) -> FloatArray:
        """The plant's output without noise."""
        return np.asarray(signal.lfilter(np.r_[np.zeros(self.delay), self.num], self.den, u))


def plain_plant(seed: int) -> Case:
    """Stable, open loop, delay 1 to 3, slowest time constant 60 samples; variance ratio 1 to 100."""
    rng = np.random.default_rng([1, seed])
    u = _input(seed, int(rng.integers(1000, 4000)), rng)
    return _noisy(u, *_lags(rng, 60), int(rng.integers(1, 4)), 10 ** rng.uniform(0, 2), rng)


def dead_time_plant(seed: int) -> Case:
    """Delay 15 to 59; variance ratio 3 to 100."""
    rng = np.random.default_rng([2, seed])
    u = _input(seed, int(rng.integers(1500, 4000)), rng)
    return _noisy(u, *_lags(rng, 25), int(rng.integers(15, 60)), 10 ** rng.uniform(0.5, 2), rng)


def integrating_plant(seed: int) -> Case:
    """A lag and an integrator, delay 1 to 7; odd ones under a PI controller."""
    rng = np.random.default_rng([3, seed])
    n = int(rng.integers(1500, 4000))
    u = _input(seed, n, rng)
    num, den = _lags(rng, 8)
    delay, den = int(rng.integers(1, 8)), np.convolve(den, [1.0, -1.0])
    if seed % 2 == 0:
        return _noisy(u - np.mean(u), num, den, delay, 400.0, rng)
    gain = float(np.sum(num) / np.polyval(np.polyder(den), 1.0))
    return _in_loop(num, den, delay, n, 0.35 / (gain * (delay + 10)), 6 * (delay + 10), 0.05, rng)


def feedback_plant(seed: int) -> Case:
    """A stable plant under a PI controller whose set point steps; noise a tenth of these steps."""
    rng = np.random.default_rng([4, seed])
    n = int(rng.integers(1500, 4000))
    num, den = _lags(rng, 20)
    delay = int(rng.integers(1, 5))
    case = _in_loop(
        num,
        den,
        delay,
        n,
        0.5 / float(np.sum(num)) * float(np.sum(den)),
        2 * (delay + 15),
        0.1,
        rng,
    )
    return (
        case
        if np.isfinite(case.y).all() and np.abs(case.y).max() < 10
        else feedback_plant(seed + 1000)
    )


def _input(seed: int, n: int, rng: np.random.Generator) -> FloatArray:
    if seed % 4 == 0:
        return rng.standard_normal(n)
    if seed % 4 == 1:
        return np.repeat(rng.uniform(-1, 1, n // 3), rng.integers(3, 40, n // 3))[:n]
    if seed % 4 == 2:
        return np.repeat(rng.choice([-1.0, 1.0], n // 5 + 1), 5)[:n]
    return np.asarray(signal.lfilter([1.0], [1.0, -0.9], rng.standard_normal(n)))


def _lags(rng: np.random.Generator, slowest: float) -> tuple[FloatArray, FloatArray]:
    poles = np.exp(
        -1 / np.exp(rng.uniform(np.log(1.5), np.log(slowest), rng.integers(1, 4)))
    ).astype(complex)
    if rng.random() < 0.4:
        pole = np.exp(-1 / rng.uniform(5, 25) + 1j * rng.uniform(0.1, 1.2))
        poles = np.r_[poles[:1], pole, pole.conj()]
    den = np.real(np.poly(poles))
    return np.array([den.sum()]) * rng.choice([-1, 1]) * rng.uniform(0.3, 3), den


def _noise(n: int, rng: np.random.Generator) -> FloatArray:
    pole = rng.choice([0.0, 0.8, 0.95])
    e = signal.lfilter([1.0], [1.0, -pole], rng.standard_normal(n))
    return np.asarray(e / np.std(e))


def _noisy(
    u: FloatArray,
    num: FloatArray,
    den: FloatArray,
    delay: int,
    ratio: float,
    rng: np.random.Generator,
) -> Case:
    z = signal.lfilter(np.r_[np.zeros(delay), num], den, u)
    return Case(u, z + np.std(z) / np.sqrt(ratio) * _noise(len(u), rng), num, den, delay)


def _in_loop(
    num: FloatArray,
    den: FloatArray,
    delay: int,
    n: int,
    gain: float,
    time: float,
    noise: float,
    rng: np.random.Generator,
) -> Case:
    """The plant under a PI controller that measures its noise."""
    set_point = np.repeat(rng.uniform(-1, 1, n // 60 + 1), rng.integers(60, 300, n // 60 + 1))[:n]
    v, y, z, u, total = noise * _noise(n, rng), np.zeros(n), np.zeros(n), np.zeros(n), 0.0
    for t in range(n):
        past = sum(float(b) * u[t - delay - i] for i, b in enumerate(num) if t >= delay + i)
        z[t] = past - sum(float(a) * z[t - i] for i, a in enumerate(den) if 0 < i <= t)
        y[t] = z[t] + v[t]
        total += gain / time * (set_point[t] - y[t])
        u[t] = gain * (set_point[t] - y[t]) + total
    return Case(u, y, num, den, delay)


@dataclass(frozen=True)
class Kind:
    """Cases, the method that meets them first, its sentence, and the remedy that the sentence offers."""

    make: Callable[[int], Case]
    method: str
    says: str
    remedy: dict[str, object]


KINDS = {
    "integrating": Kind(
        integrating_plant,
        "kernel",
        "the plant integrates",
        {"method": "bj", "integrator": True, "delay": None},
    ),
    "feedback": Kind(feedback_plant, "kernel", "feedback", {"method": "bj", "delay": None}),
    "dead time": Kind(
        dead_time_plant,
        "arx",
        "later than the model's last input lag",
        {"method": "bj", "delay": None},
    ),
}


def step_error(case: Case, plant: Plant) -> float:
    """Largest error of the step response over 60 samples, part of its largest value."""
    step = np.ones(_STEP + case.delay)
    truth = case.response(step)
    found = plant.identified.simulate(step) - plant.identified.offset
    return float(np.max(np.abs(found - truth)) / np.max(np.abs(truth)))


def identified(case: Case, **options: object) -> Plant:
    """The plant by these options."""
    record = Record({"u": case.u, "y": case.y}, {"u": "V", "y": "m"}, 1.0)
    return rs.identify(record, input="u", output="y", **options)  # type: ignore[arg-type]


def main() -> None:
    """Print the table."""
    print(
        "| plants | flagged | step response within 10 % after the remedy | largest error |\n|---|---|---|---|"
    )
    for name, kind in KINDS.items():
        flagged, errors = 0, []
        for seed in range(20):
            case = kind.make(seed)
            seen = any(
                kind.says in text for text in identified(case, method=kind.method).identified.unfit
            )
            flagged += seen
            if seen:
                errors.append(step_error(case, identified(case, **kind.remedy)))
        print(
            f"| {name} | {flagged} of 20 | {sum(e < 0.1 for e in errors)} of {len(errors)} | {max(errors):.3f} |",
            flush=True,
        )
    for method in ("kernel", "arx"):
        false = [
            text
            for seed in range(60)
            for text in identified(plain_plant(seed), method=method).identified.unfit
        ]
        print(f"| plain, {method} | {len(false)} of 60 (false) | | |", flush=True)
        print(*(f"  {text}" for text in false), sep="\n")


if __name__ == "__main__":
    main()
