"""Spool: a gateway's windows on its disk, until each of them is known to be stored elsewhere."""

from __future__ import annotations

import os
import threading
import uuid
from itertools import islice
from pathlib import Path

from residuum.identification.errors import BadInput
from residuum.service.storage.durable_folder import make_folder, sync_folder

_ENDING = ".window"


class Spool:
    """Files in a folder, in the order in which they came; safe to use from any thread.

    A message is on disk when `put` returns. What was there at a crash is there at the next start, under the same keys.

    Parameters
    ----------
    folder : Path
    most_bytes : int
        When more would be kept, the oldest go, and are counted in `dropped`.
    """

    def __init__(self, folder: Path, most_bytes: int) -> None:
        make_folder(folder)
        self._folder, self._most = folder, most_bytes
        self._lock = threading.Lock()
        for unfinished in folder.glob("*.part"):
            unfinished.unlink()
        files = sorted(folder.glob(f"*{_ENDING}"))
        self._files: dict[str, Path] = {}
        self._machine_of: dict[str, str] = {}
        self._keys_of: dict[str, dict[str, None]] = {}
        for file in files:
            _, *told = file.name.removesuffix(_ENDING).split("-", maxsplit=2)
            if len(told) != 2:
                raise BadInput(f"{file}: its name does not say of which machine it is; move it out of the spool")
            self._list(told[0], told[1], file)
        self._sizes = {key: file.stat().st_size for key, file in self._files.items()}
        self._bytes = sum(self._sizes.values())
        self._next = int(files[-1].name.split("-", maxsplit=1)[0]) + 1 if files else 0
        self.dropped = 0

    def __len__(self) -> int:
        with self._lock:
            return len(self._files)

    def put(self, payload: bytes, machine: str) -> str:
        """Keep a message of a machine; returns its key once it is on disk. OSError when it cannot be written."""
        key = uuid.uuid4().hex
        with self._lock:
            file = self._folder / f"{self._next:012d}-{key}-{machine}{_ENDING}"
            self._next += 1
            part = self._folder / f"{key}.part"
            with part.open("wb") as opened:
                opened.write(payload)
                opened.flush()
                os.fsync(opened.fileno())
            part.replace(file)
            sync_folder(self._folder)
            self._list(key, machine, file)
            self._sizes[key] = len(payload)
            self._bytes += len(payload)
            while self._bytes > self._most and len(self._files) > 1:
                self._forget(next(iter(self._files)))
                self.dropped += 1
        return key

    def oldest(self, count: int) -> dict[str, list[str]]:
        """Keys of the first messages of each machine, in order."""
        with self._lock:
            return {machine: list(islice(keys, count)) for machine, keys in self._keys_of.items()}

    def read(self, key: str) -> bytes | None:
        """A message; None when it is gone."""
        with self._lock:
            file = self._files.get(key)
            return None if file is None else file.read_bytes()

    def remove(self, key: str) -> bool:
        """Let a message go; False when it had gone before."""
        with self._lock:
            if key not in self._files:
                return False
            self._forget(key)
            return True

    def _list(self, key: str, machine: str, file: Path) -> None:
        self._files[key], self._machine_of[key] = file, machine
        self._keys_of.setdefault(machine, {})[key] = None

    def _forget(self, key: str) -> None:
        self._files.pop(key).unlink(missing_ok=True)
        keys = self._keys_of[machine := self._machine_of.pop(key)]
        del keys[key]
        if not keys:
            del self._keys_of[machine]
        self._bytes -= self._sizes.pop(key)
