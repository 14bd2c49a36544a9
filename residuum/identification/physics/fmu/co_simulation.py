"""An FMU that simulates itself along signals, from its own start."""

# mypy: disable-error-code="no-untyped-def,no-untyped-call,untyped-decorator"

from __future__ import annotations

import ctypes
from collections.abc import Mapping
from typing import Any

import numpy as np
from numba import njit

from residuum.array_types import FloatArray
from residuum.identification.errors import in_one_line
from residuum.identification.physics.fmu.description import fmpy
from residuum.identification.physics.fmu.instance import TOLERANCE, Instance
from residuum.identification.physics.fmu.loaded_library import ACCEPTED, by_reference


class OwnSimulation:
    """Simulations by the FMU's own solver: steps of co-simulation from sample to sample, compiled;
    without co-simulation those of fmpy, which follows the events of model exchange.

    Over a step an input keeps the mean of what it is at both ends where it moves evenly, which errs
    by the square of a sample; the outputs at a sample are asked for with the inputs there.
    """

    def __init__(self, instance: Instance) -> None:
        self.instance = instance
        self.says = ""
        # what compiled code points to is freed with what calls it
        self._steps: Any = None
        self._pointed_to: tuple[Any, ...] = ()
        if not instance.exchanged:
            self._steps, self._pointed_to = _compiled(instance)
        self._read: Any = (
            fmpy().read_model_description(str(instance.file), validate=False)
            if instance.exchanged
            else None
        )

    def along(
        self, U: FloatArray, hold: FloatArray, dt: float, values: Mapping[str, float]
    ) -> FloatArray:
        """Outputs (n, outputs) by inputs U (n, inputs) dt seconds apart, `hold` 1 where one moves
        evenly and 0 where it is held; NaN from where the FMU gives up, of which `says` tells.
        """
        U = np.ascontiguousarray(U, dtype=np.float64)
        self.says = ""
        if self._steps is None:
            return self._by_exchange(U, dt, values)
        Y = np.full((len(U), len(self.instance.description.outputs)), np.nan)
        if not self.instance.begin(values, U[0].tolist() if len(U) else ()):
            self.says = "it refuses its parameters"
            return Y
        between = U.copy()
        # The mean over a step of an input that moves evenly; one that is held keeps its value.
        between[:-1] += 0.5 * hold * np.diff(U, axis=0)
        reached = self._steps(U, between, dt, Y)
        if reached < len(U):
            self.says = f"its step from {dt * (reached - 1):.6g} s fails"
        return Y

    def _by_exchange(self, U: FloatArray, dt: float, values: Mapping[str, float]) -> FloatArray:
        described = self.instance.description
        time = dt * np.arange(len(U))
        held = np.zeros(
            max(2 * len(U) - 1, 1),
            dtype=[("time", float), *((v.name, float) for v in described.inputs)],
        )
        # Each time twice, with the value before and after: fmpy interpolates, and inputs are held.
        held["time"][::2] = time
        held["time"][1::2] = time[1:]
        for k, variable in enumerate(described.inputs):
            held[variable.name][::2] = U[:, k]
            held[variable.name][1::2] = U[:-1, k]
        try:
            self.instance.afresh()
            trajectory = fmpy().simulate_fmu(
                self.instance.folder,
                model_description=self._read,
                fmu_instance=self.instance.fmu,
                start_time=0.0,
                stop_time=float(time[-1]),
                output_interval=dt,
                relative_tolerance=TOLERANCE,
                start_values=dict(values),
                input=held if described.inputs else None,
                output=[v.name for v in described.outputs],
            )
        except Exception as error:
            self.says = in_one_line(error)
            return np.full((len(U), len(described.outputs)), np.nan)
        # The last row at or before each sample: events may have added rows at its time.
        at = np.clip(np.searchsorted(trajectory["time"], time + 1e-3 * dt) - 1, 0, None)
        return np.stack([np.asarray(trajectory[v.name])[at] for v in described.outputs], axis=1)


def _compiled(instance: Instance) -> tuple[Any, tuple[Any, ...]]:
    """What steps through a record and gives the number of samples that were reached; and what it
    points to.
    """
    described = instance.description
    two = described.version == 2
    component = instance.component
    nu = len(described.inputs)
    ny = len(described.outputs)
    pointer = ctypes.c_void_p
    size = ctypes.c_size_t
    double = ctypes.c_double
    by = (pointer, pointer, size, pointer) + (() if two else (size,))
    functions = {
        "set": instance.function("SetReal" if two else "SetFloat64", *by),
        "get": instance.function("GetReal" if two else "GetFloat64", *by),
        "version": described.version,
    }
    flag = ctypes.c_int if two else ctypes.c_int8
    more = () if two else (pointer, pointer, pointer, pointer)
    do_step = instance.function("DoStep", pointer, double, double, flag, *more)
    references = np.array(
        [v.reference for v in (*described.inputs, *described.outputs)], dtype=np.uint32
    )
    replies = np.zeros(4)
    ins = references.ctypes.data
    flags = replies.ctypes.data
    put, take = by_reference(functions, component, (ins, nu), (ins + 4 * nu, ny))
    if two:
        step = njit(lambda t, h: do_step(component, t, h, 1))
    else:
        step = njit(
            lambda t, h: do_step(component, t, h, 1, flags, flags + 8, flags + 16, flags + 24)
        )

    @njit(nogil=True)
    def steps(U, between, dt, Y):
        n = len(U)
        for k in range(n):
            if nu > 0:
                put(U.ctypes.data + 8 * nu * k)
            if take(Y.ctypes.data + 8 * ny * k) > ACCEPTED:
                Y[k:] = np.nan
                return k
            if k + 1 == n:
                return n
            if nu > 0:
                # Outputs at a sample were asked for with the inputs there; the step takes their
                # mean.
                put(between.ctypes.data + 8 * nu * k)
            if step(k * dt, dt) > ACCEPTED:
                return k + 1
        return n

    return steps, (references, replies, functions, do_step)
