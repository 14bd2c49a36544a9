"""What joins by its share: only effects that still take something away once everything is estimated again."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

import residuum as rs
from residuum.identification.discrepancy.block_cutting import blocks_of
from residuum.identification.discrepancy.improve_by_share import joined_by_share, without_idle
from residuum.identification.physics import match

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
def test_an_effect_that_does_nothing_once_all_is_estimated_does_not_join(fan, seed):
    turning = fan(seed)
    for _ in range(300):
        turning.step()
    model, experiments = match(rs.model(RIG / "fan.yaml").physical, [window(turning), window(turning)])
    joined = joined_by_share(model, experiments, ["quadratic-drag", "backlash"])
    assert joined.added == ["quadratic-drag"] and joined.errors[1] < 0.1 * joined.errors[0]


def test_an_effect_that_does_nothing_beside_a_later_one_leaves_the_model(fan):
    """A limit that nothing reaches, and then the drag: judged by the last step alone the limit would stay."""
    turning = fan(2)
    for _ in range(300):
        turning.step()
    model, experiments = match(rs.model(RIG / "fan.yaml").physical, [window(turning), window(turning)])
    blocks = blocks_of(model, experiments)
    idle = blocks.base.model.with_effect("output-saturation", "speed", {"y_max": 1e4})
    models, errors = without_idle([idle, idle.with_effect("quadratic-drag", "shaft", {"c": 2e-5})], blocks)
    assert [use.id for use in models[-1].effects] == ["quadratic-drag"]
    assert len(models) == len(errors) == 2 and errors[1].rms[0] < 0.1 * errors[0].rms[0]
