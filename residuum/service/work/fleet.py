"""A fleet's worth of files through one executor: each file once, whatever happens to the workers, and resumable.

The executor is the one seam: `concurrent.futures` with a local pool that survives killed workers, or a Dask cluster by its
address. The results file gets a line of JSON a file as they come; when all are done it is put in order of the files, so that
it is the same to the byte however many workers did it, and however often it was begun anew.
"""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import orjson

from residuum.identification.errors import BadInput
from residuum.service.work.fleet_source import Unreachable
from residuum.service.work.worker_pool import WorkerPool

Work = Callable[[str], dict[str, Any]]
"""What is done with a file; must be known to the workers by name. A refusal is a value, `{"refused": …}`.

A work with a `mark` says it in every result, as `by`; results of another mark are not gone on with.
"""

_TOGETHER = 8
"""Files that a worker is given at once, so that handing over costs little beside the work."""
_AHEAD = 3
"""Tasks a worker that are under way or waiting at the executor."""
_ATTEMPTS = 5
"""Times that a task may lose its worker before its files are done one by one, alone."""


@dataclass
class _Task:
    files: list[str]
    attempts: int = 0


@contextmanager
def open_executor(workers: int, scheduler: str | None) -> Iterator[Executor]:
    """A local pool of so many processes, or the Dask cluster at an address; BadInput when it cannot be reached."""
    if scheduler is None:
        pool = WorkerPool(workers)
        try:
            yield pool
        finally:
            pool.terminate()
        return
    try:
        connect: Any = import_module("distributed").Client  # optional: the extra `fleet`
    except ImportError:
        raise BadInput("--scheduler: needs the extra `fleet`: pip install 'residuum[fleet]'") from None
    try:
        client = connect(scheduler, timeout=10)
    except (OSError, ValueError, TimeoutError) as error:
        raise BadInput(f"--scheduler {scheduler!r}: cannot be reached: {error}") from None
    with client:
        yield client.get_executor(pure=False)


def run_fleet(
    files: Sequence[str], work: Work, executor: Executor, results: Path, *, workers: int, tell: Callable[[int, int], None]
) -> list[dict[str, Any]]:
    """Do `work` for every file that the results file does not have yet; returns all results, in order of the files.

    A file whose worker is killed is done again; one that ends its worker again and again, even alone, is refused.
    `tell(done, all)` is told of progress. BadInput when the results file holds results of other work.
    """
    mark = getattr(work, "mark", None)
    known = _read(results, set(files), mark)
    waiting = deque(_tasks([file for file in files if file not in known]))
    alone: deque[_Task] = deque()
    running: dict[Future[list[dict[str, Any]]], _Task] = {}
    with results.open("ab") as out:
        while waiting or running or alone:
            for task in _next(waiting, alone, len(running), _AHEAD * workers):
                running[executor.submit(_work_all, work, task.files)] = task
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                task = running.pop(future)
                found = _found(future, task, mark)
                if found is None:
                    (waiting if task.attempts < _ATTEMPTS else alone).extend(_again(task))
                    continue
                known |= {each["file"]: each for each in found}
                out.writelines(orjson.dumps(each) + b"\n" for each in found)
                out.flush()
                tell(len(known), len(files))
    ordered = [known[file] for file in files]
    _write(results, ordered)
    return ordered


def _tasks(files: list[str]) -> list[_Task]:
    return [_Task(files[begin : begin + _TOGETHER]) for begin in range(0, len(files), _TOGETHER)]


def _next(waiting: deque[_Task], alone: deque[_Task], running: int, most: int) -> list[_Task]:
    """What to begin beside so many: tasks up to `most`, or one alone when nothing else is left."""
    begun = [waiting.popleft() for _ in range(min(len(waiting), most - running))]
    return begun if begun or running or not alone else [alone.popleft()]


def _work_all(work: Work, files: list[str]) -> list[dict[str, Any]]:
    """In the worker."""
    return [{"file": file, **work(file)} for file in files]


def _found(future: Future[list[dict[str, Any]]], task: _Task, mark: str | None) -> list[dict[str, Any]] | None:
    """What a task gave, None when its worker was lost; a lone file that has lost too many is refused."""
    error = future.exception()
    if error is None:
        return future.result()
    if isinstance(error, Unreachable):
        raise BadInput(f"{error}; what was done before is in the results file, give the same command to go on")
    if type(error).__name__ not in ("BrokenProcessPool", "KilledWorker", "CancelledError", "FutureCancelledError"):
        raise error
    task.attempts += 1
    if len(task.files) == 1 and task.attempts > 2 * _ATTEMPTS:
        refused = {"refused": f"reading or judging it ended its worker {task.attempts} times"}
        return [{"file": task.files[0], **({} if mark is None else {"by": mark}), **refused}]
    return None


def _again(task: _Task) -> list[_Task]:
    """A task that lost its worker too often is done file by file."""
    return [task] if task.attempts < _ATTEMPTS else [_Task([file], max(task.attempts, _ATTEMPTS)) for file in task.files]


def _read(results: Path, wanted: set[str], mark: str | None) -> dict[str, dict[str, Any]]:
    """What an earlier run left; a line that it could not finish is cut off. BadInput for a file of another kind or work."""
    if not results.exists():
        return {}
    content = results.read_bytes()
    whole = content[: content.rfind(b"\n") + 1]
    try:
        lines = [orjson.loads(line) for line in whole.splitlines()]
        known = {line["file"]: line for line in lines if line["file"] in wanted}
        marks = {line.get("by") for line in lines}
    except (orjson.JSONDecodeError, AttributeError, KeyError, TypeError):
        raise BadInput(f"{results}: is there already and holds no results; give another name") from None
    if marks - {mark}:
        raise BadInput(f"{results}: holds results of another diagnoser, baseline or method; give another name")
    if whole != content:
        with results.open("r+b") as file:
            file.truncate(len(whole))
    return known


def _write(results: Path, ordered: list[dict[str, Any]]) -> None:
    part = results.with_name(f"{results.name}.part")
    with part.open("wb") as file:
        file.writelines(orjson.dumps(each) + b"\n" for each in ordered)
        file.flush()
        os.fsync(file.fileno())
    part.replace(results)
