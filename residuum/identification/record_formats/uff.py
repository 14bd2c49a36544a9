"""Records as Universal File Format, data set 58 time responses (extra `formats`)."""

import warnings
from pathlib import Path
from typing import Any

import numpy as np

from residuum.identification.errors import BadRecord
from residuum.identification.record import Record
from residuum.identification.record_formats.optional_package import need
from residuum.identification.record_formats.options import ReadOptions

_TIME_RESPONSE = 1


def read_uff(path: str | Path, options: ReadOptions = ReadOptions()) -> Record:
    """Read the time responses of a UFF58 file; a channel is named by `id1`, its unit by the
    ordinate label.

    Raises BadRecord when the file is no UFF58 file, or its responses differ in length or sample
    time.
    """
    sets = [
        data
        for data in _data_sets(path)
        if data.get("type") == 58 and data.get("func_type") == _TIME_RESPONSE
    ]
    if not sets:
        raise BadRecord(f"{path}: holds no time response (UFF data set 58, function type 1)")
    steps = {float(data["abscissa_inc"]) for data in sets}
    if len(steps) > 1:
        raise BadRecord(
            f"{path}: responses differ in sample time {sorted(steps)}; one record has one; export"
            " them as files of their own"
        )
    names = _names(sets)
    return Record(
        {name: np.real(np.asarray(data["data"])) for name, data in zip(names, sets, strict=True)},
        {name: options.unit_of(name, _unit(data)) for name, data in zip(names, sets, strict=True)},
        options.settle_sample_time(next(iter(steps)), str(path)),
        t0=float(sets[0].get("abscissa_min", 0.0)),
        source=str(path),
    )


def write_uff(record: Record, path: str | Path) -> None:
    """Write one data set 58 a channel as text of 12 digits, so that `read_uff` gives it back.

    Raises BadRecord for missing samples: the format has none, and its library writes zeros for
    them.
    """
    # They became zeros, and were read back as measurements.
    if lacking := [name for name in record.names if record.missing(name).any()]:
        raise BadRecord(
            f"{path}: UFF 58 keeps no missing samples, and channel {lacking[0]!r} has some; write"
            " .csv, .npz or .parquet"
        )
    pyuff = need("pyuff", path)
    file = pyuff.UFF(str(path))
    sets = [
        pyuff.prepare_58(
            binary=0,
            func_type=_TIME_RESPONSE,
            rsp_node=position + 1,
            rsp_dir=1,
            ref_node=0,
            ref_dir=0,
            id1=name,
            data=np.asarray(signal, dtype=float),
            x=record.time,
            ord_data_type=4,  # real, double precision
            abscissa_spacing=1,  # even
            abscissa_min=record.t0,
            abscissa_inc=record.sample_time,
            num_pts=record.n,
            abscissa_spec_data_type=17,  # time; 0 is unknown
            ordinate_spec_data_type=0,
            orddenom_spec_data_type=0,
            z_axis_spec_data_type=0,
            ordinate_axis_units_lab=record.units[name] or "NONE",
            return_full_dict=False,
        )
        for position, (name, signal) in enumerate(record.channels.items())
    ]
    Path(path).unlink(missing_ok=True)  # sets are appended
    file.write_sets(sets, mode="add")


def _data_sets(path: str | Path) -> list[dict[str, Any]]:
    pyuff = need("pyuff", path)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # deprecations of the reader's own dependencies
            sets = pyuff.UFF(str(path)).read_sets()
    except Exception as error:  # the reader raises bare Exception on damaged files
        raise BadRecord(
            f"{path}: is not a UFF file: {' '.join(str(error).split())[:120]}"
        ) from None
    return sets if isinstance(sets, list) else [sets]


def _names(sets: list[dict[str, Any]]) -> list[str]:
    """A name a response, numbered where two are the same."""
    names = [_name(data, position) for position, data in enumerate(sets)]
    if len(set(names)) != len(names):
        return [f"{name}.{position}" for position, name in enumerate(names)]
    return names


def _name(data: dict[str, Any], position: int) -> str:
    label = str(data.get("id1", "")).strip()
    return label if label and label != "NONE" else f"channel_{position + 1}"


def _unit(data: dict[str, Any]) -> str:
    label = str(data.get("ordinate_axis_units_lab", "")).strip()
    return "" if label == "NONE" else label
