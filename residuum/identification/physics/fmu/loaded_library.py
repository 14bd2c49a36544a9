"""An FMU's library in this process: its rates and outputs as a function of time, states and inputs,
for compiled code.

Its slopes are central differences. The FMU is one object with a state of its own, so what calls it
holds a lock, and the last point is remembered: a step asks for each rate at the same point.
"""

# mypy: disable-error-code="no-untyped-def,no-untyped-call,untyped-decorator,attr-defined,call-arg"

from __future__ import annotations

import ctypes
import tempfile
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from numba import carray, cfunc, njit, types
from numba.extending import intrinsic

from residuum.identification.errors import BadModel, in_one_line
from residuum.identification.physics.compile.external import SYMBOLS
from residuum.identification.physics.compile.machine_code import ADDRESSES
from residuum.identification.physics.fmu.description import Description, fmpy

Array = npt.NDArray[np.float64]
_STEP = 1e-6
_KEPT: list[Any] = []
"""What compiled code points to, and must not be freed."""


@dataclass(frozen=True, eq=False)
class LoadedLibrary:
    """`value(point)` gives rates, then outputs, at a point (time, states, inputs); `start` has the
    first states and inputs.
    """

    description: Description
    value: Any
    start: Array


@intrinsic
def _doubles(typingctx, address):
    """A pointer to doubles from an address."""

    def made(context, builder, signature, arguments):
        return builder.inttoptr(arguments[0], context.get_value_type(signature.return_type))

    return types.CPointer(types.float64)(types.intp), made


def load(description: Description) -> LoadedLibrary:
    """Load an FMU for model exchange, once a process, and let generated code call it.

    Raises
    ------
    BadModel
        It refuses to be set up.
    """
    instance, functions = _instance(description)
    nx, nu, ny = len(description.states), len(description.inputs), len(description.outputs)
    n, m = 1 + nx + nu, nx + ny
    memory = np.full(n + m + n + m * n + 2 * m + n, np.nan)
    references = np.array(
        [v.reference for v in (*description.inputs, *description.outputs)], dtype=np.uint32
    )
    mutex = np.zeros(16, dtype=np.int64)
    _KEPT.extend([instance, functions, memory, references, mutex])
    value, slope = _compiled(
        functions, int(instance.component), (nx, nu, ny), memory, references, mutex
    )
    _KEPT.extend([value, slope])
    ADDRESSES.update(zip(SYMBOLS, (value.address, slope.address), strict=True))
    start = _reals(instance, description)
    call = ctypes.CFUNCTYPE(ctypes.c_double, ctypes.c_int64, ctypes.c_void_p)(value.address)

    def at(point: Array) -> Array:
        point = np.ascontiguousarray(point, dtype=np.float64)
        return np.array([call(k, point.ctypes.data) for k in range(m)])

    return LoadedLibrary(description, at, np.asarray(start, dtype=float))


def _reals(instance: Any, description: Description) -> list[float]:
    references = [v.reference for v in (*description.states, *description.inputs)]
    if not references:
        return []
    return list(
        instance.getReal(references)
        if description.version == 2
        else instance.getFloat64(references)
    )


def _instance(description: Description) -> tuple[Any, dict[str, Any]]:
    """The FMU, ready for continuous time, and its functions by what they do."""
    library = fmpy()
    folder = library.extract(description.path, tempfile.mkdtemp(prefix="residuum-fmu-"))
    arguments = {
        "guid": description.guid,
        "unzipDirectory": folder,
        "modelIdentifier": description.exchange,
        "instanceName": "residuum",
    }
    try:
        if description.version == 2:
            model = _import("fmpy.fmi2").FMU2Model(**arguments)
            model.instantiate()
            model.setupExperiment(startTime=0.0)
            model.enterInitializationMode()
            model.exitInitializationMode()
            _settle_two(model)
        else:
            model = _import("fmpy.fmi3").FMU3Model(**arguments)
            model.instantiate()
            model.enterInitializationMode()
            model.exitInitializationMode()
            _settle_three(model)
            model.component = model.component if hasattr(model, "component") else model._instance
    except Exception as error:
        raise BadModel(
            f"model {description.path!r}: the FMU cannot be set up ({in_one_line(error)})"
        ) from None
    return model, _functions(model.dll, description.version)


def _import(name: str) -> Any:
    return __import__(name, fromlist=["_"])


def _settle_two(model: Any) -> None:
    for _ in range(10):
        needed, *_ = model.newDiscreteStates()
        if not needed:
            break
    model.enterContinuousTimeMode()


def _settle_three(model: Any) -> None:
    for _ in range(10):
        needed, *_ = model.updateDiscreteStates()
        if not needed:
            break
    model.enterContinuousTimeMode()


def _functions(dll: Any, version: int) -> dict[str, Any]:
    pointer, size, double, status = ctypes.c_void_p, ctypes.c_size_t, ctypes.c_double, ctypes.c_int
    arrays = (pointer, pointer, size)
    by_reference = (
        (pointer, pointer, size, pointer)
        if version == 2
        else (pointer, pointer, size, pointer, size)
    )
    names = {
        "time": ("SetTime", (pointer, double)),
        "states": ("SetContinuousStates", arrays),
        "rates": ("GetDerivatives" if version == 2 else "GetContinuousStateDerivatives", arrays),
        "set": ("SetReal" if version == 2 else "SetFloat64", by_reference),
        "get": ("GetReal" if version == 2 else "GetFloat64", by_reference),
    }
    functions = {
        key: ctypes.CFUNCTYPE(status, *types_)((f"fmi{version}{name}", dll))
        for key, (name, types_) in names.items()
    }
    process = ctypes.CDLL(None)
    for name in ("lock", "unlock"):
        functions[name] = ctypes.CFUNCTYPE(status, pointer)((f"pthread_mutex_{name}", process))
    return functions | {"version": version}


def _by_reference(
    f: dict[str, Any], component: int, inputs: tuple[int, int], outputs: tuple[int, int]
) -> tuple[Any, Any]:
    """What sets the inputs from an address, and what writes the outputs to one: FMI 3 asks for the
    count of values besides.
    """
    set_reals, get_reals = f["set"], f["get"]
    ins, nu = inputs
    outs, ny = outputs
    if f["version"] == 2:
        put = njit(lambda address: set_reals(component, ins, nu, address), nogil=True)
        return put, njit(lambda address: get_reals(component, outs, ny, address), nogil=True)
    put = njit(lambda address: set_reals(component, ins, nu, address, nu), nogil=True)
    return put, njit(lambda address: get_reals(component, outs, ny, address, ny), nogil=True)


def _compiled(  # noqa: C901  compiled functions that share what they close over
    f: dict[str, Any],
    component: int,
    sizes: tuple[int, int, int],
    memory: Array,
    references: Any,
    mutex: Any,
) -> Any:
    """The two functions that generated code calls.

    `memory` has the last point and its values, the point of the slopes and them, two rows of
    values, and a point to move.
    """
    nx, nu, ny = sizes
    n, m = 1 + nx + nu, nx + ny
    set_time, set_states, rates, lock, unlock = (
        f["time"],
        f["states"],
        f["rates"],
        f["lock"],
        f["unlock"],
    )
    at, guard, ins = memory.ctypes.data, mutex.ctypes.data, references.ctypes.data
    outs = ins + 4 * nu
    room = memory.size

    put, take = _by_reference(f, component, (ins, nu), (outs, ny))

    @njit(nogil=True)
    def ask(point, values):
        """The FMU's rates and outputs at a point, both of them addresses; nan where it refuses."""
        a, v = carray(_doubles(point), n), carray(_doubles(values), m)
        bad = set_time(component, a[0])
        if nx > 0:
            bad += set_states(component, point + 8, nx)
        if nu > 0:
            bad += put(point + 8 * (1 + nx))
        if nx > 0:
            bad += rates(component, values, nx)
        bad += take(values + 8 * nx)
        if bad > 1:
            for k in range(m):
                v[k] = np.nan

    @njit(nogil=True)
    def same(a, b):
        differ = 0
        for i in range(n):
            differ += a[i] != b[i]
        return differ == 0

    @cfunc("float64(int64, CPointer(float64))", nopython=True)
    def value(k, given):
        a, cache = carray(given, n), carray(_doubles(at), room)
        lock(guard)
        if not same(a, cache):
            for i in range(n):
                cache[i] = a[i]
            ask(at, at + 8 * n)
        entry = cache[n + k]
        unlock(guard)
        return entry

    @cfunc("float64(int64, int64, CPointer(float64))", nopython=True)
    def slope(k, j, given):
        a, cache = carray(given, n), carray(_doubles(at), room)
        first, table = n + m, n + m + n
        high, low = table + m * n, table + m * n + m
        moved = low + m
        lock(guard)
        if not same(a, cache[first:]):
            for i in range(n):
                cache[first + i] = a[i]
                cache[moved + i] = a[i]
            for i in range(n):
                h = _STEP * (1.0 + abs(a[i]))
                cache[moved + i] = a[i] + h
                ask(at + 8 * moved, at + 8 * high)
                cache[moved + i] = a[i] - h
                ask(at + 8 * moved, at + 8 * low)
                cache[moved + i] = a[i]
                for r in range(m):
                    cache[table + r * n + i] = (cache[high + r] - cache[low + r]) / (2.0 * h)
        entry = cache[table + k * n + j]
        unlock(guard)
        return entry

    return value, slope
