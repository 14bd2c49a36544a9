"""What a MAT file holds, by name: vectors, columns of matrices, numbers and texts, structs and
Simulink's logs taken apart.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

SHORTEST_SIGNAL = 3
"""Samples of a signal, at least: fewer are a setting."""


@dataclass
class MatVariables:
    """Variables by name; a field of a struct has its own name where that is free, else
    `struct.field`.

    `vectors` are one-dimensional, `matrices` two-dimensional (their rows or their columns are the
    samples), `rest` says of every other array why it is no signal. `home` is the struct that a
    vector stands in, `""` for none.
    """

    vectors: dict[str, np.ndarray] = field(default_factory=dict)
    matrices: dict[str, np.ndarray] = field(default_factory=dict)
    numbers: dict[str, float] = field(default_factory=dict)
    texts: dict[str, str] = field(default_factory=dict)
    home: dict[str, str] = field(default_factory=dict)
    rest: list[str] = field(default_factory=list)


def variables_of(content: dict[str, Any]) -> MatVariables:
    """Sort what `scipy.io.loadmat` (simplified cells) or an HDF5 file gives."""
    saved, taken = MatVariables(), {name for name in content if not isinstance(content[name], dict)}
    for path, value in _leaves(content, ""):
        home, _, short = path.rpartition(".")
        name = path if home and short in taken else short
        taken.add(name)
        saved.home[name] = home
        _sort(saved, name, value)
    return saved


def _leaves(content: dict[str, Any], prefix: str) -> Iterator[tuple[str, Any]]:
    for name, value in content.items():
        if name.startswith("__"):
            continue
        if isinstance(value, dict) and "signals" in value:
            yield from _simulink(f"{prefix}{name}", value)
        elif isinstance(value, dict):
            yield from _leaves(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", value


def _simulink(path: str, log: dict[str, Any]) -> Iterator[tuple[str, Any]]:
    """The time and the signals of Simulink's "structure with time"; several columns of a signal
    have labels, or numbers.
    """
    yield f"{path}.time", log.get("time", np.empty(0))
    signals = log["signals"]
    for number, signal in enumerate(
        [signals] if isinstance(signals, dict) else list(signals), start=1
    ):
        values = np.asarray(signal.get("values", np.empty(0)))
        columns = values.reshape(len(values), -1).T if values.ndim == 2 else [values]
        labels = [part.strip(" <>") for part in str(signal.get("label", "")).split(",")]
        single = labels[0] or f"signal{number}"
        named = (
            labels
            if len(labels) == len(columns) > 1 and all(labels)
            else [f"{single}_{k}" for k in range(1, len(columns) + 1)]
        )
        for name, column in zip([single] if len(columns) == 1 else named, columns, strict=True):
            yield f"{path}.{name.replace('.', '_')}", column


def _sort(saved: MatVariables, name: str, value: Any) -> None:
    if isinstance(value, str):
        saved.texts[name] = value
    elif isinstance(value, bool | int | float | np.number) or (
        isinstance(value, np.ndarray) and value.ndim == 0
    ):
        array = np.asarray(value)
        if array.dtype.kind in "fiub":
            saved.numbers[name] = float(array)
    elif not isinstance(value, np.ndarray) or value.dtype.kind not in "fiub":
        if isinstance(value, np.ndarray | list) and np.size(value):
            saved.rest.append(f"{name} ({_kind(value)})")
    elif value.size >= SHORTEST_SIGNAL and value.size == max(value.shape):
        saved.vectors[name] = np.ravel(value)
    elif value.ndim == 2 and value.size >= SHORTEST_SIGNAL:
        saved.matrices[name] = value
    elif value.ndim > 2:
        saved.rest.append(f"{name} ({' × '.join(map(str, value.shape))} values)")


def _kind(value: Any) -> str:
    kind = getattr(getattr(value, "dtype", None), "kind", "O")
    return {"c": "complex numbers", "U": "text", "S": "text", "V": "an object of MATLAB"}.get(
        kind, "cells or objects"
    )
