"""One late read leaves a hole in one window: a model is then held against others."""

import numpy as np
import pytest

from residuum.identification.record import Record
from residuum.service.machines.baselines import training_windows
from residuum.service.machines.windows import complete_windows, used_by
from residuum.service.store import Conflict

CHANNELS = {"voltage": "U", "speed": "n"}
USED = ("voltage", "speed")


def window(*, without=None):
    samples = {name: np.arange(1.0, 21.0) for name in ("U", "n", "T")}
    if without:
        samples[without][7] = np.nan
    return Record(samples, {"U": "V", "n": "rpm", "T": "degC"}, 0.1)


class Kept:
    """A store's windows alone."""

    def __init__(self, *windows):
        self.windows = dict(enumerate(windows, start=1))

    def window_record(self, _asset, number):
        return self.windows[number]

    def recorded_windows(self, _asset, _most):
        return list(self.windows)


def test_the_newest_without_a_hole_are_taken_by_the_models_names():
    store = Kept(window(), window(), window(without="U"), window(without="T"), window(without="n"))
    found = complete_windows(store, "mixer", [1, 2, 3, 4, 5], CHANNELS, USED, 2)
    assert list(found) == [2, 4]  # nothing in use is lacking where the temperature is
    assert found[4].names == ("voltage", "speed", "T")


def test_where_each_has_a_hole_it_is_said_how_to_go_on():
    store = Kept(window(without="U"), window(without="n"))
    with pytest.raises(
        Conflict, match=r"mixer.*none of 2 windows is complete.*seconds between two reads"
    ):
        complete_windows(store, "mixer", [1, 2], CHANNELS, USED, 2)


def test_training_passes_a_window_with_a_hole_over_and_says_how_many():
    store = Kept(*[window()] * 6, window(without="U"), window(without="T"))
    found, holes = training_windows(store, "mixer", [1], judged=False, channels=CHANNELS, used=USED)
    assert (len(found), holes) == (6, 1)
    with pytest.raises(
        Conflict,
        match=r"4 windows are recorded; at least 5 are needed.*1 more have holes.*seconds between two reads",
    ):
        training_windows(store, "mixer", [1, 2, 3], judged=False, channels=CHANNELS, used=USED)


def test_signals_that_no_model_uses_may_have_holes():
    store = Kept(window(), window(without="T"))
    assert list(complete_windows(store, "mixer", [1, 2], {}, used_by(None), 1)) == [2]
    assert set(used_by(("gate-drive", None))) == {"voltage", "speed", "current"}
