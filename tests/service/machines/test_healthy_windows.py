"""Overlapping windows are joined to the record they were cut from; strangers are not."""

import numpy as np

from residuum.identification.record import Record
from residuum.service.machines.baselines import joined, parted

LIFE = Record(
    {"u": np.arange(1000.0), "y": np.sin(np.arange(1000.0))}, {"u": "V", "y": "m"}, 0.1, t0=50.0
)


def windows(begin, end, step=25, length=100):
    return [LIFE.window(k, k + length) for k in range(begin, end - length + 1, step)]


def test_sliding_windows_give_their_record_back():
    (record,) = joined(windows(100, 600))
    np.testing.assert_array_equal(record["u"], LIFE["u"][100:600])
    np.testing.assert_array_equal(record["y"], LIFE["y"][100:600])
    assert record.t0 == LIFE.t0 + 10.0


def test_a_gap_or_another_clock_begins_a_new_record():
    records = joined([*windows(0, 200), *windows(400, 600)])
    assert [record.n for record in records] == [200, 200]
    stranger = Record(
        {"u": np.zeros(100), "y": np.ones(100)}, {"u": "V", "y": "m"}, 0.1, t0=LIFE.t0 + 5.0
    )
    assert len(joined([LIFE.window(0, 100), stranger])) == 2


def test_windows_to_check_with_were_not_learned_from():
    learned, checked = parted(windows(0, 1000))
    assert sum(record.n for record in learned) + 100 * len(checked) > 900 and len(checked) >= 2
    assert all(window["u"][0] > learned[-1]["u"][-1] for window in checked)
