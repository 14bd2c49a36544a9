"""The physics engine beside CasADi in one run: 50 000 Runge–Kutta steps of a drive with friction, with and without sensitivities.

    .venv/bin/python benchmarks/physics.py

Prints CPU milliseconds (best of several runs) beside CasADi's mapped integrator, and the time to compile a structure that
was never compiled before. With ../shared/data present it also fits the Silverbox oscillator and prints its simulation errors.
"""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")

import casadi as ca
import numpy as np
from scipy.io import loadmat

from residuum.identification.physics import (
    Experiment,
    PhysicalModel,
    Simulator,
    estimate,
    load_model,
    match,
)
from residuum.identification.record import Record

SILVERBOX = Path(__file__).parents[2] / "shared/data/silverbox/SNLS80mV.mat"
N, TS = 50_000, 2e-4


def cpu_milliseconds(run: Callable[[], object], repeats: int = 7) -> float:
    run()
    best = np.inf
    for _ in range(repeats):
        begin = time.process_time()
        run()
        best = min(best, time.process_time() - begin)
    return 1e3 * best


def drive() -> PhysicalModel:
    model = load_model("gate-drive").with_effect("coulomb-friction", "shaft", {"tau_c": 0.05})
    return model.with_effect("viscous-friction", "shaft", {"d": 2e-5})


def casadi_drive(u: np.ndarray) -> Callable[[], object]:
    R, K, J, tau_c, d, h = 0.7473, 0.0696, 2.812e-4, 0.05, 2e-5, TS
    x, v = ca.SX.sym("x", 2), ca.SX.sym("v")

    def f(x: ca.SX) -> ca.SX:
        return ca.vertcat(
            x[1], (K * (v - K * x[1]) / R - tau_c * ca.tanh(x[1] / 0.5) - d * x[1]) / J
        )

    k1 = f(x)
    k2 = f(x + h / 2 * k1)
    k3 = f(x + h / 2 * k2)
    step = ca.Function("step", [x, v], [x + h / 6 * (k1 + 2 * k2 + 2 * k3 + f(x + h * k3))])
    mapped = step.mapaccum(N)
    return lambda: mapped([0.0, 0.0], u[None, :])


def cold_compile() -> float:
    """CPU seconds from a model's text to its first simulation, for a structure that is in no cache."""
    with tempfile.TemporaryDirectory() as folder:
        before, os.environ["RESIDUUM_CACHE"] = os.environ.get("RESIDUUM_CACHE"), folder
        begin = time.process_time()
        model = (
            drive()
            .with_effect("hysteresis", "shaft", {"f_c": 0.01, "x_0": 0.1})
            .with_effect("cubic-spring", "shaft")
        )
        e = Experiment(np.zeros((10, 1)), np.full((10, 2), np.nan), np.zeros(1), TS)
        Simulator(model).run(e, slopes=["R"])
        seconds = time.process_time() - begin
        os.environ.pop("RESIDUUM_CACHE") if before is None else os.environ.update(
            RESIDUUM_CACHE=before
        )
    return seconds


def speed() -> None:
    u = 24 * np.sin(2 * TS * np.arange(N))
    experiment = Experiment(u[:, None], np.full((N, 2), np.nan), np.ones(1), TS)
    simulator = Simulator(drive())
    columns = [*simulator.model.free, "missing@shaft", "initial:theta", "initial:omega"]
    plain = cpu_milliseconds(lambda: simulator.run(experiment, substeps=1))
    slopes = cpu_milliseconds(lambda: simulator.run(experiment, substeps=1, slopes=columns))
    peer = cpu_milliseconds(casadi_drive(u))
    print(
        f"50 000 steps: {plain:.1f} ms, with {len(columns)} sensitivities {slopes:.1f} ms; CasADi {peer:.1f} ms without"
    )
    print(f"a structure never compiled before: {cold_compile():.2f} s to its first sensitivities")


def silverbox() -> None:
    if not SILVERBOX.exists():
        print("skipped: no real recordings here")
        return
    data = loadmat(SILVERBOX)
    u, y = (data[name].ravel().astype(float) for name in ("V1", "V2"))
    units = {"force": "V", "position": "V"}

    def record(start: int, stop: int) -> Record:
        return Record(
            {"force": u[start:stop], "position": y[start:stop]}, units, sample_time=1 / 610.35
        )

    split = 40650 + int(0.75 * (127400 - 40650))
    parts = {
        "train": (40650, split),
        "multisine": (split, 127400),
        "arrow": (100, 40575),
        "arrow, no extrapolation": (100, 32100),
    }
    for name, model in (
        ("linear", load_model("oscillator")),
        ("cubic", load_model("oscillator").with_effect("cubic-spring", "mass")),
    ):
        fitted = estimate(*match(model, [record(*parts["train"])])).model
        for part in list(parts)[1:]:
            residual = estimate(*match(fitted, [record(*parts[part])]), free=()).residuals[0][50:]
            print(f"Silverbox, {name}, {part}: {1e3 * np.sqrt(np.mean(residual**2)):.3f} mV")


if __name__ == "__main__":
    speed()
    silverbox()
