"""A fleet's worth of files through one executor: each file once, whatever happens to the workers,
and resumable.

The executor is the one seam: `concurrent.futures` with a local pool that survives killed workers,
or a Dask cluster by its address. The results file gets a line of JSON a file as they come; when all
are done it is put in order of the files, so that it is the same to the byte however many workers
did it, and however often it was begun anew.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import tempfile
from collections import deque
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import lru_cache
from importlib import import_module
from pathlib import Path, PurePosixPath
from typing import IO, Any, Protocol

import orjson
from sqlalchemy import select

from residuum.identification.errors import BadInput
from residuum.identification.record import Record
from residuum.identification.record_formats import OLDER, READERS
from residuum.identification.record_formats.histories import HistoryReader, has_windows, windows_of
from residuum.identification.record_formats.history import HistoryAway
from residuum.identification.record_formats.read_apart import read_safely
from residuum.library.answers.plain import to_plain
from residuum.library.identification_methods import identified_by
from residuum.library.questions.identify import Identify
from residuum.service.machines.scoring import diagnoser_of_file
from residuum.service.storage.blocks import Blocks, BrokenBlock
from residuum.service.storage.database import Database, sqlite_file
from residuum.service.storage.tables import windows
from residuum.service.work.worker_pool import WorkerPool

# Where a fleet's records are: a folder, a bucket or archive by its URL, the windows that a service
# has stored, or those of a plant's history.

_ENDINGS = READERS | OLDER
_DATABASES = ("sqlite", "postgresql")


class Unreachable(Exception):
    """The place of the records is away. That says nothing of a record: none is refused, and the run
    can be gone on with.
    """


class FleetSource(Protocol):
    """Names of records, and the records themselves; travels to worker processes."""

    def items(self) -> list[str]:
        """All names, in an order that is always the same."""

    def read(self, item: str) -> Record:
        """The record of a name; BadInput when it cannot be read."""


@dataclass(frozen=True)
class Folder:
    """Record files below a folder, at any depth; a name is the file's path."""

    folder: str = "."

    def __str__(self) -> str:
        return self.folder

    def items(self) -> list[str]:
        """Paths of the files, sorted; BadInput for one that no line of results could name."""
        files = sorted(
            str(file) for file in Path(self.folder).rglob("*") if file.suffix.lower() in _ENDINGS
        )
        nameless = next((file for file in files if _is_no_text(file)), None)
        if nameless:
            raise BadInput(
                f"{os.fsencode(nameless)!r}: is a file name that is not UTF-8; rename the file"
            )
        return files

    def read(self, item: str) -> Record:
        """The record of a file."""
        return read_safely(item)


@dataclass(frozen=True)
class Bucket:
    """Record files below a URL that fsspec opens: `s3://bucket/plant`, `file:///srv`,
    `zip::file:///srv/plant.zip`.

    Who may read it is said by the environment, as the library of its protocol wants it (for s3 the
    AWS variables).
    """

    url: str

    def __str__(self) -> str:
        return self.url

    def items(self) -> list[str]:
        """Keys of the files, sorted."""
        try:
            files, root = _file_system(self.url)
            keys = files.find(root)
        except BadInput:
            raise
        except Exception as error:  # a protocol's library has errors of its own
            raise BadInput(
                f"{self.url}: cannot be listed: {type(error).__name__} {error}"
            ) from None
        return sorted(str(key) for key in keys if PurePosixPath(key).suffix.lower() in _ENDINGS)

    def read(self, item: str) -> Record:
        """The record of a file, copied here first because readers want files."""
        files, _ = _file_system(self.url)
        with tempfile.TemporaryDirectory() as folder:
            local = Path(folder) / PurePosixPath(item).name
            try:
                with files.open(item, "rb") as remote, local.open("wb") as copy:
                    shutil.copyfileobj(remote, copy)
                return _named(read_safely(local), item)
            except BadInput as error:
                raise BadInput(str(error).replace(str(local), item)) from None
            except OSError as error:
                raise BadInput(f"{item}: cannot be read: {error}") from None
            # a protocol's library has errors of its own, which cannot always leave the worker
            except Exception as error:
                raise Unreachable(
                    f"{item}: cannot be reached: {type(error).__name__} {error}"
                ) from None


@dataclass(frozen=True)
class StoredWindows:
    """Windows in a service's database whose signals are still kept; a name is `ASSET/NUMBER`.
    Nothing is changed.

    Parameters
    ----------
    url : str
        SQLAlchemy URL of the database.
    data : str
        The service's data folder, which has the signal blocks.
    """

    url: str
    data: str

    def __str__(self) -> str:
        return self.url

    def items(self) -> list[str]:
        """Names of the windows, by asset, oldest first."""
        file = sqlite_file(self.url)
        # SQLite would make an empty one
        if file is not None and not file.is_file():
            raise BadInput(f"{self.url}: there is no such database")
        database, _ = stored_in(self.url, self.data)
        database.refuse_other_revision()
        query = select(windows.c.asset_id, windows.c.id).where(windows.c.signal_let_go_at.is_(None))
        with database.read() as connection:
            rows = connection.execute(query.order_by(windows.c.asset_id, windows.c.id)).all()
        return [f"{row.asset_id}/{row.id}" for row in rows]

    def read(self, item: str) -> Record:
        """The signals of a window, verified."""
        database, blocks = stored_in(self.url, self.data)
        asset, _, number = item.rpartition("/")
        query = select(windows.c.block_path, windows.c.block_checksum).where(
            windows.c.asset_id == asset, windows.c.id == int(number)
        )
        with database.read() as connection:
            row = connection.execute(query).one_or_none()
        try:
            if row is None:
                raise BadInput(f"window {item}: was let go meanwhile")
            return blocks.read(row.block_path, checksum=row.block_checksum)
        except BrokenBlock as error:
            raise BadInput(f"window {item}: {error}") from None


@dataclass(frozen=True)
class HistoryWindows:
    """Windows of a plant's history; a name is the window's address, without a password.

    Parameters
    ----------
    address : str
        Of a table, with `window` and perhaps `each`: `timescale://plant/pumps/values?window=600`.
    """

    address: str

    def __str__(self) -> str:
        return _history(self.address).shown

    def items(self) -> list[str]:
        """Addresses of the windows, by machine, oldest first."""
        return windows_of(self.address)

    def read(self, item: str) -> Record:
        """The record of a window."""
        try:
            return _history(self.address).read(item)
        except HistoryAway as error:
            raise Unreachable(str(error)) from None


def fleet_source(text: str, data: Path | None) -> FleetSource:
    """What a command's argument names; BadInput for a folder that is none and a database without
    its data folder.
    """
    scheme = text.split("://", maxsplit=1)[0].split("+", maxsplit=1)[0] if "://" in text else ""
    if has_windows(text) and (scheme not in _DATABASES or "?" in text):
        return HistoryWindows(text)
    if scheme in _DATABASES:
        if data is None or not data.is_dir():
            raise BadInput(
                f"{text}: the signals of a database are in the service's data folder; give it with"
                " --data"
            )
        return StoredWindows(text, str(data.resolve()))
    if scheme:
        return Bucket(text)
    if not Path(text).is_dir():
        raise BadInput(f"{text}: is not a folder")
    return Folder(text)


@lru_cache(maxsize=4)
def _file_system(url: str) -> tuple[Any, str]:
    try:
        fsspec: Any = import_module("fsspec.core")  # optional: the extra `fleet`
    except ImportError:
        raise BadInput(f"{url}: needs the extra `fleet`: pip install 'residuum[fleet]'") from None
    files, root = fsspec.url_to_fs(url)
    return files, root


@lru_cache(maxsize=4)
def _history(address: str) -> HistoryReader:
    """The open connection of a process."""
    return HistoryReader(address)


@lru_cache(maxsize=4)
def stored_in(url: str, data: str) -> tuple[Database, Blocks]:
    """A service's database and signal blocks, opened once a process."""
    return Database(url), Blocks(Path(data) / "blocks")


def _is_no_text(name: str) -> bool:
    """Whether a name of the file system holds bytes that are no UTF-8."""
    return any("\ud800" <= character <= "\udfff" for character in name)


def _named(record: Record, source: str) -> Record:
    return Record(
        record.channels,
        record.units,
        record.sample_time,
        t0=record.t0,
        notes=record.notes,
        source=source,
    )


# What is done with each record of a fleet, in a worker: judge it, or identify a model from it.
# Every result says `by` what it was made: a mark of diagnoser, baseline and options. A run goes
# on only with results of its own.


@dataclass(frozen=True)
class Rescore:
    """Judge a file with a diagnoser and, where there is one, its baseline."""

    diagnoser: str
    baseline: str | None
    source: FleetSource = field(default_factory=Folder)

    @property
    def mark(self) -> str:
        """What the results are made by."""
        return _mark(f"rescore {self.diagnoser}", self.baseline)

    def __call__(self, file: str) -> dict[str, Any]:
        """`{"by": …, "finding": …}` or `{"by": …, "refused": …}`."""
        try:
            finding = diagnoser_of_file(self.diagnoser, self.baseline).score(self.source.read(file))
        except BadInput as error:
            return {"by": self.mark, "refused": str(error)}
        return {"by": self.mark, "finding": to_plain(finding.to_json())}


@dataclass(frozen=True)
class Reidentify:
    """Identify a model from a file."""

    asked: Identify
    source: FleetSource = field(default_factory=Folder)

    @property
    def mark(self) -> str:
        """What the results are made by."""
        return _mark(f"reidentify {self.asked!r}", None)

    def __call__(self, file: str) -> dict[str, Any]:
        """`{"by": …, "model": …}` or `{"by": …, "refused": …}`."""
        try:
            model = identified_by([self.source.read(file)], self.asked)
        except BadInput as error:
            return {"by": self.mark, "refused": str(error)}
        fields = {
            "method": model.method,
            "order": model.order,
            "delay": model.delay,
            "sample_time": model.sample_time,
            "impulse_response": model.impulse_response,
            "std": model.std,
            "noise_variance": model.noise_variance,
            "numerator": model.numerator,
            "denominator": model.denominator,
            "warnings": list(model.warnings),
        }
        return {"by": self.mark, "model": to_plain(fields)}


@lru_cache(maxsize=4)
def _mark(asked: str, baseline: str | None) -> str:
    content = b"" if baseline is None else Path(baseline).read_bytes()
    return hashlib.sha256(asked.encode() + b"\n" + content).hexdigest()[:16]


Work = Callable[[str], dict[str, Any]]
"""What is done with a file; must be known to the workers by name. A refusal is a value,
`{"refused": …}`.

A work with a `mark` says it in every result, as `by`; results of another mark are not gone on with.
"""

# Files that a worker is given at once, so that handing over costs little beside the work.
_TOGETHER = 8
# Tasks a worker that are under way or waiting at the executor.
_AHEAD = 3
# Times that a task may lose its worker before its files are done one by one, alone.
_ATTEMPTS = 5


@dataclass
class _Task:
    files: list[str]
    attempts: int = 0


@contextmanager
def open_executor(workers: int, scheduler: str | None) -> Iterator[Executor]:
    """A local pool of so many processes, or the Dask cluster at an address; BadInput when it cannot
    be reached.
    """
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
        raise BadInput(
            "--scheduler: needs the extra `fleet`: pip install 'residuum[fleet]'"
        ) from None
    try:
        client = connect(scheduler, timeout=10)  # [s]
    except (OSError, ValueError, TimeoutError) as error:
        raise BadInput(f"--scheduler {scheduler!r}: cannot be reached: {error}") from None
    with client:
        # pure: Dask would give a task that is done again the result it remembers
        yield client.get_executor(pure=False)


def run_fleet(
    files: Sequence[str],
    work: Work,
    executor: Executor,
    results: Path,
    *,
    workers: int,
    tell: Callable[[int, int], None],
) -> list[dict[str, Any]]:
    """Do `work` for every file that the results file does not have yet; returns all results, in
    order of the files.

    A file whose worker is killed is done again; one that ends its worker again and again, even
    alone, is refused. `tell(done, all)` is told of progress. BadInput when the results file holds
    results of other work.
    """
    mark = getattr(work, "mark", None)
    known = _read(results, set(files), mark)
    waiting = deque(_tasks(files, known))
    alone: deque[_Task] = deque()
    running: dict[Future[list[dict[str, Any]]], _Task] = {}
    with results.open("ab") as out:
        while waiting or running or alone:
            for task in _next(waiting, alone, len(running), _AHEAD * workers):
                running[executor.submit(_work_all, work, task.files)] = task
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                task = running.pop(future)
                answers = _found(future, task, mark)
                # its worker was lost: behind the others, so that what kills workers holds up
                # nothing
                if answers is None:
                    (waiting if task.attempts < _ATTEMPTS else alone).extend(_again(task))
                    continue
                known |= {answer["file"]: answer for answer in answers}
                _write_lines(out, answers)
                tell(len(known), len(files))
    ordered = [known[file] for file in files]
    _write(results, ordered)
    return ordered


def _tasks(files: Sequence[str], done: Collection[str]) -> list[_Task]:
    left = [file for file in files if file not in done]
    return [_Task(left[begin : begin + _TOGETHER]) for begin in range(0, len(left), _TOGETHER)]


def _next(waiting: deque[_Task], alone: deque[_Task], running: int, most: int) -> list[_Task]:
    """What to begin beside so many: tasks up to `most`, or one alone when nothing else is left."""
    # alone, so that a worker that ends takes no other file's work along
    begun = [waiting.popleft() for _ in range(min(len(waiting), most - running))]
    return begun if begun or running or not alone else [alone.popleft()]


def _work_all(work: Work, files: list[str]) -> list[dict[str, Any]]:
    """In the worker."""
    return [{"file": file, **work(file)} for file in files]


def _found(
    future: Future[list[dict[str, Any]]], task: _Task, mark: str | None
) -> list[dict[str, Any]] | None:
    """What a task gave, None when its worker was lost; a lone file that has lost too many is
    refused.
    """
    error = future.exception()
    if error is None:
        return future.result()
    if isinstance(error, Unreachable):
        raise BadInput(
            f"{error}; what was done before is in the results file, give the same command to go on"
        )
    # by name: those of Dask are not there where the extra is not installed
    if type(error).__name__ not in (
        "BrokenProcessPool",
        "KilledWorker",
        "CancelledError",
        "FutureCancelledError",
    ):
        raise error
    task.attempts += 1
    if len(task.files) == 1 and task.attempts > 2 * _ATTEMPTS:
        refused = {"refused": f"reading or judging it ended its worker {task.attempts} times"}
        return [{"file": task.files[0], **({} if mark is None else {"by": mark}), **refused}]
    return None


def _again(task: _Task) -> list[_Task]:
    """A task that lost its worker too often is done file by file."""
    return (
        [task]
        if task.attempts < _ATTEMPTS
        else [_Task([file], max(task.attempts, _ATTEMPTS)) for file in task.files]
    )


def _read(results: Path, wanted: set[str], mark: str | None) -> dict[str, dict[str, Any]]:
    """What an earlier run left; a line that it could not finish is cut off. BadInput for a file of
    another kind or work.
    """
    if not results.exists():
        return {}
    content = results.read_bytes()
    # a run that was killed may have left half a line
    whole = content[: content.rfind(b"\n") + 1]
    try:
        lines = [orjson.loads(line) for line in whole.splitlines()]
        known = {line["file"]: line for line in lines if line["file"] in wanted}
        marks = {line.get("by") for line in lines}
    except (orjson.JSONDecodeError, AttributeError, KeyError, TypeError):
        raise BadInput(
            f"{results}: is there already and holds no results; give another name"
        ) from None
    if marks - {mark}:
        raise BadInput(
            f"{results}: holds results of another diagnoser, baseline or method; give another name"
        )
    if whole != content:
        with results.open("r+b") as file:
            file.truncate(len(whole))
    return known


def _write_lines(file: IO[bytes], answers: Iterable[dict[str, Any]]) -> None:
    file.writelines(orjson.dumps(answer) + b"\n" for answer in answers)
    file.flush()


def _write(results: Path, ordered: list[dict[str, Any]]) -> None:
    part = results.with_name(f"{results.name}.part")
    with part.open("wb") as file:
        _write_lines(file, ordered)
        os.fsync(file.fileno())
    part.replace(results)
