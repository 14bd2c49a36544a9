"""Scoring in a worker process: a diagnoser is loaded once from its baseline file and judges the
windows that are sent.
"""

from __future__ import annotations

import tempfile
import threading
from collections.abc import Callable, Hashable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from residuum.diagnosis.diagnosers import DIAGNOSERS, untrained
from residuum.diagnosis.diagnosers.base import Diagnoser
from residuum.diagnosis.finding import Finding
from residuum.identification.errors import BadInput, Forbidden
from residuum.identification.physics.fmu.permission import holds_fmu
from residuum.identification.record import Record
from residuum.nearest_names import known_names
from residuum.service.machines.judged_apart import JudgedApart
from residuum.service.store import NotFound
from residuum.service.work.worker_pool import PlainRecord

# Trained diagnosers at hand: read from what is stored once, and kept for the next window.

# Diagnosers: those of a plant's machines, and a bound on the memory of a process that serves many.
_MOST_KEPT = 256


class KeptDiagnosers:
    """One instance a key, shared by all threads; the oldest goes where there are too many."""

    def __init__(self) -> None:
        self._kept: dict[Hashable, Diagnoser] = {}
        self._lock = threading.Lock()

    def get(self, key: Hashable, make: Callable[[], Diagnoser]) -> Diagnoser:
        """The one that is kept under this key, or else the one that is made now."""
        with self._lock:
            if key in self._kept:
                return self._kept[key]
        # outside the lock: reading one takes a while, and others are waited for meanwhile
        judge = make()
        with self._lock:
            while len(self._kept) >= _MOST_KEPT:
                self._kept.pop(next(iter(self._kept)))
            return self._kept.setdefault(key, judge)


IN_THIS_PROCESS = KeptDiagnosers()
"""Those of a worker process, which is sent names of files and of stored baselines, never
diagnosers.
"""


def diagnoser_of_file(diagnoser: str, file: str | None, *, fmus: bool = False) -> Diagnoser:
    """The diagnoser that a file holds, anew where the file changed; without a file the untrained
    one. With `fmus` one that holds an FMU judges in a process of its own; else it is refused.
    """
    kind = DIAGNOSERS[diagnoser]
    if not file:
        return IN_THIS_PROCESS.get(diagnoser, kind)
    changed = Path(file).stat().st_mtime_ns

    def read() -> Diagnoser:
        apart = fmus and holds_fmu(file)
        return JudgedApart(diagnoser, Path(file)) if apart else kind.load(Path(file))

    return IN_THIS_PROCESS.get((diagnoser, file, changed), read)


def diagnoser_of_content(kind: type[Diagnoser], content: bytes, *, fmus: bool = False) -> Diagnoser:
    """The trained diagnoser that a stored baseline holds; of `fmus` as `diagnoser_of_file`."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "baseline"
        file.write_bytes(content)
        if fmus and holds_fmu(file):
            return JudgedApart.by_copy(kind.name, file)
        return kind.load(file)


def content_of(trained: Diagnoser) -> bytes:
    """A trained diagnoser as it is stored."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "baseline"
        trained.save(file)
        return file.read_bytes()


# Trained diagnosers at hand: one instance a diagnoser and baseline, loaded once and shared by all
# requests.

Baseline = Callable[[str], tuple[str, bytes]]
"""Gives (version tag, stored file) of a named baseline; NotFound when there is none."""


class Judges:
    """Diagnosers by name, settings and baseline.

    A baseline is a stored trained diagnoser (model of kind `baseline`). A new version of it is
    taken up by the next call.
    """

    def __init__(self, baseline: Baseline, *, fmus: bool = False) -> None:
        self._baseline, self._fmus = baseline, fmus
        self._kept = KeptDiagnosers()

    def untrained(self, diagnoser: str, settings: Mapping[str, Any] | None = None) -> Diagnoser:
        """A diagnoser without baseline, which judges by absolute indicators and fault lines;
        BadInput for a setting it lacks.
        """
        key = (diagnoser, repr(sorted((settings or {}).items())))
        return self._kept.get(
            key, lambda: untrained(diagnoser_class(diagnoser), **(settings or {}))
        )

    def trained(self, diagnoser: str, baseline: str) -> Diagnoser:
        """A diagnoser with the newest version of a stored baseline; BadInput when it is one of
        another diagnoser.
        """
        version, content = self._baseline(baseline)
        key = (diagnoser, baseline, version)
        return self._kept.get(
            key,
            lambda: diagnoser_of_content(diagnoser_class(diagnoser), content, fmus=self._fmus),
        )


def diagnoser_class(name: str) -> type[Diagnoser]:
    """The class of this name; NotFound lists the names there are."""
    if name not in DIAGNOSERS:
        raise NotFound(
            f"diagnoser {name[:60]!r}: there is none of this name; {known_names(name, DIAGNOSERS)}"
        )
    return DIAGNOSERS[name]


def score_window(
    diagnoser: str,
    baseline: str,
    window: PlainRecord,
    method: str | None = None,
    fmus: bool = False,
) -> Finding:
    """Judge one window with the diagnoser stored in the file `baseline`; with none (an empty name)
    by absolute indicators.

    `method` is what decides, where a diagnoser has two; None: what the baseline was trained with.
    Without `fmus` a window is not assessable by a baseline that holds an FMU.

    Runs in a worker process. A window that the diagnoser refuses (a channel missing, a wrong unit)
    is not assessable.
    """
    try:
        judge = diagnoser_of_file(diagnoser, baseline, fmus=fmus)
    except Forbidden as refused:
        return Finding.not_assessable(diagnoser, str(refused))
    # a baseline that cannot be read is a fault of ours and raises; a window that is refused is a
    # finding
    try:
        record = window.record()
        finding = (judge if method is None else judge.with_settings(method=method)).score(record)
        # only values that are followed over windows need what they may have moved with
        if "parameters" not in finding.evidence:
            return finding
        return replace(finding, evidence={**finding.evidence, "conditions": conditions(record)})
    except BadInput as error:
        return Finding.not_assessable(diagnoser, str(error))


def conditions(record: Record) -> dict[str, Any]:
    """Mean and unit of every signal of a window: what a value may be found to move with over many
    windows.
    """
    means = {
        name: float(np.nanmean(values))
        for name, values in record.channels.items()
        if not np.isnan(values).all()
    }
    return {name: {"mean": mean, "unit": record.units[name]} for name, mean in means.items()}
