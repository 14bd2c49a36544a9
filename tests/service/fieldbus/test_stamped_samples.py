"""Values with stamps become samples in their places; a clock that was set begins a stream anew."""

import numpy as np
import pytest

from residuum.service.fieldbus.health import SourceHealth
from residuum.service.fieldbus.sequence import BREAK
from residuum.service.fieldbus.source import StreamFormat
from residuum.service.fieldbus.stamped_samples import StampedSamples

STEP = 0.1


@pytest.fixture
def samples():
    return StampedSamples(StreamFormat("s", STEP, {"u": "V", "y": "m"}), SourceHealth())


def feed(samples, numbers, *, shift=0.0, names=("u", "y"), delay=0.0):
    for k in numbers:
        for name in names:
            samples.add(name, 1e9 + STEP * k + shift, float(k), now=STEP * k + delay)


def counted(samples):
    return {name: n for name, n in samples._health.snapshot()["counters"].items() if n}


def test_values_stand_at_their_stamps_and_what_never_came_is_counted(samples):
    feed(samples, [0, 1, 2, 5, 6])
    block = samples.take(now=0.7)
    assert block.number.tolist() == [0, 1, 2, 5, 6] and block.channels["u"].tolist() == [
        0,
        1,
        2,
        5,
        6,
    ]
    assert counted(samples) == {"lost": 2}


def test_half_a_sample_waits_and_is_then_given_with_a_hole(samples):
    feed(samples, [0])
    feed(samples, [1], names=["u"])
    assert samples.take(now=0.2).number.tolist() == [0]
    feed(samples, range(2, 20))
    block = samples.take(now=2.0)
    assert block.number[0] == 1 and block.channels["u"][0] == 1 and np.isnan(block.channels["y"][0])


@pytest.mark.parametrize("shift", [-3600.0, -0.35, 3600.0])
def test_a_clock_that_is_set_begins_the_stream_anew(samples, shift):
    feed(samples, range(10))
    assert samples.take(now=1.0).n == 10
    feed(samples, range(10, 12), shift=shift, names=["u"])
    feed(samples, range(10, 12), names=["y"])  # still on its way when the clock was set
    feed(samples, range(12, 40), shift=shift)
    block = samples.take(now=4.0)
    assert counted(samples)["counter_jumps"] == 1
    assert block.number[0] == BREAK and len(set(block.number - block.channels["u"])) == 1
    assert np.array_equal(block.channels["u"], block.channels["y"])


def test_a_reader_that_was_late_catches_up(samples):
    feed(samples, range(10))
    feed(samples, range(10, 60), delay=4.0)
    feed(samples, range(60, 80))
    numbers = samples.take(now=8.0).number
    assert numbers.tolist() == list(range(80)) and not counted(samples)


def test_a_clock_set_back_while_nobody_was_connected_is_seen(samples):
    feed(samples, range(10))
    samples.take(now=1.0)
    samples.reopened()
    feed(samples, range(200, 230), shift=-10.0)
    assert counted(samples)["counter_jumps"] == 1
    assert samples.take(now=23.0).number[0] == BREAK


def test_values_faster_than_the_map_and_repetitions_are_dropped_and_counted(samples):
    feed(samples, range(3))
    samples.add("u", 1e9 + 2.3 * STEP, 99.0, now=0.3)
    samples.add("u", 1e9 + 2.3 * STEP, 99.0, now=0.3)
    assert samples.take(now=0.5).channels["u"].tolist() == [0, 1, 2]
    assert counted(samples) == {"surplus": 1, "duplicated": 1}


def test_of_too_many_open_samples_the_oldest_are_lost(samples, monkeypatch):
    monkeypatch.setattr("residuum.service.fieldbus.stamped_samples._MOST_OPEN", 5)
    feed(samples, [3], names=["u"])
    feed(samples, [0, 1], names=["y"])
    feed(samples, [4, 5, 6], names=["u"])
    assert counted(samples) == {"lost": 1}
    feed(samples, [3, 4, 5, 6, 18], names=["y"])
    assert [number + 3 for number in samples.take(now=2.0).number] == [3, 4, 5, 6] and counted(
        samples
    ) == {"lost": 2}


def drawn_changes(seed, n=300):
    """What two fast channels and two that report by change are told, and what each sample then holds."""
    rng = np.random.default_rng(seed)
    slow = {"y": np.repeat(rng.integers(0, 5, n // 20 + 1), 20)[:n].astype(float), "z": np.zeros(n)}
    slow["z"][rng.integers(30, 90) :] = 7.0
    bad = slice(int(rng.integers(120, 150)), int(rng.integers(160, 200)))
    slow["z"][bad] = np.nan  # a bad status, reported once, and once that it is good again
    told = []
    for k in range(n):
        told += [("u", k, float(k))]
        for name, values in slow.items():
            before = values[k - 1] if k else None
            if k == 0 or not (values[k] == before or (np.isnan(values[k]) and np.isnan(before))):
                # the first was written long ago
                told.append((name, -400 if k == 0 else k, values[k]))
    return told, slow, n


@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize("said", [None, True])
def test_what_is_reported_by_change_holds_until_the_next_report(seed, said):
    told, slow, n = drawn_changes(seed)
    held = {"u": None, "y": said, "z": said}
    samples = StampedSamples(
        StreamFormat("s", STEP, {"u": "V", "y": "", "z": ""}), SourceHealth(), held=held
    )
    found = {name: [] for name in held}
    now = 0.0
    for name, k, value in told:
        now = max(now, STEP * k)
        samples.add(name, 1e9 + STEP * k, value, now=now)
        if name == "u" and (block := samples.take(now)) is not None:
            for channel, values in block.channels.items():
                found[channel] += values.tolist()
    first = int(found["u"][0])
    assert first <= 4 and len(found["u"]) > n - 15
    assert counted(samples) == {}
    for name, values in slow.items():
        np.testing.assert_array_equal(found[name], values[first : first + len(found[name])])


def test_a_channel_that_reports_each_sample_is_not_held_where_one_is_lost():
    samples = StampedSamples(
        StreamFormat("s", STEP, {"u": "V", "y": "m"}), SourceHealth(), held={"u": None, "y": None}
    )
    feed(samples, range(20))
    feed(samples, [20], names=["u"])
    feed(samples, range(21, 60))
    blocks = [samples.take(now=2.0), samples.take(now=9.0)]
    y = np.concatenate([block.channels["y"] for block in blocks if block is not None])
    assert np.isnan(y).sum() == 1
