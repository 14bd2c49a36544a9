import numpy as np
import pytest

from residuum.service.fieldbus.sequence import BREAK, SequenceCounter


def disturbed(n, rng, each=0.02):
    """Numbers 0 … n−1 as they arrive on a bus that drops, repeats and delays frames."""
    delayed = rng.random(n) < each
    order = np.argsort(
        np.arange(n) + np.where(delayed, rng.integers(1, 8, n) + 0.5, 0), kind="stable"
    )
    arriving = np.repeat(order, np.where(rng.random(n) < each, 2, 1))
    inner = (arriving > 20) & (arriving < n - 20)
    dropped = rng.choice(np.arange(21, n - 20), int(each * n), replace=False)
    return arriving[~(np.isin(arriving, dropped) & inner)], len(dropped)


def repetitions_and_late_frames(arriving):
    seen, highest, repeated, late = set(), -1, 0, 0
    for number in arriving.tolist():
        repeated += number in seen
        late += number not in seen and number < highest
        seen.add(number)
        highest = max(highest, number)
    return repeated, late


@pytest.mark.parametrize("bits", [10, 14, 16])
@pytest.mark.parametrize("start", [0, 1000])
def test_every_drop_repetition_and_late_frame_is_counted_and_every_number_is_right(bits, start):
    rng = np.random.default_rng(bits)
    arriving, dropped = disturbed(20_000, rng)
    repeated, delayed = repetitions_and_late_frames(arriving)
    assert min(dropped, repeated, delayed) > 200
    counter = SequenceCounter(bits)
    numbers, keep, lost, duplicated, reordered, jumps = [], [], 0, 0, 0, 0
    at = 0
    while at < len(arriving):
        size = int(rng.integers(1, 200))
        placed = counter.place((arriving[at : at + size] + start) % (1 << bits))
        numbers += placed.number.tolist()
        keep += placed.keep.tolist()
        lost, duplicated = lost + placed.lost, duplicated + placed.duplicated
        reordered, jumps = reordered + placed.reordered, jumps + placed.jumps
        at += size
    assert (lost, duplicated, reordered, jumps) == (dropped, repeated, delayed, 0)
    assert np.array_equal(np.array(numbers) - numbers[0], arriving - arriving[0])
    kept = np.array(numbers)[np.array(keep)]
    assert len(np.unique(kept)) == len(kept) == 20_000 - dropped


def test_ten_bits_wrap_without_a_loss():
    counter = SequenceCounter(10)
    numbers = np.concatenate(
        [counter.place(np.arange(k, k + 100) % 1024).number for k in range(0, 5000, 100)]
    )
    assert np.array_equal(numbers, np.arange(5000))


def test_a_restarted_sender_begins_far_away():
    counter = SequenceCounter(10)
    counter.place(np.arange(600))
    placed = counter.place(np.arange(5))
    assert placed.jumps == 1 and placed.lost == 0
    assert placed.number[0] >= BREAK and np.array_equal(np.diff(placed.number), np.ones(4))


def test_a_silence_in_which_the_counter_wrapped_is_counted_by_its_length():
    counter = SequenceCounter(10)
    counter.place(np.arange(100))
    placed = counter.place(np.array([(100 + 5000) % 1024]), silence=1.004, rate=5000.0)
    assert placed.lost == 5000 and placed.number[0] == 5100


def test_a_sender_that_paused_and_goes_on_lost_nothing():
    counter = SequenceCounter(10)
    counter.place(np.arange(100))
    assert counter.place(np.arange(100, 200), silence=30.0, rate=5000.0).lost == 0


def test_a_stall_of_the_reader_alone_is_no_loss():
    counter = SequenceCounter(10)
    counter.place(np.arange(100))
    assert counter.place(np.arange(100, 200), silence=0.0, rate=5000.0).lost == 0


def test_the_width_is_checked():
    with pytest.raises(ValueError, match="bits"):
        SequenceCounter(2)
