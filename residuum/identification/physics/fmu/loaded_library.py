"""An FMU's library in this process: its rates and outputs as a function of time, states and inputs,
for compiled code.

Its slopes are directional derivatives where the FMU gives them, and they agree with differences;
else they are central differences. The FMU is one object with a state of its own, so a whole pass
holds the instance's lock, and the last point is remembered: a step asks for each rate at the same
point.
"""

# mypy: disable-error-code="no-untyped-def,no-untyped-call,untyped-decorator,attr-defined,call-arg"

from __future__ import annotations

import ctypes
import hashlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from numba import carray, cfunc, njit, types
from numba.extending import intrinsic

from residuum.identification.physics.compile.equation_functions import SYMBOLS
from residuum.identification.physics.compile.machine_code import LIBRARIES
from residuum.identification.physics.fmu.description import Description
from residuum.identification.physics.fmu.instance import Instance

Array = npt.NDArray[np.float64]
Move = Callable[[Array, float], None]
"""Bring the FMU to a point, one variable moved by so much."""
ACCEPTED = 1
"""The last status of a call that went well: a warning."""
_STEP = 1e-6
"""Step of a difference by a variable whose size is about 1."""
_POINTS = 4
_AGREES = 1e-3
"""Points at which a derivative is held against a difference, and the part by which it may differ.
"""
_KEPT: list[Any] = []
"""What compiled code points to, and must not be freed."""


@dataclass(frozen=True, eq=False)
class LoadedLibrary:
    """`value(point)` gives rates, then outputs, at a point (time, states, inputs, parameters);
    `start` has the first states and inputs.

    `parameters` are those that the FMU gives directional derivatives by: arguments like any other,
    whose values `settle` sets. `name` is what the texts of expressions call it by.
    """

    description: Description
    instance: Instance
    value: Any
    start: Array
    parameters: tuple[str, ...]
    name: str
    memory: Array

    def settle(self, values: Mapping[str, float]) -> bool:
        """Begin anew where the parameters change; False where the FMU refuses them."""
        if self.instance.begun != (self, values):
            self.memory[:] = np.nan  # what was remembered is that of other parameters
            self.instance.begun = (self, dict(values)) if self.instance.begin(values) else None
        return self.instance.begun is not None


@intrinsic
def _doubles(typingctx, address):
    """A pointer to doubles from an address."""

    def made(context, builder, signature, arguments):
        return builder.inttoptr(arguments[0], context.get_value_type(signature.return_type))

    return types.CPointer(types.float64)(types.intp), made


class _Arrays(NamedTuple):
    """What the compiled functions point to.

    `memory` has the last point and its values, the point of the slopes and they themselves, two
    rows of values, a seed, then what of it is known: rates and outputs at the last point, whether
    the FMU is there, and for each column of slopes those of rates and of outputs. `references` are
    those of inputs, outputs, then of what directional derivatives are of and by.
    """

    memory: Array
    references: npt.NDArray[np.uint32]


def library_of(instance: Instance, asked: Sequence[str] = ()) -> LoadedLibrary:
    """An FMU's instance for model exchange as what generated code can call: one in this process for
    all who ask alike, since code that was linked calls the one that it was linked to.

    Parameters
    ----------
    asked : sequence of str
        Parameters by which slopes are wanted.
    """
    with instance.lock:
        return _library_of(instance, tuple(asked))


@cache
def _library_of(instance: Instance, asked: tuple[str, ...]) -> LoadedLibrary:
    instance.begin({})
    given = differentiated(instance, _start(instance), asked)
    # Slopes by any other parameter are differences of whole simulations.
    return _loaded(instance, tuple(name for name in asked if name in given))


def _start(instance: Instance) -> Array:
    described = instance.description
    return np.asarray(instance.reals([v.reference for v in (*described.states, *described.inputs)]))


@cache
def _loaded(instance: Instance, own: tuple[str, ...]) -> LoadedLibrary:
    """With these parameters among the arguments."""
    description = instance.description
    start = _start(instance)
    given = differentiated(instance, start, own)
    nx = len(description.states)
    nu = len(description.inputs)
    ny = len(description.outputs)
    # n: time, states, inputs, parameters; m: rates, outputs.
    n = 1 + nx + nu + len(own)
    m = nx + ny
    # NaN is no point: the first question is always asked of the FMU.
    memory = np.full(2 * n + 3 * m + m * n + 1 + 3 + 2 * n, np.nan)
    variables = (
        *description.inputs,
        *description.outputs,
        *description.derivatives,
        *description.outputs,
        *description.states,
        *description.inputs,
        *(description.parameters[name] for name in own),
    )
    references = np.array([v.reference for v in variables], dtype=np.uint32)
    known = [v.name in given for v in (*description.states, *description.inputs)]
    by_derivative = np.array([False, *known, *(True for _ in own)], dtype=np.bool_)
    functions = _functions(instance)
    # Addresses of these stand in compiled code, which Python does not count as a reference.
    _KEPT.extend([instance, functions, memory, references])
    arrays = _Arrays(memory, references)
    value, slope = _compiled(
        functions, instance.component, (nx, nu, ny, len(own)), arrays, by_derivative
    )
    _KEPT.extend([value, slope])
    call = ctypes.CFUNCTYPE(ctypes.c_double, ctypes.c_int64, ctypes.c_void_p)(value.address)

    def at(point: Array) -> Array:
        whole = np.zeros(n)
        whole[: len(point)] = point
        return np.array([call(k, whole.ctypes.data) for k in range(m)])

    # Of the file and of the arguments: code that calls one library must not be taken for another.
    name = hashlib.sha256(f"{instance.content} {own}".encode()).hexdigest()[:16]
    LIBRARIES[name] = dict(zip(SYMBOLS, (value.address, slope.address), strict=True))
    return LoadedLibrary(description, instance, at, start, own, name, memory)


def _functions(instance: Instance) -> dict[str, Any]:
    pointer = ctypes.c_void_p
    size = ctypes.c_size_t
    double = ctypes.c_double
    two = instance.description.version == 2
    arrays = (pointer, pointer, size)
    by_reference = (pointer, pointer, size, pointer) + (() if two else (size,))
    by_direction = (pointer, pointer, size, pointer, size, pointer) + (
        (pointer,) if two else (size, pointer, size)
    )
    names = {
        "time": ("SetTime", (pointer, double)),
        "states": ("SetContinuousStates", arrays),
        "rates": ("GetDerivatives" if two else "GetContinuousStateDerivatives", arrays),
        "set": ("SetReal" if two else "SetFloat64", by_reference),
        "get": ("GetReal" if two else "GetFloat64", by_reference),
        "derivative": ("GetDirectionalDerivative", by_direction),
    }
    functions = {key: instance.function(name, *types_) for key, (name, types_) in names.items()}
    return functions | {"version": instance.description.version}


def by_reference(
    f: dict[str, Any], component: int, inputs: tuple[int, int], outputs: tuple[int, int]
) -> tuple[Any, Any]:
    """What sets the inputs from an address, and what writes the outputs to one: FMI 3 asks for the
    count of values besides.
    """
    set_reals = f["set"]
    get_reals = f["get"]
    ins, nu = inputs
    outs, ny = outputs
    if f["version"] == 2:
        put = njit(lambda address: set_reals(component, ins, nu, address), nogil=True)
        return put, njit(lambda address: get_reals(component, outs, ny, address), nogil=True)
    put = njit(lambda address: set_reals(component, ins, nu, address, nu), nogil=True)
    return put, njit(lambda address: get_reals(component, outs, ny, address, ny), nogil=True)


def _by_direction(f: dict[str, Any], component: int) -> Any:
    """What writes to an address the derivatives of so many unknowns by the variable whose reference
    stands at another one, for a seed.
    """
    derivative = f["derivative"]
    if f["version"] == 2:
        return njit(
            lambda of, m, by, seed, to: derivative(component, of, m, by, 1, seed, to), nogil=True
        )
    return njit(
        lambda of, m, by, seed, to: derivative(component, of, m, by, 1, seed, 1, to, m), nogil=True
    )


def _compiled(  # noqa: C901, PLR0915  compiled functions that share what they close over
    f: dict[str, Any],
    component: int,
    sizes: tuple[int, int, int, int],
    arrays: _Arrays,
    by_derivative: npt.NDArray[np.bool_],
) -> Any:
    """The two functions that generated code calls."""
    memory, references = arrays
    nx, nu, ny, _ = sizes
    n = 1 + nx + nu + sizes[3]
    m = nx + ny
    set_time = f["time"]
    set_states = f["states"]
    rates = f["rates"]
    # Offsets in bytes: value references are 4 bytes each, doubles 8.
    at = memory.ctypes.data
    ins = references.ctypes.data
    outs = ins + 4 * nu
    unknowns = ins + 4 * (nu + ny)
    knowns = unknowns + 4 * m
    room = memory.size
    # Where in the memory these stand.
    point = n + m
    table = point + n
    high = table + m * n
    low = high + m
    seed = low + m
    of_last = seed + 1
    of_slopes = of_last + 3
    exact = tuple(map(bool, by_derivative))

    # Which of two signatures a call has depends on the version of FMI: settled before compiling.
    put, take = by_reference(f, component, (ins, nu), (outs, ny))
    differentiate = _by_direction(f, component)

    @njit(nogil=True)
    def place(point):
        """The worst status: several warnings are no failure."""
        status = set_time(component, _value_at(point))
        if nx > 0:
            status = max(status, set_states(component, point + 8, nx))
        if nu > 0:
            status = max(status, put(point + 8 * (1 + nx)))
        return status

    @njit(nogil=True)
    def read(outputs, values):
        """The rates or the outputs where the FMU is, to the address of all values."""
        if outputs:
            return take(values + 8 * nx)
        return rates(component, values, nx)

    @njit(nogil=True)
    def ask(outputs, to, status, values):
        """What was read, into an array at the same address; nan where the FMU refuses."""
        # A discarded or failed call leaves numbers of another point.
        if max(status, read(outputs, to)) > ACCEPTED:
            for k in range(nx if outputs else 0, m if outputs else nx):
                values[k] = np.nan

    @njit(nogil=True)
    def same(a, b):
        differ = 0
        for i in range(n):
            differ += a[i] != b[i]
        return differ == 0

    @cfunc("float64(int64, CPointer(float64))", nopython=True)
    def value(k, given):
        a = carray(given, n)
        cache = carray(_doubles(at), room)
        outputs = k >= nx
        if not same(a, cache):
            for i in range(n):
                cache[i] = a[i]
            cache[of_last] = cache[of_last + 1] = 0.0
            cache[of_last + 2] = 0.0
        if cache[of_last + outputs] != 1.0:
            status = 0
            if cache[of_last + 2] != 1.0:
                status = place(at)
                cache[of_last + 2] = 1.0 if status <= ACCEPTED else 0.0
            ask(outputs, at + 8 * n, status, cache[n:])
            cache[of_last + outputs] = 1.0
        return cache[n + k]

    @njit(nogil=True)
    def column(j, outputs, cache):
        """Slopes by argument j at the point of the slopes, of rates or of outputs."""
        first = nx if outputs else 0
        last = m if outputs else nx
        cache[of_last + 2] = 0.0
        if exact[j]:
            cache[seed] = 1.0
            status = place(at + 8 * point)
            by_one = differentiate(
                unknowns + 4 * first,
                last - first,
                knowns + 4 * (j - 1),
                at + 8 * seed,
                at + 8 * (high + first),
            )
            accepted = max(status, by_one) <= ACCEPTED
            for r in range(first, last):
                cache[table + j * m + r] = cache[high + r] if accepted else np.nan
            return
        middle = cache[point + j]
        h = _STEP * (1.0 + abs(middle))
        cache[point + j] = middle + h
        ask(outputs, at + 8 * high, place(at + 8 * point), cache[high:])
        cache[point + j] = middle - h
        ask(outputs, at + 8 * low, place(at + 8 * point), cache[low:])
        cache[point + j] = middle
        for r in range(first, last):
            cache[table + j * m + r] = (cache[high + r] - cache[low + r]) / (2.0 * h)

    @cfunc("float64(int64, int64, CPointer(float64))", nopython=True)
    def slope(k, j, given):
        a = carray(given, n)
        cache = carray(_doubles(at), room)
        outputs = k >= nx
        if not same(a, cache[point:]):
            for i in range(n):
                cache[point + i] = a[i]
                cache[of_slopes + 2 * i] = cache[of_slopes + 2 * i + 1] = 0.0
        # A column is computed when it is first asked for at a point.
        if cache[of_slopes + 2 * j + outputs] != 1.0:
            column(j, outputs, cache)
            cache[of_slopes + 2 * j + outputs] = 1.0
        return cache[table + j * m + k]

    return value, slope


@njit(nogil=True)
def _value_at(address):
    return carray(_doubles(address), 1)[0]


def differentiated(instance: Instance, start: Array, asked: Sequence[str]) -> set[str]:
    """Of states, inputs and the parameters asked for, those whose derivatives agree with
    differences of rates and outputs.

    FMI 2.0 promises them by states and inputs alone; an FMU that has them by parameters shows it by
    giving them. Where nothing moved at any point, zeros are not believed.
    """
    described = instance.description
    if described.exchange is None or not described.exchange.differentiates:
        return set()
    rng = np.random.default_rng(0)
    # Around the start: at one point alone a slope may be zero by chance.
    points = [start + rng.normal(size=start.size) for _ in range(_POINTS)]
    right = {
        name
        for name, reference, step, move in _moves(instance, start.size, asked)
        if _is_right(instance, reference, step, move, points)
    }
    # The trial moved states and parameters: simulations begin anew.
    instance.begin({})
    return right


def _moves(
    instance: Instance, size: int, asked: Sequence[str]
) -> Iterator[tuple[str, int, float, Move]]:
    """Name, reference, step and how to move each of the variables."""
    described = instance.description

    def of_point(k: int) -> Move:
        return lambda point, by: instance.place(point + by * (np.arange(size) == k))

    def of_parameter(name: str) -> Move:
        def move(point: Array, by: float) -> None:
            instance.begin({name: described.parameters[name].start + by})
            instance.place(point)

        return move

    for k, variable in enumerate((*described.states, *described.inputs)):
        yield variable.name, variable.reference, _STEP, of_point(k)
    for name in asked:
        parameter = described.parameters[name]
        size_of_it = max(abs(parameter.start), parameter.nominal or 0.0, _STEP)
        yield name, parameter.reference, _STEP * size_of_it, of_parameter(name)


def _is_right(
    instance: Instance, reference: int, step: float, move: Move, points: Sequence[Array]
) -> bool:
    moved = False
    for point in points:
        try:
            move(point, 0.0)
            given = instance.derivative(reference)
            move(point, step)
            high = instance.answer()
            move(point, -step)
            slope = (high - instance.answer()) / (2.0 * step)
        except Exception:
            # fmpy raises for any status that is an error: it has no such derivative
            return False
        size = float(np.linalg.norm(slope))
        if not np.linalg.norm(given - slope) <= _AGREES * size + _STEP:
            return False
        moved = moved or size > _STEP
    return moved
