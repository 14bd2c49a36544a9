"""What joins by what it takes away on unseen blocks of all records."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

import residuum as rs
from residuum.identification.discrepancy.improve_on_blocks import joined_on_blocks
from residuum.identification.discrepancy.search import untold

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
    return rs.from_arrays({"voltage": voltage, "speed": speed, "current": current}, sample_time=0.01, units=units)


@pytest.mark.parametrize("seed", [2, 5])
def test_an_effect_that_does_nothing_does_not_join(fan, seed):
    turning = fan(seed)
    for _ in range(300):
        turning.step()
    model, records = rs.model(RIG / "fan.yaml").physical, [window(turning), window(turning)]
    ids = ["quadratic-drag", "backlash", "output-saturation"]
    joined = joined_on_blocks(model, records, None, ids, learned=False, seconds=None, tell=untold)
    assert joined.added == ["quadratic-drag"] and joined.errors[1] < 0.1 * joined.errors[0]
