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
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import lru_cache
from importlib import import_module
from itertools import islice
from pathlib import Path, PurePosixPath
from typing import IO, Any, Protocol
from urllib.parse import quote, unquote

import numpy as np
import numpy.typing as npt
import orjson
from sqlalchemy import select

from residuum.identification.errors import BadInput
from residuum.identification.record import Record
from residuum.identification.record_formats import OLDER, READERS
from residuum.identification.record_formats.histories import (
    HistoryReader,
    Windows,
    is_history,
    windows_of,
)
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

    def items(self) -> Sequence[str]:
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
    machines : tuple of str, optional
        Values of the column `each` whose windows they are. Default: all that it holds.
    """

    address: str
    machines: tuple[str, ...] | None = None

    def __str__(self) -> str:
        return _history(self.address).shown

    @property
    def each(self) -> str | None:
        """The column that says whose a window is."""
        return _history(self.address).each

    def items(self) -> Windows:
        """Addresses of the windows, by machine, oldest first."""
        return windows_of(self.address, self.machines)

    def machine_of(self, item: str) -> str | None:
        """Which of `machines` a window is of; None for another's."""
        machine = _history(self.address).machine_of(item)
        return machine if machine in (self.machines or ()) else None

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
    if is_history(text) and (scheme not in _DATABASES or "?" in text):
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


def _history(address: str) -> HistoryReader:
    """The open connection of a thread: a worker of Dask has several, and a connection answers one
    question at a time.
    """
    return _history_of(address, threading.get_ident())


@lru_cache(maxsize=64)
def _history_of(address: str, thread: int) -> HistoryReader:
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
    """Judge a file with a diagnoser and, where there is one, its baseline.

    Parameters
    ----------
    diagnoser : str
    baseline : str, optional
        A file; or where the source has `machines`, a folder of one for each (`machines_in`).
    source : FleetSource
    """

    diagnoser: str
    baseline: str | None
    source: FleetSource = field(default_factory=Folder)

    def mark(self, file: str) -> str:
        """What a file's result is made by."""
        return _mark(f"rescore {self.diagnoser}", self._baseline_of(file))

    def __call__(self, file: str) -> dict[str, Any]:
        """`{"by": …, "finding": …}` or `{"by": …, "refused": …}`."""
        try:
            # whoever names the baseline lets its FMU run, apart from the worker
            judge = diagnoser_of_file(self.diagnoser, self._baseline_of(file), fmus=True)
            finding = judge.score(self.source.read(file))
        except BadInput as error:
            return {"by": self.mark(file), "refused": str(error)}
        return {"by": self.mark(file), "finding": to_plain(finding.to_json())}

    @property
    def baselines(self) -> list[str]:
        """The files that are judged by."""
        if self.baseline is None:
            return []
        if self._machines is None:
            return [self.baseline]
        return [_baseline_file(self.baseline, machine) for machine in self._machines]

    @property
    def _machines(self) -> Sequence[str] | None:
        return self.source.machines if isinstance(self.source, HistoryWindows) else None

    def _baseline_of(self, file: str) -> str | None:
        source = self.source
        if not (self.baseline and isinstance(source, HistoryWindows) and source.machines):
            return self.baseline
        machine = source.machine_of(file)
        return machine and _baseline_file(self.baseline, machine)


_BASELINE = ".baseline"


def _baseline_file(folder: str, machine: str) -> str:
    # a name may hold what that of a file may not
    return str(Path(folder) / f"{quote(machine, safe=' ')}{_BASELINE}")


def machines_in(folder: Path) -> tuple[str, ...]:
    """The machines that have a baseline in a folder, `MACHINE.baseline`, sorted."""
    names = (file.name.removesuffix(_BASELINE) for file in folder.glob(f"*{_BASELINE}"))
    return tuple(sorted(unquote(name) for name in names))


@dataclass(frozen=True)
class Reidentify:
    """Identify a model from a file."""

    asked: Identify
    source: FleetSource = field(default_factory=Folder)

    def mark(self, file: str) -> str:
        """What the results are made by."""
        return _mark(f"reidentify {self.asked!r}", None)

    def __call__(self, file: str) -> dict[str, Any]:
        """`{"by": …, "model": …}` or `{"by": …, "refused": …}`."""
        try:
            model = identified_by([self.source.read(file)], self.asked)
        except BadInput as error:
            return {"by": self.mark(file), "refused": str(error)}
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
        return {"by": self.mark(file), "model": to_plain(fields)}


@lru_cache(maxsize=256)
def _mark(asked: str, baseline: str | None) -> str:
    content = b"" if baseline is None else Path(baseline).read_bytes()
    return hashlib.sha256(asked.encode() + b"\n" + content).hexdigest()[:16]


Work = Callable[[str], dict[str, Any]]
"""What is done with a file; must be known to the workers by name. A refusal is a value,
`{"refused": …}`.

A work with a `mark` of a file says it in its result, as `by`; results of another mark are not gone
on with.
"""

# Files that a worker is given at once, so that handing over costs little beside the work.
_TOGETHER = 8
# Tasks a worker that are under way or waiting at the executor.
_AHEAD = 3
# Times that a task may lose its worker before its files are done one by one, alone.
_ATTEMPTS = 5


@dataclass
class _Task:
    files: Sequence[str]
    places: Sequence[int]
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
) -> int:
    """Do `work` for every file that the results file does not have yet; `answers_of` reads what it
    then holds, in order of the files. Gives the number of lines of other files, which went.

    A file whose worker is killed is done again; one that ends its worker again and again, even
    alone, is refused. `tell(done, all)` is told of progress, first of what stood there before.
    BadInput when the results file holds results of other work, or of other files alone.
    """
    mark = getattr(work, "mark", None)
    lines = _ResultLines(results, files, mark)
    lost: deque[_Task] = deque()
    alone: deque[_Task] = deque()
    running: dict[Future[list[dict[str, Any]]], _Task] = {}
    tell(lines.count, len(files))
    waiting = _tasks(files, lines.missing())
    with results.open("ab") as out:
        while True:
            for task in _next(waiting, lost, alone, len(running), _AHEAD * workers):
                running[executor.submit(_work_all, work, task.files)] = task
            if not running:
                break
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                task = running.pop(future)
                answers = _found(future, task, mark)
                # its worker was lost: behind the others, so that what kills workers holds up
                # nothing
                if answers is None:
                    (lost if task.attempts < _ATTEMPTS else alone).extend(_again(task))
                    continue
                lines.add(out, task.places, answers)
                tell(lines.count, len(files))
    lines.put_in_order()
    return lines.of_others


def _tasks(files: Sequence[str], left: npt.NDArray[np.int64]) -> Iterator[_Task]:
    for begin in range(0, len(left), _TOGETHER):
        places = left[begin : begin + _TOGETHER].tolist()
        yield _Task([files[place] for place in places], places)


def _next(
    waiting: Iterator[_Task], lost: deque[_Task], alone: deque[_Task], running: int, most: int
) -> list[_Task]:
    """What to begin beside so many: tasks up to `most`, or one alone when nothing else is left."""
    begun = list(islice(waiting, most - running))
    begun += [lost.popleft() for _ in range(min(len(lost), most - running - len(begun)))]
    # alone, so that a worker that ends takes no other file's work along
    return begun if begun or running or not alone else [alone.popleft()]


def _work_all(work: Work, files: Sequence[str]) -> list[dict[str, Any]]:
    """In the worker."""
    return [{"file": file, **work(file)} for file in files]


def _found(
    future: Future[list[dict[str, Any]]], task: _Task, mark: Callable[[str], str] | None
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
        (file,) = task.files
        refused = {"refused": f"reading or judging it ended its worker {task.attempts} times"}
        return [{"file": file, **({} if mark is None else {"by": mark(file)}), **refused}]
    return None


def _again(task: _Task) -> list[_Task]:
    """A task that lost its worker too often is done file by file."""
    if task.attempts < _ATTEMPTS:
        return [task]
    return [
        _Task([file], [place], task.attempts)
        for file, place in zip(task.files, task.places, strict=True)
    ]


def answers_of(results: Path) -> Iterator[dict[str, Any]]:
    """The results of a finished run, one after another."""
    with results.open("rb") as lines:
        yield from map(orjson.loads, lines)


_BEGIN = b'{"file":'  # how a line of results begins


class _ResultLines:
    """The file of results: of each only the place of its line is kept in memory, for a year's would
    fill it.

    An earlier run's lines are gone on with; one that it could not finish is cut off.
    """

    def __init__(self, path: Path, files: Sequence[str], mark: Callable[[str], str] | None) -> None:
        self._path, self._mark = path, mark
        # offset of each file's line [bytes], -1 where there is none
        self._begins = np.full(len(files), -1, dtype=np.int64)
        self.count, self.of_others, self._end = 0, 0, 0
        if path.exists():
            self._take_up(_places(files))

    def _take_up(self, place_of: Callable[[str], int | None]) -> None:
        with self._path.open("r+b") as lines:
            for line in lines:
                # a run that was killed may have left half a line
                if not line.endswith(b"\n") and line.startswith(_BEGIN[: len(line)]):
                    lines.truncate(self._end)
                    break
                place = place_of(self._file_of(line))
                if place is not None:
                    self._note(place, len(line))
                else:
                    self.of_others += 1
                    self._end += len(line)
        if self.of_others and not self.count:
            raise BadInput(f"{self._path}: holds results of other records; give another name")

    def _file_of(self, line: bytes) -> str:
        try:
            answer = orjson.loads(line)
            file, mark = str(answer["file"]), answer.get("by")
        except (orjson.JSONDecodeError, AttributeError, KeyError, TypeError):
            raise BadInput(
                f"{self._path}: is there already and holds no results; give another name"
            ) from None
        if mark != (self._mark and self._mark(file)):
            raise BadInput(
                f"{self._path}: holds results of another diagnoser, baseline or method; give"
                " another name"
            )
        return file

    def _note(self, place: int, length: int) -> None:
        self.count += int(self._begins[place] < 0)
        self._begins[place] = self._end
        self._end += length

    def missing(self) -> npt.NDArray[np.int64]:
        """Places of the files that have no line."""
        return np.flatnonzero(self._begins < 0)

    def add(self, out: IO[bytes], places: Sequence[int], answers: Iterable[dict[str, Any]]) -> None:
        """Write the lines of files."""
        for place, answer in zip(places, answers, strict=True):
            line = orjson.dumps(answer) + b"\n"
            out.write(line)
            self._note(place, len(line))
        out.flush()

    def put_in_order(self) -> None:
        """The lines in order of the files, at once or not at all; those of other files go."""
        part = self._path.with_name(f"{self._path.name}.part")
        with self._path.open("rb") as lines, part.open("wb") as ordered:
            for begin in self._begins.tolist():
                lines.seek(begin)
                ordered.write(lines.readline())
            ordered.flush()
            os.fsync(ordered.fileno())
        part.replace(self._path)


def _places(files: Sequence[str]) -> Callable[[str], int | None]:
    """Name → its place."""
    if isinstance(files, Windows):
        return files.place_of
    return {file: place for place, file in enumerate(files)}.get
