"""A disk that forgets what was not fsynced: the write log of a program, recorded by strace, and what any power cut leaves of it.

The model is POSIX at its strictest. The content of a file is kept once fsync or fdatasync of it has returned; its name, and that
of a folder, once an fsync of the folder that holds it has. Of what came later any sectors of 512 bytes may be kept, in any order,
and any first part of the changes of names, in their order. A rename is kept whole or not at all.
"""

from __future__ import annotations

import random
import re
import subprocess
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath

SECTOR = 512
_CALLS = "openat,write,pwrite64,lseek,truncate,ftruncate,fsync,fdatasync"
_CALLS += ",rename,renameat,renameat2,unlink,unlinkat,mkdir,mkdirat,rmdir"
_OF_NAMES = dict.fromkeys(("rename", "renameat", "renameat2"), "rename")
_OF_NAMES |= dict.fromkeys(("unlink", "unlinkat", "rmdir"), "remove") | dict.fromkeys(
    ("mkdir", "mkdirat"), "folder"
)
_LINE = re.compile(
    r"(?P<process>\d+) +(?P<call>\w+)\((?P<given>.*)\) += (?P<result>-?\d+)(?:<(?P<place>[^>]*)>)?"
)
_TEXT = re.compile(r'"((?:\\x[0-9a-f]{2})*)"')
_OPEN = re.compile(r"^(\d+)<((?:\\x[0-9a-f]{2})*)>")
_FORGOTTEN_ANYWAY = "-shm"
"""Ending of SQLite's shared memory, which is made anew when nobody has the database open."""


@dataclass(frozen=True)
class Operation:
    """One step of a program: `kind` is create, write, truncate, sync, rename, remove, folder or said (a line that it printed)."""

    kind: str
    path: str = ""
    offset: int = 0
    data: bytes = b""
    target: str = ""


def recorded(program: Sequence[str], root: Path, log: Path) -> list[Operation]:
    """Run a Python program under strace; what it did below `root` and printed, in its order. RuntimeError when it fails."""
    strace = [
        "strace",
        "-f",
        "-qq",
        "-y",
        "-xx",
        "-s",
        str(2**27),
        "-e",
        f"trace={_CALLS}",
        "-e",
        "signal=none",
        "-o",
        str(log),
    ]
    done = subprocess.run(
        [*strace, sys.executable, *program], capture_output=True, text=True, check=False
    )
    if done.returncode:
        raise RuntimeError(done.stderr[-2000:])
    with log.open() as lines:
        return list(_operations(lines, str(root)))


def _operations(lines: Iterator[str], root: str) -> Iterator[Operation]:
    at: dict[tuple[str, int], int] = {}
    begun: dict[str, str] = {}
    for line in lines:
        process = line.split(" ", 1)[0]
        if "<unfinished ...>" in line:
            begun[process] = line.split("<unfinished ...>", maxsplit=1)[0]
            continue
        if "resumed>" in line:
            line = begun.pop(process) + line.split("resumed>", maxsplit=1)[1]
        match = _LINE.match(line)
        if match is not None and int(match["result"]) >= 0:
            yield from _operation(match, root, at)


def _operation(
    match: re.Match[str], root: str, at: dict[tuple[str, int], int]
) -> Iterator[Operation]:
    call, given, result = match["call"], match["given"], int(match["result"])
    texts = [_bytes(text) for text in _TEXT.findall(given)]
    if opened := _OPEN.match(given):
        place = match["process"], int(opened[1])
        if call == "write" and place[1] == 1:
            yield Operation("said", data=texts[0])
        elif call == "lseek":
            at[place] = result
        elif _inside(path := _bytes(opened[2]).decode(), root):
            yield _of_content(call, given, path, texts[0][:result] if texts else b"", at, place)
    elif _inside(path := texts[0].decode(), root):
        if call == "truncate":
            yield Operation("truncate", path, int(given.rsplit(",", 1)[1]))
            return
        if call != "openat":
            yield Operation(_OF_NAMES[call], path, target=texts[-1].decode())
            return
        at[match["process"], result] = 0
        if "O_CREAT" in given:
            yield Operation("create", path)
        if "O_TRUNC" in given:
            yield Operation("truncate", path)


def _of_content(
    call: str,
    given: str,
    path: str,
    data: bytes,
    at: dict[tuple[str, int], int],
    place: tuple[str, int],
) -> Operation:
    if call in ("fsync", "fdatasync"):
        return Operation("sync", path)
    if call == "write":
        begin = at.get(place, 0)
        at[place] = begin + len(data)
        return Operation("write", path, begin, data)
    last = int(given.rsplit(",", 1)[1])
    return (
        Operation("truncate", path, last)
        if call == "ftruncate"
        else Operation("write", path, last, data)
    )


def _bytes(text: str) -> bytes:
    return bytes.fromhex(text.replace("\\x", ""))


def _inside(path: str, root: str) -> bool:
    return path.startswith(root) and not path.endswith(_FORGOTTEN_ANYWAY)


@dataclass(eq=False)
class _File:
    data: bytearray = field(default_factory=bytearray)
    kept: bytes = b""
    later: list[tuple[int, bytes | None]] = field(default_factory=list)
    """Writes since the last sync; None for a change of length to the offset."""

    def do(self, offset: int, data: bytes | None) -> None:
        _apply(self.data, offset, data)
        self.later.append((offset, data))

    def after_cut(self, keep: float, chance: random.Random) -> bytes:
        """What is there when each sector that was not synced is kept with this probability."""
        if keep == 1.0:
            return bytes(self.data)
        found = bytearray(self.kept)
        for offset, data in self.later if keep else ():
            if data is None:
                if chance.random() < keep:
                    _apply(found, offset, None)
                continue
            begin = 0
            while begin < len(data):
                end = min(len(data), begin + SECTOR - (offset + begin) % SECTOR)
                if chance.random() < keep:
                    _apply(found, offset + begin, data[begin:end])
                begin = end
        return bytes(found)


def _apply(content: bytearray, offset: int, data: bytes | None) -> None:
    end = offset if data is None else offset + len(data)
    if data is None:
        del content[offset:]
    if len(content) < end:
        content.extend(bytes(end - len(content)))
    if data is not None:
        content[offset:end] = data


class ForgetfulDisk:
    """What a program has written below a folder that exists, and what of it would be left if the power went now."""

    def __init__(self, root: Path) -> None:
        self._root = str(root)
        self._now: dict[str, _File | None] = {}
        self._kept: dict[str, _File | None] = {}
        self._later: list[tuple[str, _File | None, str]] = []
        """Changes of names since they were synced: (name, what it names, name that goes)."""

    def begin_with(self, folder: Path) -> None:
        """Take over what is in a folder, as long since on the disk."""
        for place in sorted(folder.rglob("*")):
            file = (
                _File(bytearray(place.read_bytes()), place.read_bytes())
                if place.is_file()
                else None
            )
            name = f"{self._root}/{place.relative_to(folder)}"
            if _inside(name, self._root):
                self._now[name] = self._kept[name] = file

    def do(self, operation: Operation) -> None:
        """Carry out one step."""
        path = operation.path
        if operation.kind == "create" and path not in self._now:
            self._name(path, _File())
        elif operation.kind == "folder":
            self._name(path, None)
        elif operation.kind == "remove":
            self._now.pop(path, None)
            self._later.append(("", None, path))
        elif operation.kind == "rename":
            file = self._now.pop(path)
            self._now[operation.target] = file
            self._later.append((operation.target, file, path))
        elif operation.kind == "sync":
            self._sync(path)
        elif operation.kind in ("write", "truncate"):
            file = self._now.get(path)
            if file is not None:
                file.do(operation.offset, operation.data if operation.kind == "write" else None)

    def _name(self, path: str, file: _File | None) -> None:
        self._now[path] = file
        self._later.append((path, file, ""))

    def _sync(self, path: str) -> None:
        file = self._now.get(path)
        if file is not None:
            file.kept, file.later = bytes(file.data), []
            return
        of_it = [
            change
            for change in self._later
            if str(PurePosixPath(change[0] or change[2]).parent) == path
        ]
        self._later = [change for change in self._later if change not in of_it]
        _rename(self._kept, of_it)

    def cut(self, folder: Path, names: float, sectors: float, chance: random.Random) -> None:
        """Write what is left into a folder: this part of the changes of names, and each sector with this probability."""
        left = dict(self._kept)
        _rename(left, self._later[: round(names * len(self._later))])
        for path, file in sorted(left.items(), key=lambda item: item[0]):
            place = folder / path[len(self._root) + 1 :]
            if not place.parent.is_dir():
                continue  # a folder above it was forgotten
            if file is None:
                place.mkdir(exist_ok=True)
            else:
                place.write_bytes(file.after_cut(sectors, chance))


def _rename(
    names: dict[str, _File | None], changes: Sequence[tuple[str, _File | None, str]]
) -> None:
    for new, file, old in changes:
        if old:
            names.pop(old, None)
        if new:
            names[new] = file
