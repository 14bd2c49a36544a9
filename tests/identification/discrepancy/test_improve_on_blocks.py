"""What joins by what it takes away on unseen blocks of all records."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

import residuum as rs
from residuum.identification.discrepancy.improve import joined_of
from residuum.identification.unseen_blocks.record_search import searched
from residuum.identification.unseen_blocks.tried import Wanted

RIG = Path(__file__).parents[3] / "docs" / "tutorials" / "fan_rig"


@pytest.fixture(scope="module")
def fan():
    """The tutorial's fan, which has a drag and a little friction, and no play."""
    found = importlib.util.spec_from_file_location("fan_rig", RIG / "fan_rig.py")
    module = importlib.util.module_from_spec(found)
    found.loader.exec_module(module)
    return module.Fan


def window(fan):
    voltage, current, speed, _ = np.array([fan.step() for _ in range(500)]).T
    units = {"voltage": "V", "speed": "rpm", "current": "A"}
    return rs.from_arrays(
        {"voltage": voltage, "speed": speed, "current": current}, sample_time=0.01, units=units
    )


@pytest.mark.parametrize("seed", [2, 5])
def test_an_effect_that_does_nothing_does_not_join(fan, seed):
    turning = fan(seed)
    for _ in range(300):
        turning.step()
    model, records = rs.model(RIG / "fan.yaml").physical, [window(turning), window(turning)]
    found = searched(
        model, records, None, Wanted(("quadratic-drag", "backlash", "output-saturation"))
    )
    joined = joined_of(found, records, None)
    first, drag = joined.history
    assert (first.added, drag.added) == (None, "quadratic-drag") and drag.error < 0.1 * first.error
    assert first.remaining.share == pytest.approx(1.0) and drag.remaining.share < 0.05
