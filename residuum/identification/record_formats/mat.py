"""Records as MATLAB MAT files, version 5 (SciPy) and 7.3 (HDF5, extra `formats`)."""

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import scipy

from residuum.identification.errors import BadRecord
from residuum.identification.record import Record
from residuum.identification.record_formats.even_time import FloatArray, on_grid
from residuum.identification.record_formats.loggers.logger_time import seconds_of
from residuum.identification.record_formats.options import ReadOptions
from residuum.identification.record_formats.time_bases import NOT_READ, TimedChannel, on_one_base

# What a MAT file holds, by name: vectors, columns of matrices, numbers and texts, structs and
# Simulink's logs taken apart.

_NUMERIC = "fiub"  # kinds of NumPy: floats, integers with and without sign, logical values
SHORTEST_SIGNAL = 3
"""Samples of a signal, at least: fewer are a setting."""


@dataclass
class MatVariables:
    """Variables by name; a field of a struct has its own name where that is free, else
    `struct.field`.

    `vectors` are one-dimensional, `matrices` two-dimensional (their rows or their columns are the
    samples), `no_signals` says of every other array why it is no signal. `home` is the struct that a
    vector stands in, `""` for none.
    """

    vectors: dict[str, np.ndarray] = field(default_factory=dict)
    matrices: dict[str, np.ndarray] = field(default_factory=dict)
    numbers: dict[str, float] = field(default_factory=dict)
    texts: dict[str, str] = field(default_factory=dict)
    home: dict[str, str] = field(default_factory=dict)
    no_signals: list[str] = field(default_factory=list)


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
        # Header, version and globals, which `loadmat` adds.
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
    # one signal alone is not in a list
    signals = [signals] if isinstance(signals, dict) else list(signals)
    for number, signal in enumerate(signals, start=1):
        values = np.asarray(signal.get("values", np.empty(0)))
        columns = values.reshape(len(values), -1).T if values.ndim == 2 else [values]
        names = _labels(str(signal.get("label", "")), number, len(columns))
        for name, column in zip(names, columns, strict=True):
            yield f"{path}.{name.replace('.', '_')}", column


def _labels(label: str, number: int, n_columns: int) -> list[str]:
    """The names of a signal's columns: by its label, which may name each of them."""
    labels = [part.strip(" <>") for part in label.split(",")]
    single = labels[0] or f"signal{number}"
    if n_columns == 1:
        return [single]
    if len(labels) == n_columns and all(labels):
        return labels
    return [f"{single}_{k}" for k in range(1, n_columns + 1)]


def _sort(saved: MatVariables, name: str, value: Any) -> None:
    """Put a value among the variables of its kind; an empty one among none."""
    if isinstance(value, str):
        saved.texts[name] = value
    elif _is_scalar(value):
        array = np.asarray(value)
        if array.dtype.kind in _NUMERIC:
            saved.numbers[name] = float(array)
    elif isinstance(value, np.ndarray) and value.dtype.kind in _NUMERIC:
        _sort_array(saved, name, value)
    elif isinstance(value, np.ndarray | list) and np.size(value):
        saved.no_signals.append(f"{name} ({_kind(value)})")


def _sort_array(saved: MatVariables, name: str, array: np.ndarray) -> None:
    if array.size >= SHORTEST_SIGNAL and array.size == max(array.shape):
        saved.vectors[name] = np.ravel(array)
    elif array.ndim == 2 and array.size >= SHORTEST_SIGNAL:
        saved.matrices[name] = array
    elif array.ndim > 2:
        saved.no_signals.append(f"{name} ({' × '.join(map(str, array.shape))} values)")


def _is_scalar(value: Any) -> bool:
    if isinstance(value, np.ndarray):
        return value.ndim == 0
    return isinstance(value, bool | int | float | np.number)


def _kind(value: Any) -> str:
    kind = getattr(getattr(value, "dtype", None), "kind", "O")
    return {"c": "complex numbers", "U": "text", "S": "text", "V": "an object of MATLAB"}.get(
        kind, "cells or objects"
    )


_TIME = re.compile(r"(?i)(time|t|tout|zeit|timestamps?)(?:_?(s|sec|seconds|ms|msec|us|min|h))?")
# names of times of some channels only (`t_fast`); they are taken for times where they rise evenly
_OWN_TIME = re.compile(r"(?i)(time|t)_\w+|\w+_(time|t)")
# without `rate`, which may be a shaft's
_RATE = ("fs", "Fs", "FS", "sampling_rate", "samplingRate", "SamplingRate", "sr", "SR")
_STEP = ("sample_time", "sampleTime", "SampleTime", "Ts", "dt")
_HDF5 = b"\x89HDF\r\n\x1a\n"


def read_mat(path: str | Path, options: ReadOptions = ReadOptions()) -> Record:
    """Read the numeric vectors of the file, and the columns of matrices that are as long as a time
    (structs are searched).

    Times are vectors called `time`, `t`, `tout`, … (in seconds, or in the unit that `units_<time>`
    or the name's end says), each for the channels of its struct and length; Simulink's "structure
    with time" is understood. Without one the sample time is a scalar `sample_time`/`Ts`/`dt`, a
    scalar `fs`/`Fs`/`sampling_rate`, or `options.sample_time`, for the longest vectors. Units come
    from `units_<channel>` strings or `options.units`. What is not read is named in the notes.

    Raises BadRecord when the file is no MAT file, holds no signal, says no sample time or two of
    them, or counts instead of telling times; with what to save instead.
    """
    content = _load(path)
    saved = variables_of(content)
    times = _times(saved, str(path), options)
    if times:
        return _timed_record(saved, times, str(path), options)
    if not saved.vectors:
        raise BadRecord(
            f"{path}: holds no numeric vector of at least {SHORTEST_SIGNAL}"
            f" samples{_instead(saved, content)}"
        )
    length = max(map(len, saved.vectors.values()))
    channels = {
        name: vector.astype(float)
        for name, vector in saved.vectors.items()
        if len(vector) == length
    }
    units = {name: _unit(saved, name, options) for name in channels}
    step = options.settle_sample_time(_scalar_step(saved, str(path)), str(path))
    return Record(channels, units, step, notes=_left_out(saved, [*channels]), source=str(path))


def _times(saved: MatVariables, source: str, options: ReadOptions) -> dict[str, FloatArray]:
    """The vectors that are times [s]; those of one length in one place that say the same count
    once.
    """
    times: dict[str, FloatArray] = {}
    for name, vector in list(saved.vectors.items()):
        short = name.rpartition(".")[2]
        named = None if _is_quantity(name, vector.astype(float), saved) else _TIME.fullmatch(short)
        if named or (_OWN_TIME.fullmatch(short) and on_grid(vector.astype(float)) is not None):
            times[name] = _in_seconds(
                name, vector.astype(float), (named and named[2]) or "", saved, source, options
            )
            del saved.vectors[name]
    return times


def _is_quantity(name: str, vector: FloatArray, saved: MatVariables) -> bool:
    """Whether a vector that is called as times are is another quantity: by its unit, or a `T` that
    does not rise (torque).
    """
    unit = saved.texts.get(f"units_{name}", "")
    falls = not (np.diff(vector) > 0).all()
    return bool(unit and seconds_of(unit) is None) or (name.rpartition(".")[2] == "T" and falls)


def _in_seconds(
    name: str,
    vector: FloatArray,
    ending: str,
    saved: MatVariables,
    source: str,
    options: ReadOptions,
) -> FloatArray:
    unit = saved.texts.get(f"units_{name}", "") or saved.texts.get("TimeUnit", "") or ending
    if unit:
        return vector * _seconds(unit, name, source)
    step = float(np.median(np.diff(vector)))
    # Neither milliseconds nor rows are counted in fractions.
    if step < 1:
        return vector
    if options.sample_time is None:
        may = f"seconds, milliseconds or a count of rows; save units_{name} = 's' beside it, or"
        raise BadRecord(
            f"{source}: nothing says the unit of {name!r}, whose steps are {step:g}: {may}",
            way_on=[("sample_time", "SECONDS")],
        )
    # Whatever the times count in, one step is as long as the caller says.
    return vector * (options.sample_time / step)


def _seconds(unit: str, name: str, source: str) -> float:
    if (seconds := seconds_of(unit)) is None:
        raise BadRecord(
            f"{source}: {name!r} is in {unit!r}, which is no unit of time; save it in seconds"
        )
    return seconds


def _timed_record(
    saved: MatVariables, times: dict[str, FloatArray], source: str, options: ReadOptions
) -> Record:
    channels, read = [], []
    for name, vector in saved.vectors.items():
        clock = _clock(saved, name, len(vector), times, source)
        if clock is not None:
            channels.append(
                TimedChannel(name, _unit(saved, name, options), times[clock], vector.astype(float))
            )
            read.append(name)
    for name, matrix in saved.matrices.items():
        for number, column in enumerate(_columns(saved, name, matrix, times, source), start=1):
            own = f"{name}_{number}"
            clock = _clock(saved, name, len(column), times, source)
            channels.append(
                TimedChannel(
                    own, _unit(saved, own, options), times[clock or ""], column.astype(float)
                )
            )
            read.append(name)
    if not channels:
        lengths = "".join(
            f"; {name} has {len(vector)} values" for name, vector in saved.vectors.items()
        )
        raise BadRecord(
            f"{source}: holds time ({', '.join(times)}) but no channel of its length{lengths}"
        )
    # before anything is resampled: scalars that contradict each other are refused in any case
    scalar = _scalar_step(saved, source)
    record = on_one_base(channels, source, options, _left_out(saved, read))
    # with several times, or where the caller says it, a scalar need not be of this one
    if len(times) == 1 and options.sample_time is None:
        _refuse_other_step(scalar, record.sample_time, source)
    return record


def _refuse_other_step(scalar: float | None, step: float, source: str) -> None:
    """Refuse a scalar sample time [s] that differs by more than 1 % from that of the times."""
    if scalar is not None and abs(scalar - step) > 0.01 * scalar:
        raise BadRecord(
            f"{source}: its time says {step:.6g} s a sample, its scalar {scalar:.6g} s",
            way_on=[("sample_time", "SECONDS")],
        )


def _clock(
    saved: MatVariables, name: str, length: int, times: dict[str, FloatArray], source: str
) -> str | None:
    """The time of a channel: of its length, in its struct before one outside."""
    fitting = [clock for clock, time in times.items() if len(time) == length]
    near = [clock for clock in fitting if saved.home[clock] == saved.home[name]] or fitting
    if any(not np.array_equal(times[clock], times[near[0]]) for clock in near[1:]):
        raise BadRecord(
            f"{source}: several times of {length} samples, {', '.join(near)}, for {name!r}; save"
            " one file a time"
        )
    return near[0] if near else None


def _columns(
    saved: MatVariables, name: str, matrix: np.ndarray, times: dict[str, FloatArray], source: str
) -> list[np.ndarray]:
    """The signals of a matrix: along the side that is as long as a time, which one side alone must
    be.
    """
    sides = [
        side
        for side in (0, 1)
        if _clock(saved, name, matrix.shape[side], times, source) is not None
    ]
    return list(matrix.T if sides == [0] else matrix) if len(sides) == 1 else []


def _left_out(saved: MatVariables, read: list[str]) -> tuple[str, ...]:
    vectors = [
        f"{name} ({len(vector)} values)"
        for name, vector in saved.vectors.items()
        if name not in read
    ]
    matrices = [
        f"{name} ({' × '.join(map(str, m.shape))})"
        for name, m in saved.matrices.items()
        if name not in read
    ]
    left = [*vectors, *matrices, *saved.no_signals]
    return (f"{NOT_READ}{', '.join(left)}",) if left else ()


def _instead(saved: MatVariables, content: dict[str, Any]) -> str:
    """What to save instead, by what the file holds."""
    if saved.matrices:
        name, matrix = next(iter(saved.matrices.items()))
        how = f"time = {name}(:,1); u = {name}(:,2); save('file.mat', 'time', 'u')"
        return (
            f", but the matrix {name} ({' × '.join(map(str, matrix.shape))}); save its columns"
            f" under their names: {how}"
        )
    if saved.no_signals or "__function_workspace__" in content:
        objects = ", ".join(saved.no_signals[:4]) or "objects of MATLAB"
        how = "save their parts, time = ts.Time; y = ts.Data; save('file.mat', 'time', 'y')"
        return (
            f" ({objects}); objects (timeseries, timetable, Dataset) are read by MATLAB alone:"
            f" {how}"
        )
    return ""


def _unit(saved: MatVariables, name: str, options: ReadOptions) -> str:
    return options.unit_of(name, saved.texts.get(f"units_{name}", ""))


def write_mat(record: Record, path: str | Path) -> None:
    """Write a MAT file of version 5 that `read_mat` gives back: channels, `time`,
    `units_<channel>`.
    """
    content: dict[str, Any] = {
        name: np.asarray(signal)[:, None] for name, signal in record.channels.items()
    }
    content |= {f"units_{name}": unit for name, unit in record.units.items() if unit}
    # With its unit, for times in steps of a second and more are refused where none is said.
    scipy.io.savemat(
        path, content | {"time": record.time[:, None], "units_time": "s"}, long_field_names=True
    )


def _load(path: str | Path) -> dict[str, Any]:
    try:
        with open(path, "rb") as file:
            # MATLAB's own 512 bytes stand before the signature.
            is_hdf5 = _HDF5 in file.read(1024)
        return (
            _load_hdf5(path)
            if is_hdf5
            else scipy.io.loadmat(path, squeeze_me=True, simplify_cells=True)
        )
    except (
        OSError,
        ValueError,
        TypeError,
        scipy.io.matlab.MatReadError,
        NotImplementedError,
        KeyError,
        EOFError,
        MemoryError,
    ) as error:
        raise BadRecord(
            f"{path}: is not a MAT file: {' '.join(str(error).split())[:120]}"
        ) from None


def _load_hdf5(path: str | Path) -> dict[str, Any]:
    try:
        import h5py  # noqa: PLC0415  optional: the extra `formats`
    except ImportError:
        raise BadRecord(
            f"{path}: MAT version 7.3 needs an extra: pip install 'residuum[formats]'"
        ) from None
    content: dict[str, Any] = {}

    def keep(name: str, node: Any) -> None:
        if (
            isinstance(node, h5py.Dataset)
            and node.dtype.kind in "fiu"
            # What cells and objects refer to; it has no names there.
            and not name.startswith("#refs#")
        ):
            is_text = node.attrs.get("MATLAB_class") == b"char"
            value = node[()]
            content[name.replace("/", ".")] = (
                # Version 7.3 keeps a text as the numbers of its characters.
                "".join(map(chr, np.ravel(value))) if is_text else np.squeeze(value)
            )

    with h5py.File(path, "r") as file:
        file.visititems(keep)
    return content


def _scalar_step(saved: MatVariables, source: str) -> float | None:
    """The sample time [s] that scalars say; `iddata` counts its `Ts` in its `TimeUnit`.

    Raises BadRecord for a unit that is none of time, and for scalars that contradict each other.
    """
    unit = saved.texts.get("TimeUnit", "s")
    steps = {name: saved.numbers[name] for name in _STEP if saved.numbers.get(name, 0.0) > 0}
    sample_times = {name: step * _seconds(unit, name, source) for name, step in steps.items()}
    sample_times |= {
        name: 1.0 / saved.numbers[name] for name in _RATE if saved.numbers.get(name, 0.0) > 0
    }
    # Rounded figures agree within a per cent. Of two that do not, either would give a wrong time
    # base.
    if sample_times and max(sample_times.values()) > 1.01 * min(sample_times.values()):
        both = ", ".join(f"{name} {step:.6g} s" for name, step in sample_times.items())
        raise BadRecord(
            f"{source}: its scalars say several sample times ({both}); save one of them"
        )
    return next(iter(sample_times.values()), None)
