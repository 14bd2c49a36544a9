"""Every listed format gives a record back, and refuses damaged files with one kind of error."""

import gc

import numpy as np
import pytest

from residuum.identification.errors import BadRecord
from residuum.identification.record import Record
from residuum.identification.record_formats import (
    READERS,
    WRITERS,
    ReadOptions,
    read_record,
    write_record,
)

EXACT = {".npz", ".mat", ".parquet", ".tdms", ".mf4"}
KEEPS_UNITS = {".csv", ".npz", ".mat", ".parquet", ".tdms", ".mf4", ".uff"}


def a_record():
    rng = np.random.default_rng(7)
    return Record(
        {"voltage": rng.normal(size=300), "speed": rng.normal(size=300)},
        {"voltage": "V", "speed": "rad/s"},
        1 / 500,
    )


def test_readers_and_writers_are_listed_in_pairs():
    assert list(READERS) == list(WRITERS)


@pytest.mark.parametrize("ending", READERS)
def test_round_trip(tmp_path, ending):
    record = a_record()
    write_record(record, tmp_path / f"r{ending}")
    back = read_record(tmp_path / f"r{ending}")
    assert back.sample_time == pytest.approx(record.sample_time, rel=1e-9)
    assert back.n == record.n and len(back.names) == 2
    if ending in KEEPS_UNITS:
        assert dict(back.units) == dict(record.units)
    for found, true in zip(back.channels.values(), record.channels.values(), strict=True):
        np.testing.assert_allclose(found, true, rtol=0 if ending in EXACT else 1e-6, atol=1e-9)


# asammdf's own destructor, on half-read files
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.parametrize("ending", READERS)
@pytest.mark.parametrize("damage", ["empty", "text", "cut", "flipped"])
def test_damaged_files_are_refused(tmp_path, ending, damage):
    path = tmp_path / f"r{ending}"
    write_record(a_record(), path)
    content = path.read_bytes()
    flipped = (
        bytes(byte ^ 0x5A for byte in content[: len(content) // 3]) + content[len(content) // 3 :]
    )
    path.write_bytes(
        {
            "empty": b"",
            "text": b"what is this\n" * 20,
            "cut": content[: len(content) // 3],
            "flipped": flipped,
        }[damage]
    )
    # a shorter file may still be a valid one
    if (ending, damage) in {(".csv", "cut"), (".tdms", "cut"), (".wav", "cut")}:
        return
    with pytest.raises(BadRecord) as refused:
        read_record(path)
    assert "\n" not in str(refused.value)
    del refused
    gc.collect()


def test_a_file_that_does_not_say_its_sample_time_must_be_told(tmp_path):
    np.savez(tmp_path / "r.npz", vibration=np.zeros(8))
    with pytest.raises(BadRecord, match="does not say its sample time"):
        read_record(tmp_path / "r.npz")
    record = read_record(
        tmp_path / "r.npz", ReadOptions(sample_time=1 / 12000, units={"vibration": "g"})
    )
    assert record.sampling_rate == pytest.approx(12000) and record.units["vibration"] == "g"


def test_a_given_sample_time_that_contradicts_the_file_is_refused(tmp_path):
    write_record(a_record(), tmp_path / "r.csv")
    with pytest.raises(BadRecord, match=r"has sample time 0.002 s, but 0.003 s was given"):
        read_record(tmp_path / "r.csv", ReadOptions(sample_time=0.003))


@pytest.mark.parametrize("name", ["nothing.csv", "r.xyz"])
def test_absent_and_unknown_files_are_refused(tmp_path, name):
    with pytest.raises(BadRecord, match=r"no such file|not a record format"):
        read_record(tmp_path / name)
