"""Long recordings judged in blocks: a verdict as that of the blocks, whatever the length."""

import numpy as np
import pytest

from residuum.diagnosis.diagnosers.bearing import Bearing
from residuum.diagnosis.finding import Verdict
from residuum.diagnosis.vibration.moving_lines import faulty_bearing
from residuum.diagnosis.vibration.vibration_indicators import LONGEST, blocks_of, score_in_blocks
from residuum.identification.record import Record

ORDERS = {"bpfi": 5.4152, "bpfo": 3.5848, "bsf": 2.357, "ftf": 0.398}
RATE, BLOCK, BLOCKS = 12000, 24000, 6
JUDGE = Bearing(orders=ORDERS, speed_rpm=1800)


def recording(faults):
    parts = [
        faulty_bearing(BLOCK, RATE, 30.0, ORDERS, fault, seed=seed)
        for seed, fault in enumerate(faults)
    ]
    return Record({"a": np.concatenate(parts).astype(np.float32)}, {"a": "g"}, 1 / RATE, t0=100.0)


def judged(record):
    return score_in_blocks("bearing", JUDGE.score, record, BLOCK)


def test_a_fault_that_begins_during_the_recording_is_named_and_dated():
    found = judged(recording([None, None, None, None, "bpfo", "bpfo"]))
    assert (found.verdict, found.fault_class) == (Verdict.FAULTY, "outer-race")
    assert found.evidence["blocks"] == BLOCKS and found.evidence[
        "first_faulty_block_s"
    ] == pytest.approx(4 * BLOCK / RATE)
    assert "2 of 6 blocks" in found.reason and found.indicators["severity"] > 1


def test_one_block_alone_is_no_fault_and_health_stays_health():
    trained = Bearing(orders=ORDERS, speed_rpm=1800).fit([recording([None] * BLOCKS)])
    for faults in ([None] * BLOCKS, [None, "bpfi", None, None, None, None]):
        assert (
            score_in_blocks("bearing", trained.score, recording(faults), BLOCK).verdict
            is Verdict.HEALTHY
        )


def test_a_gap_is_never_healthy_and_a_fault_beside_it_still_counts():
    trained = Bearing(orders=ORDERS, speed_rpm=1800).fit([recording([None] * BLOCKS)])
    for fault, expected in ((None, Verdict.NOT_ASSESSABLE), ("bpfi", Verdict.FAULTY)):
        record = recording([fault] * BLOCKS)
        x = record["a"].copy()
        x[3 * BLOCK + 5] = np.nan
        found = score_in_blocks(
            "bearing", trained.score, Record({"a": x}, {"a": "g"}, 1 / RATE), BLOCK
        )
        assert found.verdict is expected and ("block 4 of 6" in found.reason) is (fault is None)


def test_blocks_cover_the_record_without_copying_it():
    record = Record({"a": np.arange(100.0)}, {"a": "g"}, 0.1)
    blocks = list(blocks_of(record, 30))
    assert np.concatenate([block["a"] for block in blocks]).tolist() == record["a"].tolist()
    assert all(block.n <= 30 and np.shares_memory(block["a"], record["a"]) for block in blocks)


def test_a_record_beyond_the_longest_is_cut_by_the_diagnoser_itself():
    x = np.tile(
        faulty_bearing(BLOCK, RATE, 30.0, ORDERS, None, seed=1).astype(np.float32),
        LONGEST // BLOCK + 1,
    )
    finding = JUDGE.score(Record({"a": x}, {"a": "g"}, 1 / RATE))
    assert finding.evidence["blocks"] == 2 and all(np.isfinite(list(finding.indicators.values())))
    # it has no baseline
    assert finding.within_absolute_limits and finding.evidence["faulty_blocks"] == 0
