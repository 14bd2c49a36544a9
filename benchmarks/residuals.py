"""Residuals: detection rate and delay of every method at one false alarm in 864 000 samples (a day at 10 Hz), false-alarm
rates chosen and measured, the peak bound under attack, the band of the size estimate, and speed.

Thresholds of the methods to compare with are set on 4·10⁶ healthy samples of the same plant (10⁶ of each random plant); ours by
its closed form, and beside that on the same samples as theirs.
"""

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy import signal, stats

from benchmarks.peers.adaptive_threshold import adaptive_threshold
from residuum.diagnosis.diagnosers.robust_residual import RobustResidual
from residuum.diagnosis.residuals.fault_isolation import FaultEstimator
from residuum.diagnosis.residuals.generators.classical_filters import (
    kalman_residual,
    parity_space,
    unknown_input_observer,
)
from residuum.diagnosis.residuals.generators.physical_prediction import with_prediction
from residuum.diagnosis.residuals.residual_design import ResidualDesign, design_residual
from residuum.diagnosis.residuals.residual_detection import detect
from residuum.diagnosis.systems import balanced_truncation, h_infinity_norm
from residuum.diagnosis.thresholds.false_alarm_rate import BLOCK, block_peaks, cusum
from residuum.diagnosis.thresholds.threshold import peak_threshold
from residuum.identification.discrepancy.improve import improve
from residuum.identification.kernel_based.impulse_response import identify_impulse_response
from residuum.identification.linear_models.state_space import StateSpace
from residuum.identification.linear_models.transfer_function import TransferFunction
from residuum.identification.linear_models.uncertainty import design_uncertainty_weight
from residuum.identification.physics import load_model
from residuum.identification.record import Record
from residuum.simulation import MACHINES
from residuum.simulation.machine import Machine

RATE = 1.0 / 864_000.0
MILLION = 1_000_000
BEFORE, AFTER = 300, 1000
CLOSED, MEASURED = "Residuum", "Residuum, limit as the others"
_EXACT_FROM = 4.0  # far below the peaks that a limit is extrapolated from
TS = 0.1


@dataclass(frozen=True)
class Plant:
    name: str
    system: TransferFunction
    snr: float = 9.0

    @property
    def noise_std(self) -> float:
        return float(np.sqrt(np.sum(self.system.simulate(np.eye(1, 5000)[0]) ** 2) / self.snr))

    def run(self, u, rng, noise=None):
        e = rng.standard_normal(len(u)) if noise is None else noise(rng, len(u))
        return self.system.simulate(u) + self.noise_std * e


def process() -> Plant:
    return Plant(
        "(4.10)", TransferFunction([47619.0], [1.0, 234.0136, 6857.1, 5442.2]).discretise(TS)
    )


def two_resonances() -> Plant:
    denominator = [1.0, -1.41833, 1.58939, -1.31608, 0.88642]
    return Plant("(2.38)", TransferFunction([0.28261, 0.50666], denominator, TS), 25.0)


def random_plants(count: int) -> list[Plant]:
    """Stable, order 1 … 5, dominant time constant below 20 samples so that 100 lags hold the response."""
    plants = []
    for k in range(count):
        rng = np.random.default_rng([k, 99])
        order = int(rng.integers(1, 6))
        poles = []
        while len(poles) < order:
            radius = rng.uniform(0.3, 0.95)
            if order - len(poles) >= 2 and rng.random() < 0.5:
                angle = rng.uniform(0.1, 2.5)
                poles += [radius * np.exp(1j * angle), radius * np.exp(-1j * angle)]
            else:
                poles.append(radius)
        numerator = rng.standard_normal(order)
        plants.append(
            Plant(f"random {k + 1}", TransferFunction(numerator, np.poly(poles).real, TS))
        )
    return plants


def trained(plant: Plant, seed: int, noise: Callable | None = None) -> ResidualDesign:
    """From 4000 healthy samples, as `residuum train robust-residual` does it: the lags are doubled until the response ends."""
    rng = np.random.default_rng([seed, 1])
    u = rng.standard_normal(5000)
    record = Record({"u": u, "y": plant.run(u, rng, noise)}, {"u": "", "y": ""}, TS).window(
        1000, 5000
    )
    return RobustResidual(input="u", output="y").fit([record]).design


Statistic = Callable[[np.ndarray, np.ndarray], np.ndarray]


def statistics_of(design: ResidualDesign) -> dict[str, Statistic]:
    """Ours, its limit set as theirs, and the methods to compare with; each a non-negative statistic, zero while it starts.

    All of them have the same model and the same operating point.
    """
    model, sigma = design.model, design.noise.innovation_std
    full = StateSpace.from_transfer_function(model.transfer_function())
    system = balanced_truncation(full, 0.05 * h_infinity_norm(full)[0]).system
    # Noise at the input that moves the output as much as the model's own uncertainty does for white input.
    input_error = float(np.trace(model.covariance) / np.sum(model.impulse_response**2))
    kalman = kalman_residual(system, input_error, sigma**2)
    parity = parity_space(system, system.order + 40, input_error, sigma**2)
    observer = unknown_input_observer(system, np.zeros((system.order, 0)))
    selector = adaptive_threshold(model, design.W_T, sigma)

    def late(r):
        return np.where(np.arange(len(r)) > 150, np.abs(r), 0.0)

    def about_the_operating_point(residual):
        return lambda u, y: residual(u - design.input_mean, y - design.output_mean)

    def innovations_cusum(u, y):
        r = innovation(u, y)
        return cusum(r, np.arange(len(r)) > 150, 0.5, np.inf).statistic

    innovation, of_parity, of_observer = map(
        about_the_operating_point, (kalman.residual, parity.residual, observer.residual)
    )
    return {
        MEASURED: lambda u, y: (
            design.bank(_EXACT_FROM, restart=False).process(design.generator.run(u, y)).statistic
        ),
        "robust residual, point": lambda u, y: late(design.generator.run(u, y).robust),
        "plain coprime, point": lambda u, y: late(design.generator.run(u, y).primary),
        "Kalman innovation, point": lambda u, y: late(innovation(u, y)),
        "Kalman innovation, CUSUM": innovations_cusum,
        "parity space, point": lambda u, y: late(np.nan_to_num(of_parity(u, y))),
        "observer, point": lambda u, y: late(of_observer(u, y)[:, 0]),
        "adaptive threshold": lambda u, y: (
            late(design.generator.run(u, y).primary) / selector.level(u - design.input_mean)
        ),
    }


def faults(plant: Plant) -> dict[str, Callable[[np.ndarray, np.ndarray], np.ndarray]]:
    """Name → y(u, noise) with the fault from sample BEFORE on."""
    sigma, n = plant.noise_std, BEFORE + AFTER
    after = np.arange(n) >= BEFORE
    since = np.maximum(np.arange(n) - BEFORE, 0)

    def stuck(u, e):
        y = plant.system.simulate(u) + e
        return np.where(after, y[BEFORE], y)

    def added(shape):
        """Up or down at random: an error of the operating point must not favour anybody."""
        return lambda u, e: plant.system.simulate(u) + e + np.sign(e[0]) * sigma * shape

    steps = {f"step {f:g} σ": added(f * after) for f in (0.5, 1, 2, 5)}
    ramps = {f"ramp {f:g} σ/100": added(f / 100 * since) for f in (0.5, 2)}
    gains = {
        f"gain −{f:.0%}": (lambda u, e, f=f: plant.system.simulate((1 - f * after) * u) + e)
        for f in (0.1, 0.3)
    }
    return {**steps, **ramps, **gains, "stuck": stuck}


def first_after(alarm: np.ndarray) -> float:
    """Delay of the first alarm after the onset [samples], infinite when there is none."""
    hits = np.flatnonzero(alarm[BEFORE:])
    return float(hits[0]) if len(hits) else np.inf


def equal_rate_limits(
    plant: Plant, methods: dict[str, Statistic], seed: int, healthy: int
) -> dict[str, float]:
    """Level that a block of healthy samples passes at RATE, for every method, from `healthy` million samples.

    The thirtieth part of the peaks above has an exponential tail: in the square of a statistic of one sample, in a CUSUM itself.
    """
    peaks: dict[str, list[np.ndarray]] = {name: [] for name in methods}
    for k in range(healthy):
        rng = np.random.default_rng([seed, 2, k])
        u = rng.standard_normal(MILLION)
        y = plant.run(u, rng)
        for name, statistic in methods.items():
            peaks[name].append(block_peaks([statistic(u, y)], [np.arange(MILLION) > 200]))
    limits = {}
    for name, parts in peaks.items():
        power = 1.0 if name.endswith("CUSUM") else 2.0
        x = np.sort(np.concatenate(parts) ** power)[::-1]
        k = len(x) // 30
        limits[name] = float(
            (x[k] + np.mean(x[:k] - x[k]) * np.log(k / (len(x) * BLOCK * RATE))) ** (1.0 / power)
        )
    return limits


def delays(plant: Plant, seed: int, runs: int, healthy: int) -> dict[str, dict[str, list[float]]]:
    """method → fault → delay of each run."""
    design = trained(plant, seed)
    methods, limit = statistics_of(design), design.bank_threshold(RATE)
    limits = equal_rate_limits(plant, methods, seed, healthy)
    rng = np.random.default_rng([seed, 2])
    found: dict[str, dict[str, list[float]]] = {name: {} for name in (CLOSED, *methods)}
    for fault, make in faults(plant).items():
        for _ in range(runs):
            u = rng.standard_normal(BEFORE + AFTER)
            y = make(u, plant.noise_std * rng.standard_normal(BEFORE + AFTER))
            bank = design.bank(limit)
            found[CLOSED].setdefault(fault, []).append(
                first_after(bank.process(design.generator.run(u, y)).alarm)
            )
            for name, statistic in methods.items():
                found[name].setdefault(fault, []).append(
                    first_after(statistic(u, y) > limits[name])
                )
    return found


def show(title: str, results: list[dict[str, dict[str, list[float]]]]) -> None:
    print(
        f"\n### {title}: detected within {AFTER} samples / mean delay [samples], {AFTER} where nothing was found\n"
    )
    names = list(results[0][CLOSED])
    print("| method | " + " | ".join(names) + " |\n|" + "---|" * (len(names) + 1))
    gathered = {
        method: {
            fault: np.concatenate([np.asarray(result[method][fault]) for result in results])
            for fault in names
        }
        for method in results[0]
    }
    for method, found in gathered.items():
        cells = [
            f"{np.mean(np.isfinite(found[fault])):.0%} / {_restricted(found[fault]).mean():.1f}"
            for fault in names
        ]
        print(f"| {method} | " + " | ".join(cells) + " |")
    for mine in (CLOSED, MEASURED):
        print(f"\n{mine} minus the fastest other, the same records, mean ± 1.96 standard errors:\n")
        for fault in names:
            ours = _restricted(gathered[mine][fault])
            others = {
                method: _restricted(found[fault])
                for method, found in gathered.items()
                if method not in (CLOSED, MEASURED)
            }
            best = min(others, key=lambda method: others[method].mean())
            difference = ours - others[best]
            half = 1.96 * _standard_error(difference, len(results))
            verdict = (
                "slower"
                if difference.mean() > half
                else "faster"
                if difference.mean() < -half
                else "even"
            )
            against = f"{best} of {others[best].mean():.1f}"
            print(
                f"- {fault}: {difference.mean():+.2f} ± {half:.2f} samples against {against}: {verdict}"
            )


def _standard_error(differences: np.ndarray, plants: int) -> float:
    """Of their mean: runs on one plant share its model and its limits, so that where there are several each counts once."""
    independent = differences.reshape(plants, -1).mean(axis=1) if plants > 1 else differences
    return float(independent.std(ddof=1) / np.sqrt(len(independent)))


def _restricted(delays: np.ndarray) -> np.ndarray:
    """Delays, a fault that was not found counted as the whole time: what Lorden's criterion averages, on a finite record."""
    return np.minimum(delays, AFTER)


def thesis_steps(runs: int = 100) -> None:
    """Steps of 30, 3 and 1 on (4.10): delay at one false alarm a day."""
    plant = process()
    design = trained(plant, 1)
    rng = np.random.default_rng(5)
    print("\n### (4.10), sensor steps at one false alarm a day (posterior threshold, glr)\n")
    print("| step | found | median delay [s] | 99 % delay [s] |\n|---|---|---|---|")
    for size in (30.0, 3.0, 1.0):
        found = []
        for _ in range(runs):
            u = rng.standard_normal(BEFORE + AFTER)
            y = plant.run(u, rng) + size * (np.arange(BEFORE + AFTER) >= BEFORE)
            bank = design.bank(design.bank_threshold(RATE))
            found.append(TS * first_after(bank.process(design.generator.run(u, y)).alarm))
        print(
            f"| {size:g} | {np.mean(np.isfinite(found)):.0%} | {np.median(found):.1f} | {np.quantile(found, 0.99):.1f} |"
        )


NOISES: dict[str, Callable | None] = {
    "Gaussian": None,
    "bounded (±3 σ)": lambda rng, n: np.clip(rng.standard_normal(n), -3, 3),
    "truncated (±3 σ)": lambda rng, n: stats.truncnorm.rvs(-3, 3, size=n, random_state=rng),
    "uniform": lambda rng, n: np.sqrt(3) * rng.uniform(-1, 1, n),
    "coloured, AR(1) .6": lambda rng, n: signal.lfilter([0.8], [1.0, -0.6], rng.standard_normal(n)),
    "coloured and uniform": lambda rng, n: signal.lfilter(
        [0.8], [1.0, -0.6], np.sqrt(3) * rng.uniform(-1, 1, n)
    ),
    "Laplace": lambda rng, n: rng.laplace(size=n) / np.sqrt(2),
    "Student t, 3 dof": lambda rng, n: rng.standard_t(3, n) / np.sqrt(3),
}


def model_rates(models: int = 12) -> None:
    """Measured over chosen rate of each of many models learnt from 4000 samples: what one user's own detector does."""
    print(
        f"\n### False alarms of one model, measured / chosen: posterior, glr, {models} models a row\n"
    )
    print(
        "| plants | noise | chosen, 1/day | samples a model | mean | 5 … 95 % of models | within 1/2 … 2 | expected spread |"
    )
    print("|" + "---|" * 8)
    cases = [("(4.10)", name, 100.0, 2) for name in NOISES] + [
        ("(2.38)", "Gaussian", 100.0, 2),
        ("random", "Gaussian", 100.0, 2),
    ]
    cases += [(name, "Gaussian", 1.0, 12) for name in ("(4.10)", "(2.38)")]
    drawn = random_plants(models)
    for name, noise, per_day, millions in cases:
        plants = (
            drawn
            if name == "random"
            else [process() if name == "(4.10)" else two_resonances()] * models
        )
        found = [
            _rate_of(plant, seed, NOISES[noise], per_day, millions)
            for seed, plant in enumerate(plants, start=1)
        ]
        factors, spread = (np.array(column) for column in zip(*found, strict=True))
        low, high = np.quantile(factors, [0.05, 0.95])
        inside = np.mean((factors >= 0.5) & (factors <= 2.0))
        cells = [
            name,
            noise,
            f"{per_day:g}",
            f"{millions}·10⁶",
            f"{factors.mean():.2f}",
            f"{low:.2f} … {high:.2f}",
            f"{inside:.0%}",
        ]
        print(
            "| " + " | ".join([*cells, f"1/{spread.mean():.1f} … {spread.mean():.1f}"]) + " |",
            flush=True,
        )


def _rate_of(
    plant: Plant, seed: int, noise: Callable | None, per_day: float, millions: int
) -> tuple[float, float]:
    """(Measured over chosen rate of one model, the factor within which 95 % of models are said to be)."""
    design = trained(plant, seed, noise)
    b = design.bank_threshold(per_day * TS / 86400.0)
    alarms = 0
    for k in range(millions):
        rng = np.random.default_rng([seed, 77, k])
        u = rng.standard_normal(MILLION)
        alarms += int(
            design.bank(b).process(design.generator.run(u, plant.run(u, rng, noise))).alarm.sum()
        )
    return alarms / (per_day * TS / 86400.0 * MILLION * millions), design.noise.rate_factor(b)


def false_alarms(plants: int = 10, n: int = 1_000_000) -> None:
    """Measured over chosen rate at 100 a day of every threshold, over healthy records of several identified models."""
    per_day = 100.0
    kinds = [
        ("posterior", "glr"),
        ("posterior", "point"),
        ("posterior", "rms"),
        ("posterior", "cusum"),
        ("calibrated", "glr"),
    ]
    print(
        f"\n### False alarms, measured / chosen, mean (least … most) ({per_day:g} a day; (4.10), {plants} models × {n:.0e})\n"
    )
    print(
        "| noise | "
        + " | ".join(f"{kind}, {evaluation}" for kind, evaluation in kinds)
        + " |\n|"
        + "---|" * (len(kinds) + 1)
    )
    for name, noise in NOISES.items():
        counts = np.zeros((plants, len(kinds)))
        for seed in range(plants):
            rng = np.random.default_rng([seed, 3])
            plant = process()
            u = rng.standard_normal(50_000)
            healthy = Record({"u": u, "y": plant.run(u, rng, noise)}, {"u": "", "y": ""}, TS)
            model = identify_impulse_response(healthy.window(1000, 5000), "u", "y", order=100)
            design = design_residual(
                model, design_uncertainty_weight(model, order=2).weight, [healthy]
            )
            u = rng.standard_normal(n)
            record = Record({"u": u, "y": plant.run(u, rng, noise)}, {"u": "", "y": ""}, TS)
            for k, (kind, evaluation) in enumerate(kinds):
                found = detect(
                    design,
                    record,
                    threshold=kind,
                    evaluation=evaluation,
                    false_alarms_per_day=per_day,
                )
                alarms = np.flatnonzero(found.alarm)
                counts[seed, k] = (
                    len(alarms) - int(np.sum(np.diff(alarms) <= 50)) if len(alarms) else 0
                )
        factors = counts / (per_day * n * TS / 86400.0)
        cells = [
            f"{column.mean():.2f} ({column.min():.2f} … {column.max():.2f})" for column in factors.T
        ]
        print(f"| {name} | " + " | ".join(cells) + " |", flush=True)


def peak_attack(n: int = 10_000_000) -> None:
    """|r| over τ for fictitious noise at its bounds: random signs of every colour, and the signs of the reversed responses."""
    design = trained(process(), 1)
    tau = peak_threshold(design, 3.0, 1.8).level
    rng = np.random.default_rng(6)
    taps, Q = design.generator.taps, design.post_filter.Q
    path = Q.impulse_response(3000)[:, 0, 0]
    error_path = np.convolve(
        design.W_T.simulate(np.convolve(np.eye(1, 3000)[0], taps)[:3000]), path
    )[:3000]
    largest, block = 0.0, 100_000
    for k in range(n // block):
        if k % 2:
            e, d = 1.8 * np.sign(path[::-1]), 3.0 * np.sign(error_path[::-1])
            e, d = np.resize(e, block), np.resize(d, block)
        else:
            pole = rng.uniform(-0.995, 0.995)
            e, d = (
                a * np.sign(signal.lfilter([1.0], [1.0, -pole], rng.standard_normal(block)))
                for a in (1.8, 3.0)
            )
        y = e + design.W_T.simulate(np.convolve(d, taps)[:block])
        largest = max(largest, float(np.abs(Q.simulate(y[:, None])[0]).max()))
    print(
        f"\n### Peak threshold: largest |r|/τ over {n:.0e} adversarial samples: {largest / tau:.4f} (must not exceed 1)"
    )


def estimate_coverage(runs: int = 500) -> None:
    """Bias and 95 % coverage of the size, over joint draws of identification data, fault and noise."""
    plant, results = process(), []
    for seed in range(20):
        design = trained(plant, seed)
        rng = np.random.default_rng([seed, 4])
        for _ in range(runs // 20):
            size = rng.choice([-1.0, 1.0]) * rng.uniform(1.0, 5.0)
            u = rng.standard_normal(700)
            y = plant.run(u, rng) + size * (np.arange(700) >= 300)
            alarms = np.flatnonzero(
                design.bank(design.bank_threshold(RATE)).process(design.generator.run(u, y)).alarm
            )
            found = FaultEstimator(
                design.generator, design.model.covariance, design.model.delay
            ).estimate(u, y, int(alarms[0]))
            results.append((found.kind == "sensor-offset", (found.value - size) / found.std))
    named, z = (np.array(column) for column in zip(*results, strict=True))
    z = z[named]
    bias, spread = np.mean(z), np.std(z) / np.sqrt(len(z))
    print(f"\n### Size of a sensor offset (1 … 5), {runs} runs over 20 identified models\n")
    print(
        f"named rightly {np.mean(named):.1%}; bias {bias:+.2f} ± {spread:.2f} standard deviations; ",
        end="",
    )
    print(f"95 % band covers {np.mean(np.abs(z) < 1.96):.1%}")


def missing_physics() -> None:
    """A drive with dry friction: the smallest sensor offset found in all of twelve windows, before and after the effect is in."""
    machine = MACHINES["gate-drive"](
        seed=3, effects={"coulomb-friction": {}}, profile="rich", rate=100.0
    )
    training, windows = (
        [_drive_record(machine, seconds) for _ in range(n)]
        for seconds, n in ((60.0, 2), (20.0, 12))
    )
    print(
        "\n### Missing physics: offset of the speed sensor found in all of twelve windows of 20 s (gate drive, dry friction)\n"
    )
    print(
        "| model | held-out error | p of the healthy residual | limit | smallest offset found | false alarms |\n"
        + "|---" * 6
        + "|"
    )
    for added in ([], ["coulomb-friction"]):
        improved = improve(load_model("gate-drive"), training, add=added)
        healthy = [with_prediction(improved.model, record, "speed") for record in training]
        diagnoser = RobustResidual(input="prediction", output="speed").fit(healthy)
        predicted = [with_prediction(improved.model, record, "speed") for record in windows]
        false = sum(diagnoser.score(record).verdict == "faulty" for record in predicted)
        sizes = (
            size
            for size in np.geomspace(0.05, 20.0, 27)
            if all(_found(diagnoser, record, size) for record in predicted)
        )
        error, p = (
            f"{improved.history[-1].error:.2f} {improved.error_unit}",
            diagnoser.design.structured_p,
        )
        found = f"{next(sizes, np.inf):.2g} rad/s | {false} of {len(windows)}"
        print(
            f"| {added[0] if added else 'as it was'} | {error} | {p:.1g} | {diagnoser._threshold:.1f} | {found} |"
        )


def _drive_record(machine: Machine, seconds: float) -> Record:
    signals = machine.simulate(seconds)
    return Record(
        {name: signals.channels[name] for name in ("voltage", "speed")},
        {name: signals.units[name] for name in ("voltage", "speed")},
        signals.sample_time,
    )


def _found(diagnoser: RobustResidual, record: Record, size: float) -> bool:
    after = np.arange(record.n) >= record.n // 2
    faulty = replace(record, channels={**record.channels, "speed": record["speed"] + size * after})
    return diagnoser.score(faulty).verdict == "faulty"


def speed() -> None:
    print(
        "\n### Speed, processor seconds of one core\n\n| plant, lags | job | µs a sample | total |\n|---|---|---|---|"
    )
    for plant, seed in ((process(), 1), (two_resonances(), 2)):
        _speed_of(plant, trained(plant, seed))


def _speed_of(plant: Plant, design: ResidualDesign) -> None:
    diagnoser, rng = RobustResidual()._use(design), np.random.default_rng(8)
    name = f"{plant.name}, {design.model.order}"
    u = rng.standard_normal(1_000_000)
    y = plant.run(u, rng)
    loud = plant.run(u, rng, lambda rng, n: 3.0 * rng.standard_normal(n))
    diagnoser.stream().process(u[:2000], loud[:2000])
    for job, output in (
        ("residual and all scans", y),
        ("the same, noise three times as large", loud),
    ):
        started = time.process_time()
        diagnoser.stream().process(u, output)
        spent = time.process_time() - started
        print(f"| {name} | batch of 10⁶ samples, {job} | {spent:.2f} | {spent:.2f} s |", flush=True)
    for block, rounds in ((100, 1000), (10, 1000), (1, 5000)):
        stream = diagnoser.stream()
        started = time.process_time()
        for k in range(rounds):
            stream.process(u[k * block : (k + 1) * block], y[k * block : (k + 1) * block])
        spent = (time.process_time() - started) / (rounds * block)
        extra = f"1000 detectors at 10 Hz: {spent * 1e4:.0%} of a core" if block == 1 else ""
        print(f"| {name} | stream in blocks of {block} | {spent * 1e6:.1f} | {extra} |", flush=True)


def main() -> None:
    """All tables; `python -m benchmarks.residuals thesis|detection|random|alarms|models|peak|estimate|physics|speed` runs one."""
    parts: dict[str, Callable[[], None]] = {
        "thesis": thesis_steps,
        "detection": detection,
        "random": random_detection,
        "alarms": false_alarms,
        "models": model_rates,
        "peak": peak_attack,
        "estimate": estimate_coverage,
        "physics": missing_physics,
        "speed": speed,
    }
    for name in [argument for argument in sys.argv[1:] if argument in parts] or parts:
        parts[name]()


def detection() -> None:
    show("(4.10)", [delays(process(), 1, 200, 4)])
    show("(2.38)", [delays(two_resonances(), 2, 200, 4)])


def random_detection() -> None:
    show(
        "20 random plants",
        [delays(plant, 10 + k, 10, 1) for k, plant in enumerate(random_plants(20))],
    )


if __name__ == "__main__":
    main()
