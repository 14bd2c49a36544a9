"""Records as ASAM MDF 4 measurement files (extra `formats`)."""

from pathlib import Path
from typing import Any

import numpy as np

from residuum.identification.errors import BadRecord
from residuum.identification.record import Record
from residuum.identification.record_formats.even_time import even_columns
from residuum.identification.record_formats.optional_package import need
from residuum.identification.record_formats.options import ReadOptions


def read_mdf(path: str | Path, options: ReadOptions = ReadOptions()) -> Record:
    """Read the numeric channels of an MDF file that share one time base.

    Raises BadRecord when the file is no MDF file, or its channels have several time bases and `options.resample`
    does not allow interpolation onto the finest.
    """
    asammdf = need("asammdf", path)
    with open(path, "rb") as head:
        if head.read(3) != b"MDF":
            raise BadRecord(f"{path}: is not an MDF file: it does not begin with 'MDF'")
    try:
        with asammdf.MDF(path) as file:
            signals = [signal for signal in file.iter_channels(skip_master=True) if _is_signal(signal)]
    except Exception as error:  # the reader raises its own, struct's, NumPy's and zlib's errors on damaged files
        raise BadRecord(f"{path}: is not an MDF file: {' '.join(str(error).split())[:120]}") from None
    if not signals:
        raise BadRecord(f"{path}: holds no numeric channel")
    finest = max((signal.timestamps for signal in signals), key=len)
    if not options.resample and any(not _same_base(signal.timestamps, finest) for signal in signals):
        raise BadRecord(f"{path}: channels have several time bases; resample to bring them onto the finest")
    names = [_free_name(signal, position, signals) for position, signal in enumerate(signals)]
    rows = [_on_base(signal, finest) for signal in signals]
    step, columns = even_columns(np.stack([finest, *rows]), str(path), resample=options.resample)
    return Record(
        dict(zip(names, columns[1:], strict=True)),
        {name: options.unit_of(name, signal.unit or "") for name, signal in zip(names, signals, strict=True)},
        options.settle_sample_time(step, str(path)),
        t0=float(columns[0][0]),
        source=str(path),
    )


def write_mdf(record: Record, path: str | Path) -> None:
    """Write a record so that `read_mdf` gives it back."""
    asammdf = need("asammdf", path)
    signals = [
        asammdf.Signal(samples=np.asarray(signal), timestamps=record.time, name=name, unit=record.units[name])
        for name, signal in record.channels.items()
    ]
    with asammdf.MDF(version="4.10") as file:
        file.append(signals, comment="\n".join(record.notes))
        file.save(path, overwrite=True)


def _is_signal(signal: Any) -> bool:
    return signal.samples.ndim == 1 and signal.samples.dtype.kind in "fiu" and len(signal.timestamps) > 1


def _same_base(first: np.ndarray, second: np.ndarray) -> bool:
    return first.shape == second.shape and bool(np.allclose(first, second, rtol=0, atol=1e-9))


def _on_base(signal: Any, base: np.ndarray) -> np.ndarray:
    samples = signal.samples.astype(float)
    return samples if _same_base(signal.timestamps, base) else np.interp(base, signal.timestamps, samples)


def _free_name(signal: Any, position: int, signals: list[Any]) -> str:
    taken = [other.name for other in signals[:position]]
    return str(signal.name) if signal.name not in taken else f"{signal.name}.{position}"
