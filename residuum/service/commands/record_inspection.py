"""What `inspect` shows of a file, of one shape for every format: guesses, channels, rate, what has
no unit, the first rows.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from residuum.identification.record import Record
from residuum.identification.record_formats import ReadOptions
from residuum.identification.record_formats.loggers.first_rows import first_rows
from residuum.identification.record_formats.loggers.logger_file import LoggerFile
from residuum.identification.record_formats.read_apart import read_safely
from residuum.identification.residual_analysis.odd_readings import POWER_ON, far_beside, is_mark

_FEWEST = 30
_Column = tuple[int, str, str, int]
"""Its number, name and unit, and how many of its samples are missing."""


def of_record_file(file: Path, options: ReadOptions = ReadOptions()) -> tuple[dict[str, Any], str]:
    """(JSON object, text for people) of a file whose format says how it is read; the reader's
    refusal where it is not.
    """
    shown = _of_record(file, read_safely(file, options))
    return shown, _text(shown)


def _of_record(file: Path, record: Record) -> dict[str, Any]:
    columns = [
        (k, name, record.units[name], int(record.missing(name).sum()))
        for k, name in enumerate(record.names, start=1)
    ]
    samples: dict[str, Any] = {
        "rows": record.n,
        "sample_time": record.sample_time,
        "rate": record.sampling_rate,
        "even": True,
    }
    samples |= {"gaps": [], "gap_count": 0, "reordered": 0, "duplicates": 0}
    rows = first_rows(record.time, np.stack([record[name] for name in record.names]))
    signals = {name: np.asarray(record[name]) for name in record.names}
    shown = _shown(file, columns, samples, rows) | {
        "notes": [*record.notes, *_error_codes(signals, record.units)]
    }
    shown["ranges"] = {name: _range(signal) for name, signal in signals.items()}
    return shown


def of_logger_file(
    file: Path, logger_file: LoggerFile, resampled: Record | None = None
) -> tuple[dict[str, Any], str]:
    """(JSON object, text for people) of a logger's text file, as it is understood, or as it is
    `resampled` by that.
    """
    shown = _understood(file, logger_file) if resampled is None else _of_record(file, resampled)
    shown["guesses"] = [
        {"what": guess, "value": value, "reason": why}
        for guess, (value, why) in logger_file.guesses.items()
    ]
    shown["mapping"] = logger_file.mapping.to_yaml()
    return shown, _text(shown)


def _understood(file: Path, logger_file: LoggerFile) -> dict[str, Any]:
    mapping, samples = logger_file.mapping, dict(logger_file.samples)
    missing, rows, notes = samples.pop("missing"), samples.pop("first_rows"), samples.pop("notes")
    signals = samples.pop("signals")
    columns = [
        (k, name, mapping.units.get(k, ""), missing[name]) for k, name in mapping.names.items()
    ]
    shown = _shown(file, columns, samples, rows) | {
        "notes": [*notes, *_error_codes(signals, {name: unit for _, name, unit, _ in columns})]
    }
    shown["ranges"] = {name: _range(signal) for name, signal in signals.items()}
    return shown


def _shown(
    file: Path, columns: Sequence[_Column], samples: dict[str, Any], rows: list[list[float | None]]
) -> dict[str, Any]:
    return {
        "file": str(file),
        "guesses": [],
        "columns": [
            dict(zip(("column", "name", "unit", "missing"), column, strict=True))
            for column in columns
        ],
        "samples": samples,
        "without_unit": [name for _, name, unit, _ in columns if not unit],
        "first_rows": rows,
        "notes": [],
        "mapping": None,
    }


def _text(shown: dict[str, Any]) -> str:
    samples, columns = shown["samples"], shown["columns"]
    lines = [f"{shown['file']}: {_rows(samples)}, {len(columns)} channels"]
    lines[0] += "" if samples["duplicates"] else f", {samples['rate']:.6g} Hz"
    lines += [
        f"  {guess['what']}: {guess['value']!r} ({guess['reason']})" for guess in shown["guesses"]
    ]
    lines += [f"  {note}" for note in shown["notes"]]
    lines += [
        f"  column {c['column']}: {c['name']} [{c['unit']}], {c['missing']}"
        f" missing{_span(shown, c)}"
        for c in columns
    ]
    if bare := shown["without_unit"]:
        how = "--unit COLUMN=UNIT" + (
            ", or the mapping, says it" if shown["mapping"] else " says it to the commands"
        )
        lines.append(f"  without a unit: {', '.join(bare)}; {how}")
    for row in shown["first_rows"]:
        lines.append(
            "  " + ", ".join("missing" if value is None else f"{value:.12g}" for value in row)
        )
    lines += [
        f"  gap of {gap['seconds']:.6g} s after row {gap['after_row']}: {gap['looks_like']}"
        for gap in samples["gaps"]
    ]
    if samples["gap_count"] > len(samples["gaps"]):
        lines.append(f"  {samples['gap_count']} gaps in all")
    if not samples["even"]:
        lines.append("  steps are uneven: the commands take it with --resample")
    return "\n".join(lines)


def _range(signal: npt.NDArray[np.floating]) -> list[float] | None:
    """Lowest and highest value; None of a channel without any."""
    known = signal[np.isfinite(signal)]
    return [float(known.min()), float(known.max())] if known.size else None


def _span(shown: dict[str, Any], column: dict[str, Any]) -> str:
    span = shown["ranges"].get(column["name"])
    return "" if span is None else f", {span[0]:.6g} … {span[1]:.6g}"


def _error_codes(
    signals: Mapping[str, npt.NDArray[np.floating]], units: Mapping[str, str]
) -> list[str]:
    """What sensors write where they have no value, among rows far beside their neighbours."""
    says = []
    for name, signal in signals.items():
        if np.isfinite(signal).sum() < _FEWEST:
            continue
        values = np.asarray(signal, dtype=float)
        rows, _, _ = far_beside(values, units[name])
        coded = rows[is_mark(values[rows]) | (values[rows] == POWER_ON)].tolist()
        if coded:
            codes = sorted({float(values[row]) for row in coded})
            marks = " ".join(f"--missing {code:.10g}" for code in codes)
            where = ", ".join(map(str, coded[:12])) + ", …" * (len(coded) > 12)
            says.append(
                f"{name}: {len(coded)} samples (numbers {where}, from 0) read"
                f" {' or '.join(f'{c:.10g}' for c in codes)} beside their neighbours, as sensors"
                f" write where they have no value; then say {marks}"
            )
    return says


def _rows(samples: dict[str, Any]) -> str:
    """How many rows, and how far apart they are; where stamps stand several times nobody knows
    yet.
    """
    if repeated := samples["duplicates"]:
        return (
            f"{samples['rows']} rows, {samples['rows'] - repeated} stamps"
            f" {samples['sample_time']:.6g} s apart"
        )
    return f"{samples['rows']} rows of {samples['sample_time']:.6g} s"
