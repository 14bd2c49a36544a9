"""Linear models as models of balances: a transfer function or a state space, from a file or from
another library's object.

A transfer function is written in the canonical form of its own time scale T, with every coefficient
a free parameter:

    T·dxᵢ/dt = xᵢ₊₁,   T·dxₙ/dt = −Σ αᵢ·xᵢ₊₁ + u,   y = Σ βᵢ·xᵢ₊₁ + δ·u
    αᵢ = aᵢ·Tⁿ⁻ⁱ,   βᵢ = bᵢ·Tⁿ⁻ⁱ

so that its numbers are of one size. A state space keeps its states, and its entries are fixed: they
cannot all be estimated. Balances are of the kind `signal`, so effects are judged on the paths of
inputs and outputs. A model in discrete time is brought to continuous time, its input held over a
sample; one with a pole at or left of zero has none.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import yaml
from scipy.io import loadmat
from scipy.linalg import logm
from scipy.signal import tf2ss

from residuum.identification.errors import BadModel
from residuum.nearest_names import known_names

Array = npt.NDArray[np.float64]
_MOST_STATES = 30
_KEYS = (
    "numerator",
    "denominator",
    "num",
    "den",
    "A",
    "B",
    "C",
    "D",
    "sample_time",
    "dt",
    "Ts",
    "inputs",
    "outputs",
    "units",
    "name",
)


@dataclass(frozen=True)
class LinearSignals:
    """Names and units of what a linear model connects; defaults are `u` and `y`, numbered where
    there are several.
    """

    inputs: Sequence[str] = ()
    outputs: Sequence[str] = ()
    units: Mapping[str, str] | None = None

    def named(self, given: Sequence[str], letter: str, count: int, where: str) -> list[str]:
        """Names of `count` signals."""
        if given and len(given) != count:
            raise BadModel(
                f"{where}: has {count} signals where {len(given)} names are given"
                f" ({', '.join(given)})"
            )
        return list(given) or (
            [letter] if count == 1 else [f"{letter}_{k + 1}" for k in range(count)]
        )


def read_linear_file(path: Path) -> str:
    """The model file of a linear model in JSON or in a MATLAB file: `num` and `den`, or `A B C D`,
    alone or in a struct.

    Raises
    ------
    BadModel
        Not such a file, or numbers that are no proper linear model.
    """
    try:
        content: Any = (
            json.loads(path.read_text(encoding="utf-8"))
            if path.suffix.lower() == ".json"
            else _of_matlab(path)
        )
    except (OSError, ValueError, NotImplementedError, TypeError) as error:
        raise BadModel(
            f"model {str(path)!r}: cannot be read ({' '.join(str(error).split())[:150]})"
        ) from None
    if not isinstance(content, dict):
        raise BadModel(f"model {str(path)!r}: holds no transfer function and no state space")
    if unknown := [key for key in content if key not in _KEYS and path.suffix.lower() == ".json"]:
        raise BadModel(
            f"model {str(path)!r}: {unknown[0]!r} is not part of a linear model;"
            f" {known_names(unknown[0], _KEYS)}"
        )
    signals = LinearSignals(
        _names(content.get("inputs")), _names(content.get("outputs")), content.get("units")
    )
    step = next((content[key] for key in ("sample_time", "dt", "Ts") if key in content), None)
    name = str(content.get("name", path.stem))
    return linear_text(
        name,
        _system(content, str(path)),
        signals,
        None if step is None else float(np.squeeze(step)),
    )


def _names(given: Any) -> list[str]:
    return (
        [given]
        if isinstance(given, str)
        else [str(name) for name in (given if given is not None else ())]
    )


def _of_matlab(path: Path) -> dict[str, Any]:
    held = {
        key: value
        for key, value in loadmat(path, simplify_cells=True).items()
        if not key.startswith("__")
    }
    structs = [value for value in held.values() if isinstance(value, dict)]
    return structs[0] if structs and not {"A", "num"} & set(held) else held


def _system(content: Mapping[str, Any], where: str) -> tuple[Array, ...]:
    """(numerator, denominator) or (A, B, C, D)."""
    for top, below in (("numerator", "denominator"), ("num", "den")):
        if top in content and below in content:
            return tuple(_array(content[key], 1, f"{where}, {key}") for key in (top, below))
    if all(key in content for key in "ABC"):
        return _state_space(content, where)
    raise BadModel(f"model {where!r}: needs numerator and denominator, or A, B, C and D")


def _state_space(content: Mapping[str, Any], where: str) -> tuple[Array, Array, Array, Array]:
    """A, B, C, D; without a D nothing of the inputs reaches the outputs at once."""
    A, B, C = (_array(content[key], 2, f"{where}, {key}") for key in "ABC")
    # a list of numbers was read as a row: it is the column of a single input
    if B.shape[0] != len(A) and B.size == len(A):
        B = B.reshape(len(A), -1)
    shape = (C.shape[0], B.shape[1])
    D = _array(content["D"], 2, f"{where}, D") if "D" in content else np.zeros(shape)
    return A, B, C, D.reshape(shape) if D.size == shape[0] * shape[1] else D


def _array(value: Any, dimensions: int, where: str) -> Array:
    try:
        array = np.atleast_1d(np.asarray(value, dtype=float))
    except (TypeError, ValueError):
        raise BadModel(f"{where}: does not hold numbers") from None
    # A list may come as a matrix of one row or column.
    array = array.ravel() if dimensions == 1 else np.atleast_2d(array)
    if array.ndim != dimensions or not array.size or not np.isfinite(array).all():
        raise BadModel(
            f"{where}: must be a {'list' if dimensions == 1 else 'matrix'} of finite numbers"
        )
    return array


def of_object(system: Any) -> tuple[tuple[Array, ...], float | None]:
    """(numerator, denominator) or (A, B, C, D), and the sample time or None, of an object of
    python-control or SciPy.
    """
    step = getattr(system, "dt", None)
    # 0 and None: continuous time. True: discrete without a sample time, which says nothing.
    step = float(step) if step not in (None, 0, True, False) else None
    if all(hasattr(system, key) for key in "ABCD"):
        return (
            tuple(np.atleast_2d(np.asarray(getattr(system, key), dtype=float)) for key in "ABCD"),
            step,
        )
    if hasattr(system, "num") and hasattr(system, "den"):
        top, below = _single_pair(system.num, system.den)
        return (_array(top, 1, "numerator"), _array(below, 1, "denominator")), step
    raise BadModel(
        f"{type(system).__name__}: is no transfer function and no state space (no num and den, no"
        " A, B, C, D)"
    )


def _single_pair(top: Any, below: Any) -> tuple[Any, Any]:
    """Numerator and denominator; python-control keeps a table of them, a row each output."""
    is_table = (
        isinstance(top, list | tuple)
        or np.ndim(top) == 2
        or getattr(top, "dtype", None) == np.dtype(object)
    )
    if not is_table:
        return top, below
    if len(top) != 1 or len(top[0]) != 1:
        raise BadModel(
            "a transfer function of several inputs or outputs: hand its state space over,"
            " ss(system)"
        )
    return top[0][0], below[0][0]


def linear_text(
    name: str, system: tuple[Array, ...], signals: LinearSignals, sample_time: float | None = None
) -> str:
    """The model file of (numerator, denominator) or (A, B, C, D); `sample_time` [s] where it is in
    discrete time.

    Raises
    ------
    BadModel
        Not proper, matrices that do not fit, a pole without a counterpart in continuous time.
    """
    if len(system) == 2:
        top, below = _proper(name, *system)
        if sample_time is None:
            return _transfer_function_text(name, top / below[0], below / below[0], signals)
        # only a state space is brought to continuous time, by a logarithm of its matrices
        system = tuple(np.asarray(part, dtype=float) for part in tf2ss(top, below))
    A, B, C, D = _fitting(name, *system)
    if sample_time is not None:
        A, B = _continuous(name, A, B, sample_time)
    return _state_space_text(name, (A, B, C, D), signals)


def _proper(name: str, top: Array, below: Array) -> tuple[Array, Array]:
    """Numerator and denominator without zeros before their highest power."""
    top = np.trim_zeros(top, "f")
    below = np.trim_zeros(below, "f")
    if not below.size or not top.size or top.size > below.size:
        raise BadModel(
            f"model {name!r}: a transfer function needs a numerator of at most the denominator's"
            " degree"
        )
    return top, below


def _fitting(name: str, A: Array, B: Array, C: Array, D: Array) -> tuple[Array, ...]:
    n = len(A)
    fits = A.shape == (n, n) and B.shape[0] == n and C.shape[1] == n
    if not fits or D.shape != (C.shape[0], B.shape[1]):
        raise BadModel(
            f"model {name!r}: A {A.shape}, B {B.shape}, C {C.shape}, D {D.shape} do not fit each"
            " other"
        )
    return A, B, C, D


def _continuous(name: str, A: Array, B: Array, step: float) -> tuple[Array, Array]:
    """A and B of continuous time whose input is held over each step."""
    poles = np.linalg.eigvals(A)
    # A real pole at or left of zero has no real logarithm.
    if np.any((np.abs(poles.imag) < 1e-12) & (poles.real <= 1e-12)):
        raise BadModel(
            f"model {name!r}: has a pole at or left of zero, which no model in continuous time has"
        )
    n, m = B.shape
    # exp([[A, B], [0, 0]]·T) = [[A_d, B_d], [0, 1]] of an input that is held (Van Loan): the
    # logarithm goes back.
    whole = np.block([[A, B], [np.zeros((m, n)), np.eye(m)]])
    generator = np.real(logm(whole)) / step
    return generator[:n, :n], generator[:n, n:]


def _transfer_function_text(name: str, top: Array, below: Array, signals: LinearSignals) -> str:
    n = below.size - 1
    u, y = (
        signals.named(given, letter, 1, name)[0]
        for given, letter in ((signals.inputs, "u"), (signals.outputs, "y"))
    )
    units = _units(signals, [u, y])
    # a₀ … aₙ₋₁, in rising powers.
    a = below[1:][::-1]
    b = np.concatenate([top[::-1], np.zeros(n + 1 - top.size)])
    # The direct gain is split off: what is left is strictly proper.
    through = b[n]
    b = b[:n] - b[n] * a
    T = _time_scale(a)
    # αᵢ = aᵢ·Tⁿ⁻ⁱ and βᵢ = bᵢ·Tⁿ⁻ⁱ: coefficients of one size.
    scale = T ** (n - np.arange(n))
    parameters = {
        "T": _fixed(T, "s", "time scale"),
        "one": _fixed(1.0, _per(units[u]), "unit of the input"),
    }
    parameters |= {
        f"alpha_{i}": _free(v, "", "of the denominator") for i, v in enumerate(a * scale)
    }
    parameters |= {
        f"beta_{i}": _free(v, units[y], "of the numerator") for i, v in enumerate(b * scale) if v
    }
    balances = {}
    for k in range(1, n):
        balances[f"order_{k}"] = _signal(f"T * der(x_{k})", {"next": f"x_{k + 1}"})
    if n:
        last = {f"a_{i}": f"-alpha_{i} * x_{i + 1}" for i in range(n)} | {"input": f"one * {u}"}
        balances[f"order_{n}"] = _signal(f"T * der(x_{n})", last)
    total = [f"beta_{i} * x_{i + 1}" for i in range(n) if f"beta_{i}" in parameters]
    if through:
        parameters["delta"] = _free(through, _ratio(units[y], units[u]), "direct gain")
        total.append(f"delta * {u}")
    return _file(name, {u: units[u]}, n, parameters, balances, {y: (" + ".join(total), units[y])})


def _time_scale(a: Array) -> float:
    """T [s] of a denominator sⁿ + … + a₁s + a₀, the geometric mean of its poles' time constants;
    with a pole at zero, where that is infinite, what makes the largest coefficient 1.
    """
    n = a.size
    if n and a[0]:
        return float(1.0 / np.abs(a[0]) ** (1.0 / n))
    size = np.max(np.abs(a) ** (1.0 / (n - np.arange(n))), initial=0.0)
    return float(1.0 / size) if size else 1.0


def _state_space_text(name: str, system: tuple[Array, ...], signals: LinearSignals) -> str:
    A, B, C, D = system
    n = len(A)
    ins = signals.named(signals.inputs, "u", B.shape[1], name)
    outs = signals.named(signals.outputs, "y", C.shape[0], name)
    units = _units(signals, [*ins, *outs])
    parameters: dict[str, Any] = {"T": _fixed(1.0, "s", "time scale")}
    balances = {}
    outputs = {}
    for i in range(n):
        terms = {}
        # Zeros have no parameter: a matrix of thirty states would have nine hundred.
        for k in np.flatnonzero(A[i]):
            parameters[f"a_{i + 1}_{k + 1}"] = _fixed(float(A[i, k]), "", "")
            terms[f"state_{k + 1}"] = f"a_{i + 1}_{k + 1} * x_{k + 1}"
        for k in np.flatnonzero(B[i]):
            parameters[f"b_{i + 1}_{k + 1}"] = _fixed(float(B[i, k]), _per(units[ins[k]]), "")
            terms[f"input_{k + 1}"] = f"b_{i + 1}_{k + 1} * {ins[k]}"
        balances[f"state_{i + 1}"] = _signal(
            f"T * der(x_{i + 1})", terms or {"none": f"0 * x_{i + 1}"}
        )
    for o, y in enumerate(outs):
        total = []
        for k in np.flatnonzero(C[o]):
            parameters[f"c_{o + 1}_{k + 1}"] = _fixed(float(C[o, k]), units[y], "")
            total.append(f"c_{o + 1}_{k + 1} * x_{k + 1}")
        for k in np.flatnonzero(D[o]):
            parameters[f"d_{o + 1}_{k + 1}"] = _fixed(
                float(D[o, k]), _ratio(units[y], units[ins[k]]), ""
            )
            total.append(f"d_{o + 1}_{k + 1} * {ins[k]}")
        if not total:
            raise BadModel(f"model {name!r}: output {y!r} is nothing: its rows of C and D are zero")
        outputs[y] = (" + ".join(total), units[y])
    return _file(name, {u: units[u] for u in ins}, n, parameters, balances, outputs)


def _file(
    name: str,
    inputs: Mapping[str, str],
    n: int,
    parameters: Any,
    balances: Any,
    outputs: Mapping[str, tuple[str, str]],
) -> str:
    if n > _MOST_STATES:
        raise BadModel(
            f"model {name!r}: has {n} states; at most {_MOST_STATES} are taken, reduce it first"
        )
    plain = {
        "name": name,
        "inputs": dict(inputs),
        "states": {f"x_{k + 1}": {"unit": ""} for k in range(n)},
        "parameters": parameters,
        "balances": balances,
        "outputs": {y: {"value": value, "unit": unit} for y, (value, unit) in outputs.items()},
    }
    return str(yaml.safe_dump(plain, sort_keys=False, allow_unicode=True, width=10_000))


def _units(signals: LinearSignals, names: Sequence[str]) -> dict[str, str]:
    given = dict(signals.units or {})
    if unknown := [name for name in given if name not in names]:
        raise BadModel(
            f"units: there is no signal {unknown[0]!r};"
            f" {known_names(unknown[0], names, 'there are')}"
        )
    return {name: str(given.get(name, "")) for name in names}


def _signal(storage: str, terms: Mapping[str, str]) -> dict[str, Any]:
    return {"kind": "signal", "storage": storage, "terms": dict(terms)}


def _fixed(value: float, unit: str, meaning: str) -> dict[str, Any]:
    return _free(value, unit, meaning) | {"fixed": True}


def _free(value: float, unit: str, meaning: str) -> dict[str, Any]:
    return {"value": float(value), "unit": unit} | ({"meaning": meaning} if meaning else {})


def _per(unit: str) -> str:
    return f"1/({unit})" if unit else ""


def _ratio(above: str, below: str) -> str:
    return f"({above or 1})/({below})" if below else above
