"""The heat map by phase and direction finds where an error was put."""

import numpy as np
import pytest

from residuum.diagnosis.residuals.movement_phases import phase_cells
from residuum.identification.residual_analysis.locate import Axis

DT = 0.01


def trapezoids():
    """Forward and back: 1 s at rest, 2 s speeding up to 3 m/s, 3 s steady, 2 s slowing down, 1 s at rest; then the mirror."""
    way = np.interp(np.arange(0, 9, DT), [0, 1, 3, 6, 8, 9], [0, 0, 3, 3, 0, 0])
    return np.concatenate([way, -way])


def axes(values, kind="velocity"):
    return [Axis("force", "N", "input", np.zeros(len(values))), Axis("speed", "m/s", kind, values)]


def test_an_error_while_slowing_down_backwards_is_in_that_cell_alone():
    v = trapezoids()
    error = np.zeros(len(v))
    begin = 900 + 610  # backward, 0.1 s after slowing down begins
    error[begin : begin + 150] = 2.0
    error[begin + 70] = 5.0
    found = phase_cells([axes(v)], [DT], [error])
    cells = {(cell["phase"], cell["direction"]): cell for cell in found["cells"]}
    worst = cells["slowing down", "backward"]
    assert worst["share"] > 0.99 and (worst["record"], worst["time"]) == (
        0,
        pytest.approx((begin + 70) * DT),
    )
    assert cells["steady", "forward"]["rms"] == 0 and cells["steady", "forward"][
        "time_share"
    ] == pytest.approx(1 / 6, abs=0.02)
    assert sum(cell["time_share"] for cell in found["cells"]) == pytest.approx(1)
    assert found["axis"] == "speed"


def test_records_are_kept_apart_and_missing_samples_left_out():
    v = trapezoids()
    quiet, loud = np.full(len(v), 0.1), np.full(len(v), 0.1)
    loud[400] = 9.0
    quiet[:50] = np.nan
    found = phase_cells([axes(v), axes(v)], [DT, DT], [quiet, loud])
    steady = next(
        cell
        for cell in found["cells"]
        if (cell["phase"], cell["direction"]) == ("steady", "forward")
    )
    assert (steady["record"], steady["time"]) == (1, pytest.approx(4.0))


def test_a_temperature_is_split_by_height_and_by_rise_and_fall():
    t = np.arange(0, 300, 1.0)
    warm = np.interp(t, [0, 100, 200, 300], [20, 120, 120, 20])
    error = np.where((t > 205) & (t < 225), 1.0, 0.0)
    found = phase_cells([axes(warm, "temperature")], [1.0], [error])
    worst = max(found["cells"], key=lambda cell: cell["share"])
    assert (worst["phase"], worst["direction"]) == ("high", "falling") and worst["share"] > 0.9


def test_without_movement_or_storage_there_is_no_map():
    assert phase_cells([[Axis("time", "s", "time", np.arange(9.0))]], [1.0], [np.zeros(9)]) is None
