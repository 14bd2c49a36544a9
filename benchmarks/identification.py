"""Kernel identification: time, memory, growth, accuracy beside peers; coverage of the posterior bands.

gpytorch is not among the peers: installing it fetches gigabytes of CUDA.
"""

import math
import resource
import time
import tracemalloc
from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy import linalg, optimize, signal
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import Hyperparameter, Kernel, WhiteKernel

from benchmarks.peers import run_peer
from residuum.identification.errors import NotIdentifiable
from residuum.identification.kernel_based.impulse_response import identify_impulse_response
from residuum.identification.kernel_based.kernels import KERNELS
from residuum.identification.linear_models.identified_model import IdentifiedModel
from residuum.identification.record import Record

# (2.38) of the source
NUMERATOR, DENOMINATOR = ([0, 0, 0, 0.28261, 0.50666], [1, -1.41833, 1.58939, -1.31608, 0.88642])
SYSTEMS = 500
SCRATCH = Path("/tmp/residuum-benchmark-record.npz")

IMPULSEEST = """
import json, time, numpy as np
from impulseest import impulseest
data = np.load(%r)
u, y = data["u"][:%d], data["y"][:%d]
started = time.process_time()
g = impulseest(u, y, n=100, RegularizationKernel="TC")
print(json.dumps({"seconds": time.process_time() - started, "g": g.ravel().tolist()}))
"""


def resonant_record(n: int, seed: int = 0) -> Record:
    """(2.38), white input, variance ratio 25."""
    rng = np.random.default_rng(seed)
    u = rng.standard_normal(n + 1000)
    y = signal.lfilter(NUMERATOR, DENOMINATOR, u)
    y += rng.standard_normal(n + 1000) * math.sqrt(y.var() / 25)
    return Record({"u": u[1000:], "y": y[1000:]}, {"u": "", "y": ""}, 0.01)


def textbook(record: Record, order: int) -> tuple[float, float]:
    """Smallest −log p of the TC kernel by the n × n form and a simplex search; and the seconds of one evaluation."""
    u, y = record["u"], record["y"][order:]
    Phi = np.lib.stride_tricks.sliding_window_view(u[:-1], order)[:, ::-1]
    seconds = []

    def value(x: np.ndarray) -> float:
        started = time.process_time()
        Z = (
            math.exp(x[1])
            * Phi
            @ KERNELS["tc"].matrix(order, [KERNELS["tc"].parameters[0].value(x[0])])
            @ Phi.T
        )
        T = np.linalg.cholesky(Z + math.exp(x[2]) * np.eye(len(y)))
        a = linalg.solve_triangular(T, y, lower=True)
        seconds.append(time.process_time() - started)
        return (
            0.5 * float(a @ a)
            + float(np.log(np.diag(T)).sum())
            + 0.5 * len(y) * math.log(2 * math.pi)
        )

    found = optimize.minimize(
        value, [3.0, 0.0, -1.0], method="Nelder-Mead", options={"xatol": 1e-5, "fatol": 1e-6}
    )
    return float(found.fun), float(np.median(seconds)) * len(seconds)


class TunedCorrelatedOfRegressors(Kernel):
    """scikit-learn's form of x ↦ gᵀx with a TC prior of g."""

    def __init__(self, scale: float = 1.0, time_constant: float = 20.0) -> None:
        self.scale, self.time_constant = scale, time_constant

    hyperparameter_scale = Hyperparameter("scale", "numeric", (1e-4, 1e4))
    hyperparameter_time_constant = Hyperparameter("time_constant", "numeric", (1.0, 1e3))

    def _matrix(self, m: int) -> tuple[np.ndarray, np.ndarray]:
        late = np.maximum.outer(np.arange(1, m + 1), np.arange(1, m + 1))
        K = self.scale * np.exp(-late / self.time_constant)
        return K, K * late / self.time_constant

    def __call__(self, X, Y=None, eval_gradient=False):
        K, by_time = self._matrix(X.shape[1])
        gram = X @ K @ (X if Y is None else Y).T
        return (gram, np.stack([gram, X @ by_time @ X.T], axis=-1)) if eval_gradient else gram

    def diag(self, X):
        return np.einsum("ij,jk,ik->i", X, self._matrix(X.shape[1])[0], X)

    def is_stationary(self):
        return False


def scikit_learn(record: Record, order: int) -> tuple[float, np.ndarray]:
    """Seconds and impulse response of scikit-learn's Gaussian process with the same prior."""
    Phi = np.lib.stride_tricks.sliding_window_view(record["u"][:-1], order)[:, ::-1]
    started = time.process_time()
    process = GaussianProcessRegressor(TunedCorrelatedOfRegressors() + WhiteKernel()).fit(
        Phi, record["y"][order:]
    )
    return time.process_time() - started, process.predict(np.eye(order))


def seconds_of(job: Callable[[], object], repeats: int = 9) -> float:
    times = []
    for _ in range(repeats):
        started = time.process_time()
        job()
        times.append(time.process_time() - started)
    return float(np.median(times))


def fit_percent(g: np.ndarray) -> float:
    truth = signal.lfilter(NUMERATOR, DENOMINATOR, np.eye(1, len(g) + 1)[0])[1:]
    return float(100 * (1 - np.linalg.norm(g - truth) / np.linalg.norm(truth - truth.mean())))


def peers() -> None:
    print("## Beside peers\n\n(2.38), m = 100, TC, hyper-parameters and noise variance included.\n")
    print("| method | n | time [ms] | fit of the impulse response [%] |\n|---|---|---|---|")
    record = resonant_record(1_000_000)
    np.savez(SCRATCH, u=record["u"], y=record["y"])
    for n in (1000, 5000, 100_000, 1_000_000):
        part = record.window(0, n)
        for tail, says in ((0, "Residuum"), (None, "Residuum, with a tail of 50")):
            fitted = identify_impulse_response(part, "u", "y", tail=tail)
            seconds = seconds_of(
                lambda part=part, tail=tail: identify_impulse_response(part, "u", "y", tail=tail),
                15 if n < 10**6 else 5,
            )
            print(
                f"| {says} | {n} | {1e3 * seconds:.1f} | {fit_percent(fitted.impulse_response):.2f} |"
            )
    for n in (1000, 5000, 100_000):
        found = run_peer(
            "identification",
            ["impulseest==1.0", "numpy==1.26.4", "scipy==1.13.1"],
            IMPULSEEST % (str(SCRATCH), n, n),
        )
        says = (
            "| not installed | |"
            if found is None
            else f"| {1e3 * found['seconds']:.0f} | {fit_percent(np.ravel(found['g'])[1:]):.2f} |"
        )
        print(f"| impulseest 1.0 (lags 0 … 99) | {n} {says}")
    seconds, g = scikit_learn(record.window(0, 1000), 100)
    print(
        f"| scikit-learn GaussianProcessRegressor | 1000 | {1e3 * seconds:.0f} | {fit_percent(g):.2f} |"
    )
    value, seconds = textbook(record.window(0, 1000), 100)
    ours = identify_impulse_response(
        record.window(0, 1000), "u", "y", offset=False, tail=0
    ).negative_log_likelihood
    print(f"| textbook n × n, simplex search | 1000 | {1e3 * seconds:.0f} | |")
    difference = (ours - value) / abs(value)
    print(
        f"\nOptimum of −log p at n = 1000: {ours:.6f}; textbook {value:.6f}; relative difference {difference:.1e}.\n"
    )
    SCRATCH.unlink()


def growth() -> None:
    print(
        "## Growth\n\n| n (m = 100) | time [ms] | time/n [ns] | memory beyond the record [MB] |\n|---|---|---|---|"
    )
    for exponent in (3, 4, 5, 6, 7):
        record = resonant_record(10**exponent)
        job = lambda record=record: identify_impulse_response(record, "u", "y", tail=0)  # noqa: E731
        seconds = seconds_of(job, 9 if exponent < 6 else 3)
        tracemalloc.start()
        job()
        peak = tracemalloc.get_traced_memory()[1] / 1e6
        tracemalloc.stop()
        print(
            f"| 10^{exponent} | {1e3 * seconds:.1f} | {1e9 * seconds / 10**exponent:.0f} | {peak:.1f} |"
        )
    print(
        f"\nPeak resident size of the whole run: {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3:.0f} MB.\n"
    )
    print("| m (n = 20 000) | " + " | ".join(KERNELS) + " |\n|---|" + "---|" * len(KERNELS))
    record = resonant_record(20_000)
    for order in (25, 50, 100, 200, 500, 1000):
        times = [
            seconds_of(
                lambda kernel=kernel, order=order: identify_impulse_response(
                    record, "u", "y", kernel=kernel, order=order, tail=0
                ),
                3,
            )
            for kernel in (KERNELS if order <= 200 else ["tc", "di"])
        ]
        cells = [f"{1e3 * seconds:.0f} ms" for seconds in times]
        cells = cells if order <= 200 else [cells[0], "", "", cells[1]]
        print(f"| {order} | " + " | ".join(cells) + " |")
    print()


def random_system(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """A stable system of order 1 … 6 with poles of radius 0.3 … 0.95 and random zeros."""
    pairs, single = rng.integers(0, 4), rng.integers(0, 2)
    radius, angle = rng.uniform(0.3, 0.95, pairs), rng.uniform(0.05, 3.0, pairs)
    poles = np.concatenate(
        [
            radius * np.exp(1j * angle),
            radius * np.exp(-1j * angle),
            rng.uniform(-0.9, 0.95, max(int(single), int(pairs == 0))),
        ]
    )
    return np.concatenate([[0.0], rng.standard_normal(len(poles))]), np.real(np.poly(poles))


def covered(
    model: IdentifiedModel, numerator: np.ndarray, denominator: np.ndarray, omega: np.ndarray
) -> np.ndarray:
    """Whether the 95 % ellipse of every frequency holds the truth, and the share of coefficients within 1.96 std."""
    error = model.frequency_response(omega) - signal.freqz(numerator, denominator, omega)[1]
    parts = np.stack([error.real, error.imag], axis=-1)
    distance = np.einsum(
        "ki,kij,kj->k",
        parts,
        np.linalg.pinv(model.frequency_covariance(omega), hermitian=True),
        parts,
    )
    truth = signal.lfilter(numerator, denominator, np.eye(1, model.order + 1)[0])[1:]
    return np.append(
        distance < 5.991,
        np.mean(np.abs(model.impulse_response - truth) < 1.96 * model.conditional_std),
    )


def coverage() -> None:
    omega = np.array([0.02, 0.1, 0.3, 1.0, 2.0, 3.0])
    print("## Coverage of the 95 % bands\n")
    print(
        f"{SYSTEMS} random stable systems of order 1 to 6 (poles of radius ≤ 0.95), white input, n = 500, m = 80, as it is:"
    )
    print(
        "the posterior at the estimated hyper-parameters, and what their own uncertainty adds to first order. ω in rad/sample;"
    )
    print("last column: the share of coefficients within 1.96 standard deviations.\n")
    heads = [f"ω = {w:g}" for w in omega]
    print(
        "| kernel | variance ratio | "
        + " | ".join(heads)
        + " | g |\n|---|---|"
        + "---|" * (len(omega) + 1)
    )
    for kernel in KERNELS:
        for ratio in (1.0, 10.0, 100.0):
            hits = []
            for seed in range(SYSTEMS):
                rng = np.random.default_rng(seed)
                numerator, denominator = random_system(rng)
                u = rng.standard_normal(1000)
                y = signal.lfilter(numerator, denominator, u)
                y += rng.standard_normal(1000) * math.sqrt(y.var() / ratio)
                record = Record({"u": u[500:], "y": y[500:]}, {"u": "", "y": ""}, 1.0)
                try:
                    hits.append(
                        covered(
                            identify_impulse_response(record, "u", "y", kernel=kernel, order=80),
                            numerator,
                            denominator,
                            omega,
                        )
                    )
                except NotIdentifiable:
                    continue
            print(
                f"| {kernel} | {ratio:g} | "
                + " | ".join(f"{100 * share:.0f} %" for share in np.mean(hits, axis=0))
                + " |"
            )
    print()


def main() -> None:
    print("# Kernel identification, measured\n")
    print(
        "`python -m benchmarks identification`. Processor time of all threads, medians of one run; compare by ratio, absolute"
    )
    print("times depend on what else the machine does.\n")
    peers()
    growth()
    coverage()


if __name__ == "__main__":
    main()
