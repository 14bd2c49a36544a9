"""Signal blocks: one file a record, self-describing, with checksums, on disk before anybody is told
so.
"""

from __future__ import annotations

import errno
import hashlib
import math
import os
import time
import uuid
import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import orjson

from residuum.identification.record import Record
from residuum.service.storage.durable_folder import make_folder, sync_folder
from residuum.service.store import ReadInPieces, StorageUnavailable

MAGIC = b"RESIDUUM-BLOCK-2\n"
# Blocks of before headers had a checksum of their own: these are compared as a whole with that of
# their row.
_WITHOUT_CHECKSUM = b"RESIDUUM-BLOCK-1\n"
_BEGIN = len(MAGIC) + 8
# Bytes of the header's checksum.
_CRC = 4
# Bytes: a line of the processor's cache.
_ALIGNMENT = 64
# A quota that is used up is a full disk to whoever sends a window: 507 (RFC 4918, 11.5), not 503.
_FULL = (errno.ENOSPC, errno.EDQUOT)
# Bytes of a small window, whose room is tried. Written, not asked for: a file system's free bytes
# tell nothing of a quota or a read-only mount.
_PROBE = 64 * 1024
# Bytes of a long channel that are read at once.
_PIECE = 2**20


class BrokenBlock(Exception):
    """A block's content does not match its checksum, or it is no block; the message names the
    file.
    """


@dataclass(frozen=True)
class BlockReference:
    """What a row keeps of a block: its path below the folder, the SHA-256 of the file, its size."""

    path: str
    checksum: str
    size_bytes: int


class Blocks:
    """The folder of signal blocks.

    A file is: magic line, length of the header and CRC-32 over both and it (8 and 4 bytes, little
    endian), header as JSON, then each channel's samples (little endian, contiguous, aligned to 64
    bytes). The header carries a CRC-32 of every channel, so one channel of a long record can be
    read and verified alone. Names are ours (date and UUID), never a user's.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        make_folder(self.folder)

    def write(self, record: Record, day: str) -> BlockReference:
        """Write a block and return only when the file and its folder entry are on disk.

        Raises StorageUnavailable when the disk is full or cannot be written.
        """
        parts = list(_parts(record))
        name = f"{uuid.uuid4().hex}.block"
        try:
            folder = self._day_folder(day)
            # Unbuffered: fsync takes to the disk only what has left the process.
            with open(folder / name, "xb", buffering=0) as file:
                digest = _write_all(file.fileno(), parts)
                # The file's bytes, then its name in the folder: a file whose entry is not on disk
                # is gone after a power cut, whatever it holds.
                os.fsync(file.fileno())
            sync_folder(folder)
        except OSError as error:
            # A block that was written half-way would be swept only later, and takes room until
            # then.
            self.discard(f"{day}/{name}")
            raise _unavailable(error) from error
        return BlockReference(f"{day}/{name}", digest, sum(map(len, parts)))

    def read(
        self, path: str, channels: Sequence[str] | None = None, checksum: str | None = None
    ) -> Record:
        """The record of a block, or some of its channels, verified by the checksums of its header
        and of the channels.

        `checksum` is that of the whole file, by which a block is verified whose header has none of
        its own.
        """
        with _broken(path):
            header, start, wanted = self._described(path, channels, checksum)
            arrays = {
                entry["name"]: _array(self.folder / path, entry, start, header["n"])
                for entry in wanted
            }
            units = {entry["name"]: entry["unit"] for entry in wanted}
        return Record(
            arrays,
            units,
            header["sample_time"],
            header["t0"],
            notes=tuple(header["notes"]),
            source=str(header["source"]),
        )

    def in_pieces(
        self, path: str, channels: Sequence[str] | None = None, checksum: str | None = None
    ) -> ReadInPieces:
        """As `read`, piece by piece: a channel is verified when its last piece was taken, and
        BrokenBlock comes then.
        """
        with _broken(path):
            header, start, wanted = self._described(path, channels, checksum)
            known = {entry["name"]: entry for entry in wanted}

        def pieces(name: str) -> Iterator[np.ndarray[Any, Any]]:
            with _broken(path):
                yield from _pieces(self.folder / path, known[name], start, header["n"])

        return ReadInPieces(
            header["sample_time"],
            header["t0"],
            header["n"],
            {name: entry["unit"] for name, entry in known.items()},
            header["notes"],
            {name: entry["dtype"] for name, entry in known.items()},
            pieces,
        )

    def _described(
        self, path: str, channels: Sequence[str] | None, checksum: str | None
    ) -> tuple[dict[str, Any], int, list[dict[str, Any]]]:
        """(header, where the samples start, what the header says of the channels that are asked
        for).
        """
        file = self.folder / path
        # An old header can be believed only when the whole file is: it says where channels begin.
        if checksum is not None and _begins_with(file, _WITHOUT_CHECKSUM):
            self.verify(BlockReference(path, checksum, 0))
        header, start = _header(file)
        return (
            header,
            start,
            header["channels"] if channels is None else [_entry(header, name) for name in channels],
        )

    def verify(self, reference: BlockReference) -> None:
        """Raise BrokenBlock when the file differs from what was written."""
        try:
            with open(self.folder / reference.path, "rb") as file:
                checksum = hashlib.file_digest(file, "sha256").hexdigest()
        except OSError as error:
            raise BrokenBlock(f"signal block {reference.path}: {error.strerror}") from error
        if checksum != reference.checksum:
            raise BrokenBlock(f"signal block {reference.path}: content differs from its checksum")

    def remove(self, path: str) -> None:
        """Remove a block that no row points to."""
        (self.folder / path).unlink(missing_ok=True)

    def discard(self, path: str) -> None:
        """Remove a block that will get no row; one that cannot be removed now (a read-only disk) is
        left to a sweep.
        """
        with suppress(OSError):
            self.remove(path)

    def probe(self) -> None:
        """Raise StorageUnavailable when there is no room for a small block, or none can be
        written.
        """
        file = self.folder / f"{uuid.uuid4().hex}.probe"
        try:
            with open(file, "xb", buffering=0) as opened:
                _write_all(opened.fileno(), [bytes(_PROBE)])
        except OSError as error:
            raise _unavailable(error) from error
        finally:
            with suppress(OSError):
                file.unlink()

    def paths(self, settled: float = 0.0) -> list[str]:
        """All blocks there are that were written at least `settled` seconds ago."""
        latest = time.time() - settled
        return sorted(
            str(file.relative_to(self.folder))
            for file in self.folder.glob("*/*.block")
            if _written(file) <= latest
        )

    def _day_folder(self, day: str) -> Path:
        folder = self.folder / day
        make_folder(folder)
        return folder


def _unavailable(error: OSError) -> StorageUnavailable:
    return StorageUnavailable(f"signal block: {error.strerror}", full=error.errno in _FULL)


def _written(file: Path) -> float:
    """When a file was last written [s]; never, when it has gone meanwhile."""
    try:
        return file.stat().st_mtime
    except FileNotFoundError:
        return math.inf


def _parts(record: Record) -> list[bytes | memoryview]:
    """Header and padded sample arrays, in file order."""
    entries: list[dict[str, Any]] = []
    bodies: list[bytes | memoryview] = []
    offset = 0
    for name, signal in record.channels.items():
        # Little endian whatever the machine: a backup may be restored on another one.
        little = np.ascontiguousarray(signal, dtype=signal.dtype.newbyteorder("<"))
        body = little.view(np.uint8).data
        entries.append(
            {
                "name": name,
                "unit": record.units[name],
                "dtype": little.dtype.str,
                "offset": offset,
                "crc32": zlib.crc32(body),
            }
        )
        # Aligned, so that a channel can be taken as an array where it lies.
        padding = -len(body) % _ALIGNMENT
        bodies += [body, bytes(padding)]
        offset += len(body) + padding
    described = {
        "sample_time": record.sample_time,
        "t0": record.t0,
        "n": record.n,
        "notes": list(record.notes),
        "source": record.source,
        "channels": entries,
    }
    # The header has a checksum of its own: a bit that flipped in it would name other units or other
    # places of samples, which no channel's checksum sees.
    header = orjson.dumps(described)
    header += b" " * (-(_BEGIN + _CRC + len(header)) % _ALIGNMENT)
    begin = MAGIC + len(header).to_bytes(8, "little")
    return [begin, zlib.crc32(begin + header).to_bytes(_CRC, "little"), header, *bodies]


def _write_all(descriptor: int, parts: Sequence[bytes | memoryview]) -> str:
    digest = hashlib.sha256()
    for part in parts:
        digest.update(part)
        unwritten = memoryview(part)
        # A write of the system may take a part only, as on a disk that becomes full.
        while unwritten:
            unwritten = unwritten[os.write(descriptor, unwritten) :]
    return digest.hexdigest()


def _header(file: Path) -> tuple[dict[str, Any], int]:
    """(header, where the samples start)."""
    with open(file, "rb") as stream:
        begin = stream.read(_BEGIN)
        if begin[: len(MAGIC)] not in (MAGIC, _WITHOUT_CHECKSUM):
            raise ValueError("is not a signal block")
        # A flipped bit in the length must not ask for more memory than the file has bytes.
        length = min(
            int.from_bytes(begin[len(MAGIC) :], "little"), os.fstat(stream.fileno()).st_size
        )
        if begin[: len(MAGIC)] == _WITHOUT_CHECKSUM:
            return orjson.loads(stream.read(length)), _BEGIN + length
        crc, header = stream.read(_CRC), stream.read(length)
        if zlib.crc32(begin + header).to_bytes(_CRC, "little") != crc:
            raise ValueError("its header differs from its checksum")
        return orjson.loads(header), _BEGIN + _CRC + length


def _begins_with(file: Path, magic: bytes) -> bool:
    with open(file, "rb") as stream:
        return stream.read(len(magic)) == magic


def _entry(header: dict[str, Any], name: str) -> dict[str, Any]:
    for entry in header["channels"]:
        if entry["name"] == name:
            channel: dict[str, Any] = entry
            return channel
    raise KeyError(f"no channel {name!r}")


@contextmanager
def _broken(path: str) -> Iterator[None]:
    """What cannot be read as the block it should be, as BrokenBlock."""
    try:
        yield
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise BrokenBlock(f"signal block {path}: {error}") from error


def _pieces(
    file: Path, entry: dict[str, Any], start: int, n: int
) -> Iterator[np.ndarray[Any, Any]]:
    dtype, crc, left = np.dtype(entry["dtype"]), 0, n
    with open(file, "rb") as stream:
        stream.seek(start + entry["offset"])
        while left > 0:
            content = stream.read(min(left, _PIECE // dtype.itemsize) * dtype.itemsize)
            crc = zlib.crc32(content, crc)
            # A file that was cut short may end within a sample; the checksum then tells it.
            piece = np.frombuffer(content[: len(content) // dtype.itemsize * dtype.itemsize], dtype)
            if not len(piece):
                break
            left -= len(piece)
            yield piece
    if left or crc != entry["crc32"]:
        raise ValueError(f"channel {entry['name']!r} differs from its checksum")


def _array(file: Path, entry: dict[str, Any], start: int, n: int) -> np.ndarray[Any, Any]:
    array = np.fromfile(
        file, dtype=np.dtype(entry["dtype"]), count=n, offset=start + entry["offset"]
    )
    if array.shape[0] != n or zlib.crc32(array.view(np.uint8).data) != entry["crc32"]:
        raise ValueError(f"channel {entry['name']!r} differs from its checksum")
    return array
