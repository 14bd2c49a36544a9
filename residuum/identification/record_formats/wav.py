"""Records as WAV: channels `channel_1`, `channel_2`, … scaled to ±1 of full scale
(dimensionless).
"""

import warnings
from pathlib import Path

import numpy as np
import scipy

from residuum.identification.errors import BadRecord
from residuum.identification.record import Record
from residuum.identification.record_formats.options import ReadOptions


def read_wav(path: str | Path, options: ReadOptions = ReadOptions()) -> Record:
    """Read a WAV file; integer samples are divided by full scale, 8-bit ones centred first."""
    try:
        with warnings.catch_warnings():
            # chunks that are not audio
            warnings.simplefilter("ignore", scipy.io.wavfile.WavFileWarning)
            rate, data = scipy.io.wavfile.read(path)
    except (OSError, ValueError, EOFError) as error:
        raise BadRecord(f"{path}: is not a WAV file: {error}") from None
    samples = _full_scale(np.atleast_2d(data.T))
    names = [f"channel_{k + 1}" for k in range(samples.shape[0])]
    return Record(
        dict(zip(names, samples, strict=True)),
        {name: options.unit_of(name) for name in names},
        options.settle_sample_time(1.0 / rate, str(path)),
        source=str(path),
    )


def write_wav(record: Record, path: str | Path) -> None:
    """Write the channels as 32-bit float samples; units are not kept by the format."""
    rate = round(record.sampling_rate)
    # The head holds whole samples a second: rounded, the record would come back with another time.
    if abs(rate - record.sampling_rate) > 1e-6 * record.sampling_rate:
        raise BadRecord(
            f"{path}: sampling rate {record.sampling_rate:.6g} Hz is not whole, as WAV needs; write"
            " .csv or .npz"
        )
    scipy.io.wavfile.write(
        path, rate, np.stack(list(record.channels.values()), axis=1).astype(np.float32)
    )


def _full_scale(data: np.ndarray) -> np.ndarray:
    if data.dtype.kind == "f":
        return data
    # samples of 8 bits have no sign: 128 is zero
    if data.dtype == np.uint8:
        return (data.astype(float) - 128.0) / 128.0
    return data / float(-np.iinfo(data.dtype).min)
