"""Long work as a job: the console program's own commands on stored models and records, so both give one answer."""

from __future__ import annotations

import io
import tempfile
from collections.abc import Mapping, Sequence
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any

import orjson

from residuum.identification.errors import BadInput
from residuum.identification.record import Record
from residuum.identification.record_formats import write_record
from residuum.service import cli
from residuum.service.commands.report import PROGRESS
from residuum.service.work.jobs import Progress

RecordParts = tuple[dict[str, Any], dict[str, str], float, float, tuple[str, ...], str]
"""A record as it travels to a worker process: the arguments of `Record`."""


def parts_of(record: Record) -> RecordParts:
    """The record's content, for a worker process."""
    return dict(record.channels), dict(record.units), record.sample_time, record.t0, record.notes, record.source


def run_commands(
    progress: Progress,
    steps: Sequence[Sequence[str]],
    files: Mapping[str, bytes],
    records: Mapping[str, RecordParts],
    out: str = "",
) -> Mapping[str, Any]:
    """Run commands one after the other in a folder of their own; the work of a job.

    Parameters
    ----------
    progress : callable
        Told each command's progress lines.
    steps : sequence of argument lists
        `["compare", "@model.yaml", "@record-3.npz"]`: an argument that begins with `@` is a file of the folder.
    files, records : mapping of file name to content
        What the folder holds at the start. The names are ours.
    out : str
        A file that the commands write; its content is under `file` of what is returned.

    Returns
    -------
    mapping
        `results`, the JSON objects that the commands print, and `file`.

    Raises
    ------
    BadInput
        What a command refuses, with its one line.
    """
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for file, content in files.items():
            (folder / file).write_bytes(content)
        for file, parts in records.items():
            write_record(Record(*parts), folder / file)
        shares = [(index / len(steps), 1 / len(steps)) for index in range(len(steps))]
        results = [_run(progress, list(step), folder, share) for step, share in zip(steps, shares, strict=True)]
        return {"results": results, "file": (folder / out).read_bytes() if out else None}


def _run(progress: Progress, step: list[str], folder: Path, share: tuple[float, float]) -> Any:
    """Run a command whose part of the work is `share` = (begin, length)."""
    progress(share[0], step[0])
    arguments = [str(folder / argument[1:]) if argument.startswith("@") else argument for argument in step]
    printed, said = io.StringIO(), _ProgressLines(progress, share)
    with redirect_stdout(printed), redirect_stderr(said):
        status = cli.run([*arguments, "--json"])
    if status == cli.BAD_INPUT:
        raise BadInput(said.last.removeprefix("residuum: ").replace(f"{folder}/", ""))
    if status not in (cli.DONE, cli.ANSWER_IS_NO):
        raise RuntimeError(f"{step[0]}: {said.last}")
    return orjson.loads(printed.getvalue().replace(f"{folder}/", ""))


class _ProgressLines(io.StringIO):
    """Standard error of a command: every line is progress, within the command's share of the work; the last one is kept."""

    def __init__(self, progress: Progress, share: tuple[float, float]) -> None:
        super().__init__()
        self._progress, self._share, self._done, self.last = progress, share, 0.0, ""

    def isatty(self) -> bool:
        """A job is watched, as a terminal is."""
        return True

    def write(self, text: str) -> int:
        """Take a line; TypeError for bytes, by which a caller learns that this is a stream of text."""
        if not isinstance(text, str):
            raise TypeError(f"progress lines are text, not {type(text).__name__}")
        if line := text.strip():
            self.last = line
            if told := PROGRESS.fullmatch(line):
                self._done, line = min(1.0, int(told[1]) / 100), told[2]
            begin, length = self._share
            self._progress(begin + length * self._done, line[:200])
        return len(text)
