"""Prediction error methods: coverage of the ellipsoids, order and fit on (2.38), held-out fit on real data beside peers."""

import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
from scipy import signal
from scipy.io import loadmat
from scipy.stats import binomtest

from benchmarks.peers import run_peer
from residuum.identification.errors import NotIdentifiable
from residuum.identification.kernel_based.delay import estimate_delay
from residuum.identification.kernel_based.impulse_response import identify_impulse_response
from residuum.identification.linear_models.identified_model import IdentifiedModel
from residuum.identification.linear_models.prediction_error import (
    STRUCTURES,
    Orders,
    identify,
    in_confidence_ellipsoid,
)
from residuum.identification.linear_models.prediction_error.criterion import Criterion
from residuum.identification.linear_models.prediction_error.data import signals
from residuum.identification.linear_models.prediction_error.search import minimise
from residuum.identification.record import Record

DATA = Path(__file__).parents[2] / "shared/data"
SCRATCH = Path("/tmp/residuum-prediction-error.npz")
# (2.38) of the source
NUMERATOR, DENOMINATOR = ([0, 0, 0.28261, 0.50666], [1, -1.41833, 1.58939, -1.31608, 0.88642])
SYSTEMS, DRAWS = 500, 20
# its estimate, 2, is wrong: the resonance is far below the sampling rate
DELAYS = {"Silverbox, small amplitude": 1}
PATIENCE = 180  # seconds for all orders of one peer

# The peers simulate the whole input with each of their models; every order is tried, the best on the held-out part counts.
PEER = """
import contextlib, io, json, time, warnings
import numpy as np
warnings.simplefilter("ignore")
data = np.load(%r)
u, y, n = data["u"], data["y"], int(data["cut"])
found = []
for order in %s:
    started = time.process_time()
    try:
        with contextlib.redirect_stdout(io.StringIO()):
            simulated = simulate(order)
    except Exception:
        continue
    if np.isfinite(simulated).all():
        found.append([order, time.process_time() - started, simulated.ravel().tolist()])
print(json.dumps(found))
"""
SIPPY_OE = """
from scipy import signal
from sippy_unipi import system_identification
def simulate(order):
    model = system_identification(y[:n], u[:n], "OE", OE_orders=[order, order, 0])
    num, den = np.ravel(model.G.num[0][0]), np.ravel(model.G.den[0][0])
    return signal.lfilter(np.r_[np.zeros(len(den) - len(num)), num], den, u)
"""
SIPPY_N4SID = """
from scipy import signal
from sippy_unipi import system_identification
def simulate(order):
    model = system_identification(y[:n], u[:n], "N4SID", SS_fixed_order=order)
    return signal.dlsim((model.A, model.B, model.C, model.D, 1.0), u)[1]
"""
JAX_SYSID = """
from jax_sysid.models import LinearModel
def simulate(order):
    su, sy = u[:n].std(), y[:n].std()
    model = LinearModel(order, 1, 1, feedthrough=False)
    model.loss(rho_x0=1e-3, rho_th=1e-6)
    model.optimization(adam_epochs=500, lbfgs_epochs=1500, iprint=-1)
    model.fit(y[:n, None] / sy, u[:n, None] / su)
    return np.asarray(model.predict(model.x0, u[:, None] / su)[0]) * sy
"""
PEERS = {
    "SIPPY 1.0.1, N4SID": ("sippy", "sippy_unipi==1.0.1", SIPPY_N4SID, (1, 2, 3, 4, 6, 8)),
    "SIPPY 1.0.1, OE": ("sippy", "sippy_unipi==1.0.1", SIPPY_OE, (2, 3, 4)),
    "jax-sysid 1.1.0": ("jax", "jax-sysid==1.1.0", JAX_SYSID, (2, 3, 4, 6)),
}


def random_polynomial(rng: np.random.Generator, order: int, largest: float = 0.95) -> np.ndarray:
    """A monic polynomial with roots of radius 0.3 … `largest`, in pairs and alone."""
    pairs, single = divmod(order, 2)
    roots = rng.uniform(0.3, largest, pairs) * np.exp(1j * rng.uniform(0.1, 3.0, pairs))
    alone = rng.uniform(0.3, largest, single) * rng.choice([-1, 1], single)
    return np.real(np.poly(np.concatenate([roots, roots.conj(), alone])))


def random_case(structure: str, order: int, seed: int, n: int) -> tuple[Record, np.ndarray]:
    """A record of a random stable system of this structure, variance ratio 10, and its [numerator, denominator₁…]."""
    rng = np.random.default_rng([seed, order, len(structure)])
    b, a = rng.standard_normal(order), random_polynomial(rng, order)
    c, d = random_polynomial(rng, order, 0.9), random_polynomial(rng, order, 0.9)
    noise = {"arx": ([1], a), "armax": (c, a), "oe": ([1], [1]), "bj": (c, d)}[structure]
    u, e = rng.standard_normal(n + 500), rng.standard_normal(n + 500)
    w, v = signal.lfilter(np.r_[0, b], a, u), signal.lfilter(*noise, e)
    y = w + v * np.sqrt(w.var() / v.var() / 10)
    return Record({"u": u[500:], "y": y[500:]}, {"u": "", "y": ""}, 1.0), np.r_[b, a[1:]]


def nearest_cancellation(theta: np.ndarray, order: int) -> float:
    """The smallest distance of a pole from a zero; infinite without zeros."""
    zeros, poles = np.roots(theta[:order]), np.roots(np.r_[1.0, theta[order:]])
    return float(np.abs(np.subtract.outer(zeros, poles)).min(initial=np.inf))


def coverage() -> None:
    print("## Coverage of the 95 % ellipsoids (1.107)\n")
    print(
        f"{SYSTEMS} random stable systems a row of order 1, 2, 3 in turn, all of them counted: poles, and zeros of the noise, of"
    )
    print(
        "radius 0.3 to 0.95, random zeros of the plant, white input, variance ratio 10, right structure and order, χ² limit."
    )
    print(
        "In brackets the 95 % interval of chance. Where a pole nearly cancels a zero, first-order covariances fail: the second"
    )
    print("column of shares leaves out the systems that have one within 0.1 of a zero.\n")
    print(
        "| structure | n | covered, all systems [%] | without near cancellations [%] | CPU [s] |\n|---|---|---|---|---|"
    )
    for n in (1000, 10_000):
        for structure in ("arx", "armax", "oe", "bj"):
            started, inside, clear = (
                time.process_time(),
                np.zeros(SYSTEMS, dtype=bool),
                np.zeros(SYSTEMS, dtype=bool),
            )
            for seed in range(SYSTEMS):
                order = 1 + seed % 3
                record, theta = random_case(structure, order, seed, n)
                clear[seed] = nearest_cancellation(theta, order) >= 0.1
                model = identify(STRUCTURES[structure], [record], "u", "y", order=order)
                inside[seed] = in_confidence_ellipsoid(model, theta)
            seconds = time.process_time() - started
            print(
                f"| {structure} | {n} | {_share(inside)} | {_share(inside[clear])} | {seconds:.0f} |",
                flush=True,
            )
    print()


def _share(inside: np.ndarray) -> str:
    low, high = binomtest(int(inside.sum()), len(inside)).proportion_ci(0.95)
    return f"{100 * inside.mean():.1f} ({100 * low:.1f} … {100 * high:.1f})"


def resonant_record(seed: int) -> Record:
    """(2.38), white input, n = 5000, variance ratio 25."""
    rng = np.random.default_rng(seed)
    u = rng.standard_normal(6000)
    y = signal.lfilter([0, *NUMERATOR], DENOMINATOR, u)
    y += rng.standard_normal(6000) * np.sqrt(y.var() / 25)
    return Record({"u": u[1000:], "y": y[1000:]}, {"u": "", "y": ""}, 0.01)


def maximum_likelihood(record: Record) -> tuple[float, np.ndarray, np.ndarray]:
    """(Σ e², numerator, denominator) of the search that starts at the truth."""
    data = signals([record], "u", "y", offset=True)
    criterion = Criterion(data, Orders(nb=4, nf=4))
    gain = data.y_scale / data.u_scale
    found = minimise(
        criterion,
        criterion.start(np.r_[np.array(NUMERATOR) / gain, DENOMINATOR[1:]]),
        iterations=200,
    )
    return found.normal.cost * data.y_scale**2, gain * found.x[:4], np.r_[1.0, found.x[4:8]]


def response_fit(numerator: np.ndarray, denominator: np.ndarray) -> float:
    """100 (1 − ‖g − g₀‖/‖g₀‖) over 300 lags [%]."""
    pulse = np.r_[0.0, 1.0, np.zeros(299)]
    g0, g = (
        signal.lfilter(NUMERATOR, DENOMINATOR, pulse),
        signal.lfilter(numerator, denominator, pulse),
    )
    return float(100 * (1 - np.linalg.norm(g - g0) / np.linalg.norm(g0)))


def resonant_system() -> None:
    print("## Output error on (2.38): orders 1 … 10, BIC\n")
    rows = []
    for seed in range(DRAWS):
        record = resonant_record(seed)
        started = time.process_time()
        model = identify(STRUCTURES["oe"], [record], "u", "y")
        seconds = time.process_time() - started
        cost, numerator, denominator = maximum_likelihood(record)
        # 8 coefficients, the level, 4 of the initial state
        ours = model.noise_variance * (record.n - 4 - 9)
        order = model.provenance["candidates"].index(model.provenance["orders"]) + 1
        stable = all(
            identify(STRUCTURES["oe"], [record], "u", "y", order=k).transfer_function().is_stable
            for k in range(1, 11)
        )
        fit = response_fit(model.numerator[:4], model.denominator)
        rows.append(
            (
                seconds,
                order,
                fit,
                response_fit(numerator, denominator),
                abs(ours - cost) / cost,
                stable,
            )
        )
    seconds, order, fit, best, difference, stable = (
        np.array(column) for column in zip(*rows, strict=True)
    )
    print(f"{DRAWS} draws, n = 5000, variance ratio 25; the fit is that of the impulse response.\n")
    print("| figure | value |\n|---|---|")
    print(f"| CPU for orders 1 … 10 and the final fit, median [s] | {np.median(seconds):.2f} |")
    print(f"| order 4 chosen | {np.sum(order == 4)} of {DRAWS} |")
    print(
        f"| fit [%]: least, median, largest | {fit.min():.2f}, {np.median(fit):.2f}, {fit.max():.2f} |"
    )
    print(
        f"| fit of maximum likelihood started at the truth [%] | {best.min():.2f}, {np.median(best):.2f}, {best.max():.2f} |"
    )
    four = order == 4
    print(f"| largest relative difference of Σ e² to it, order 4 | {difference[four].max():.1e} |")
    print(f"| largest difference of the fits, order 4 [%] | {np.abs(fit - best)[four].max():.1e} |")
    print(
        f"| fits at or above 99.3 % | {np.sum(fit >= 99.3)} of {DRAWS} (of maximum likelihood: {np.sum(best >= 99.3)}) |"
    )
    print(f"| unstable models among {10 * DRAWS} | {10 * DRAWS if not stable.all() else 0} |\n")


def held_out_fit(y: np.ndarray, simulated: np.ndarray) -> float:
    """100 (1 − std(y − ŷ)/std y) [%]: the level is free, for all methods alike."""
    return float(100 * (1 - np.std(y - simulated) / np.std(y)))


def recordings() -> dict[str, Record]:
    """The dryer and the exchanger of DaISy, and the first quarter of the Silverbox's growing noise."""
    dryer, exchanger = (
        np.loadtxt(DATA / "daisy/dryer.dat"),
        np.loadtxt(DATA / "daisy/exchanger.dat"),
    )
    silverbox = loadmat(DATA / "silverbox/SNLS80mV.mat")
    part = slice(100, 10_100)
    return {
        "DaISy dryer": Record({"u": dryer[:, 0], "y": dryer[:, 1]}, {"u": "V", "y": "degC"}, 0.08),
        "DaISy exchanger": Record(
            {"u": exchanger[:, 1], "y": exchanger[:, 2]}, {"u": "", "y": "degC"}, 1.0
        ),
        "Silverbox, small amplitude": Record(
            {"u": silverbox["V1"].ravel()[part], "y": silverbox["V2"].ravel()[part]},
            {"u": "V", "y": "V"},
            1 / 610.35,
        ),
    }


def ours(record: Record, cut: int, delay: int) -> list[tuple[str, str, float, np.ndarray]]:
    """(method, order, CPU seconds, simulated output) of each of Residuum's methods."""
    part, found = record.window(0, cut), []
    methods: dict[str, Callable[[], IdentifiedModel]] = {
        f"Residuum {name}, BIC": partial(identify, STRUCTURES[name], [part], "u", "y", delay=delay)
        for name in ("arx", "armax", "oe", "bj")
    }
    methods["Residuum oe, 5-fold"] = partial(
        identify, STRUCTURES["oe"], [part], "u", "y", delay=delay, criterion="k-fold"
    )
    methods["Residuum kernel tc"] = partial(
        identify_impulse_response, part, "u", "y", order=100, delay=delay
    )
    for name, method in methods.items():
        started = time.process_time()
        try:
            model = method()
        except NotIdentifiable as reason:
            print(f"{name}: {reason}\n")
            continue
        order = model.provenance.get("orders", "m = 100")
        seconds = time.process_time() - started
        found.append((name, order, seconds, model.simulate(record["u"] - np.mean(part["u"]))))
    return found


def peers(record: Record, cut: int, delay: int) -> list[tuple[str, str, float, np.ndarray]]:
    """The same of each peer, every order that was tried; the input is shifted so that their one sample of delay is right."""
    u, y = (record[name] - np.mean(record[name][:cut]) for name in ("u", "y"))
    shifted = u[np.clip(np.arange(len(u)) - (delay - 1), 0, len(u) - 1)]
    np.savez(SCRATCH, u=shifted, y=y, cut=cut)
    found = []
    for name, (environment, package, script, orders) in PEERS.items():
        result = run_peer(
            environment, [package], script + PEER % (str(SCRATCH), orders), timeout=PATIENCE
        )
        if result is None:
            print(f"{name}: not installed, or not done within {PATIENCE} s\n")
        found += [
            (name, str(order), seconds, np.array(simulated))
            for order, seconds, simulated in result or []
        ]
    SCRATCH.unlink()
    return found


def real_data() -> None:
    print("## Held-out simulation fit on real data\n")
    if not DATA.is_dir():
        print("skipped: no real recordings here\n")
        return
    print(
        "The first 60 % estimate, the rest is held out; simulation from the first sample on, no measured output used, level free."
    )
    print(
        "Residuum chooses its order from the estimation part. Of a peer's orders the one of the best *held-out* fit is shown.\n"
    )
    for name, record in recordings().items():
        cut = int(0.6 * record.n)
        part = record.window(0, cut)
        estimated = estimate_delay([part], "u", "y", kernel="tc", offset=True).delay
        delay = DELAYS.get(name, estimated)
        print(
            f"### {name}\n\n{cut} samples estimate, {record.n - cut} are held out; delay {delay}, estimated {estimated}.\n"
        )
        best: dict[str, tuple[float, str, float]] = {}
        for method, order, seconds, simulated in ours(record, cut, delay) + peers(
            record, cut, delay
        ):
            fit = held_out_fit(record["y"][cut:], simulated[cut:])
            best[method] = max(best.get(method, (-np.inf, "", 0.0)), (fit, order, seconds))
        print("| method | order | held-out fit [%] | CPU [s] |\n|---|---|---|---|")
        for method, (fit, order, seconds) in best.items():
            print(f"| {method} | {order} | {fit:.2f} | {seconds:.2f} |", flush=True)
        print()


def main() -> None:
    print("# Prediction error methods, measured\n")
    print(
        "`python -m benchmarks prediction_error`. CPU: processor time of all threads of one run.\n"
    )
    resonant_system()
    real_data()
    coverage()


if __name__ == "__main__":
    main()
