"""A byte that changed in a block's header or samples is told at each read; none is answered with other values."""

import json
import tarfile
from pathlib import Path

import numpy as np
import pytest

from residuum.diagnosis.finding import Finding
from residuum.identification.record import Record
from residuum.service.storage import DiskStore
from residuum.service.storage.blocks import Blocks, BrokenBlock

LEFT = Path(__file__).parents[2] / "recorded" / "data-folder-0.1.0.tar.gz"


def same(one, other):
    known = ("sample_time", "t0", "source", "notes", "units")
    return all(getattr(one, name) == getattr(other, name) for name in known) and all(
        np.array_equal(one[name], other[name], equal_nan=True) for name in one.names
    )


@pytest.mark.parametrize("flip", [0x01, 0x10, 0x80, 0xFF])
def test_every_changed_byte_is_told_or_harmless(tmp_path, flip):
    blocks = Blocks(tmp_path)
    record = Record(
        {"y": np.arange(5.0), "u": np.ones(5)},
        {"y": "m/s²", "u": "V"},
        1e-3,
        t0=0.5,
        notes=("a note",),
        source="bus",
    )
    written = blocks.write(record, "2026-01-01")
    file = tmp_path / written.path
    whole = file.read_bytes()
    told = 0
    for place in range(len(whole)):
        file.write_bytes(whole[:place] + bytes([whole[place] ^ flip]) + whole[place + 1 :])
        try:
            assert same(blocks.read(written.path), record), place
        except BrokenBlock:
            told += 1
            with pytest.raises(BrokenBlock):
                in_pieces = blocks.in_pieces(written.path)
                [list(in_pieces.pieces(name)) for name in in_pieces.units]
    padding = 2 * (64 - 5 * 8)  # after either channel: nobody reads it
    assert told == len(whole) - padding


def test_a_block_of_before_headers_had_checksums_is_read_and_compared_as_a_whole(tmp_path):
    with tarfile.open(LEFT) as archive:
        archive.extractall(tmp_path, filter="data")
    store = DiskStore(tmp_path / "data", f"sqlite:///{tmp_path / 'data' / 'residuum.db'}")
    window = store.windows("press").items[0]
    assert store.window_record("press", window.id).n == window.n
    for file in (tmp_path / "data").glob("blocks/*/*.block"):
        content = file.read_bytes()
        length = int.from_bytes(content[17:25], "little")
        header = json.loads(content[25 : 25 + length])
        other = json.dumps(header | {"t0": header["t0"] + 1.0}, separators=(",", ":")).encode()
        file.write_bytes(content[:25] + other.ljust(length)[:length] + content[25 + length :])
    with pytest.raises(BrokenBlock, match="differs from its checksum"):
        store.window_record("press", window.id)
    new = store.add_window(
        "press",
        Record({"y": [1.0, 2.0]}, {"y": "m/s²"}, 1e-3),
        Finding("bearing", "healthy", reason="-"),
    )
    assert store.window_record("press", new).n == 2
    store.close()
