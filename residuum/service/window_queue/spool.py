"""Spool: a gateway's windows on its disk, until each of them is known to be stored elsewhere."""

from __future__ import annotations

import threading
import uuid
from pathlib import Path

import structlog

from residuum.identification.errors import BadInput
from residuum.service.storage.durable_folder import keep_file, make_folder

log = structlog.get_logger()

_ENDING = ".request"
# Of versions that sent over a broker.
_FORMER = ".window"


class Spool:
    """Files in a folder, in the order in which they came; safe to use from any thread.

    A window is on disk when `put` returns. What was there at a crash is there at the next start,
    under the same keys.

    Parameters
    ----------
    folder : Path
    most_bytes : int
        When more would be kept, the oldest go, which is logged and counted in `dropped`.

    Raises
    ------
    BadInput
        A file that is no window of a machine, or one of a version that sent over a broker.
    """

    def __init__(self, folder: Path, most_bytes: int) -> None:
        make_folder(folder)
        self._folder, self._most = folder, most_bytes
        self._lock = threading.Lock()
        former = len(list(folder.glob(f"*{_FORMER}")))
        if former:
            raise BadInput(
                f"{folder}: {former} windows of a version that sent over a broker wait here; let"
                " that version send them, or move them out of the spool"
            )
        # a window that was not whole at a crash was never acknowledged to who put it
        for unfinished in folder.glob("*.part"):
            unfinished.unlink()
        files = sorted(folder.glob(f"*{_ENDING}"))
        self._files: dict[str, Path] = {}
        self._machine_of: dict[str, str] = {}
        self._keys_of: dict[str, dict[str, None]] = {}
        for file in files:
            _, *name_parts = file.name.removesuffix(_ENDING).split("-", maxsplit=2)
            if len(name_parts) != 2:
                raise BadInput(
                    f"{file}: its name does not say of which machine it is; move it out of the"
                    " spool"
                )
            self._list(name_parts[0], name_parts[1], file)
        self._sizes = {key: file.stat().st_size for key, file in self._files.items()}
        self._bytes = sum(self._sizes.values())
        self._next = int(files[-1].name.split("-", maxsplit=1)[0]) + 1 if files else 0
        self.dropped = 0

    def __len__(self) -> int:
        with self._lock:
            return len(self._files)

    def put(self, payload: bytes, machine: str) -> str:
        """Keep a window of a machine; returns its key once it is on disk. OSError when it cannot be
        written.
        """
        key = uuid.uuid4().hex
        with self._lock:
            file = self._folder / f"{self._next:012d}-{key}-{machine}{_ENDING}"
            self._next += 1
            keep_file(file, payload)
            self._list(key, machine, file)
            self._sizes[key] = len(payload)
            self._bytes += len(payload)
            self._let_the_oldest_go()
        return key

    def machines(self) -> list[str]:
        """Machines of which windows wait."""
        with self._lock:
            return list(self._keys_of)

    def oldest(self, machine: str) -> str | None:
        """Key of the first window of a machine that waits; None when none does."""
        with self._lock:
            return next(iter(self._keys_of.get(machine, ())), None)

    def read(self, key: str) -> bytes | None:
        """A window; None when it is gone."""
        with self._lock:
            file = self._files.get(key)
            return None if file is None else file.read_bytes()

    def remove(self, key: str) -> bool:
        """Let a window go; False when it had gone before."""
        with self._lock:
            if key not in self._files:
                return False
            self._forget(key)
            return True

    def _list(self, key: str, machine: str, file: Path) -> None:
        self._files[key], self._machine_of[key] = file, machine
        self._keys_of.setdefault(machine, {})[key] = None

    def _let_the_oldest_go(self) -> None:
        # never the last one: a single window larger than the spool is sent all the same
        while self._bytes > self._most and len(self._files) > 1:
            oldest = next(iter(self._files))
            machine = self._machine_of[oldest]
            self._forget(oldest)
            self.dropped += 1
            log.error(
                "the spool is full: the oldest window is let go unsent; setting keep_bytes is how"
                " much waits",
                machine=machine,
                let_go_in_all=self.dropped,
            )

    def _forget(self, key: str) -> None:
        self._files.pop(key).unlink(missing_ok=True)
        keys = self._keys_of[machine := self._machine_of.pop(key)]
        del keys[key]
        if not keys:
            del self._keys_of[machine]
        self._bytes -= self._sizes.pop(key)
