"""A diagnoser whose baseline holds an FMU, which judges in a process of its own: an FMU that breaks
down leaves a window unjudged, and ends nothing else.
"""

from __future__ import annotations

import copy
import shutil
import tempfile
import weakref
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Self

from residuum.diagnosis.diagnosers import DIAGNOSERS
from residuum.diagnosis.diagnosers.base import Diagnoser, Example
from residuum.diagnosis.finding import Finding
from residuum.identification.errors import BadInput
from residuum.identification.record import Record
from residuum.service.work.own_process import OwnProcess, ProcessEnded
from residuum.service.work.worker_pool import PlainRecord


class JudgedApart(Diagnoser):
    """What judges by the baseline in a file, in a process of its own.

    Parameters
    ----------
    diagnoser : str
    file : path
        Read there when a window is judged; it must stay as long as this does.
    """

    def __init__(self, diagnoser: str, file: Path) -> None:
        self._file = file
        self._process = OwnProcess()
        self._settings: dict[str, object] = {}
        # as the diagnoser itself describes it
        kind = DIAGNOSERS[diagnoser]
        for name in ("name", "channels", "classes", "methods", "views"):
            setattr(self, name, getattr(kind, name))

    @classmethod
    def by_copy(cls, diagnoser: str, file: Path) -> Self:
        """By a copy of the file, which stays as long as this does."""
        folder = tempfile.mkdtemp(prefix="residuum-baseline-")
        judge = cls(diagnoser, Path(shutil.copy(file, folder)))
        weakref.finalize(judge._process, shutil.rmtree, folder, ignore_errors=True)
        return judge

    def score(self, record: Record) -> Finding:
        """Judge one window; not assessable where the FMU ends the process."""
        try:
            return self._process.call(
                _scored, self.name, self._file, self._settings, PlainRecord.of(record)
            )
        except ProcessEnded as ended:
            return Finding.not_assessable(
                self.name,
                f"the FMU of the baseline ended the process that judged by it ({ended}); nothing"
                " else was harmed",
            )

    def with_settings(self, **settings: object) -> Self:
        """The same baseline with other settings, which are refused when a window is judged."""
        judge = copy.copy(self)
        judge._settings = {**self._settings, **settings}
        return judge

    def fit(self, records: Sequence[Record], labels: Sequence[str] | None = None) -> Self:
        """Refused: it was trained."""
        raise BadInput(_TRAINED)

    def refuse_learning(self, healthy: Sequence[Record]) -> None:
        """Refused: nothing is learned here."""
        raise BadInput(_TRAINED)

    def relearned(self, healthy: Sequence[Record]) -> Self:
        """Refused."""
        raise BadInput(_TRAINED)

    def save(self, path: str | Path) -> None:
        """Its file once more."""
        Path(path).write_bytes(self._file.read_bytes())

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Refused: a file does not say of which diagnoser it is."""
        raise BadInput(f"{path}: say of which diagnoser it is")

    @classmethod
    def examples(cls) -> Sequence[Example]:
        """None."""
        return ()


_TRAINED = (
    "the baseline holds an FMU, which learns by the command alone: residuum train model-based … "
    "--model drive.fmu --out FILE, then store FILE as a baseline"
)
_LOADED: dict[tuple[str, Path], Diagnoser] = {}
"""Of the process that judges."""


def _scored(
    diagnoser: str, file: Path, settings: Mapping[str, object], window: PlainRecord
) -> Finding:
    """The work of the process: its one baseline is read for the first window."""
    if (diagnoser, file) not in _LOADED:
        _LOADED[diagnoser, file] = DIAGNOSERS[diagnoser].load(file)
    judge = _LOADED[diagnoser, file]
    return (judge.with_settings(**settings) if settings else judge).score(window.record())
