"""Friction that grows from record to record is wear; the rest of the drive stays what it is."""

import numpy as np
import pytest

from residuum.identification.discrepancy.trend import _line, trends
from residuum.identification.physics import load_model
from residuum.identification.record import Record
from residuum.simulation import MACHINES


def test_a_line_is_recovered_within_its_band():
    rng = np.random.default_rng(0)
    std = np.full(12, 0.1)
    trend = _line("tau_c", "N*m", 2.0 + 0.2 * np.arange(12) + 0.1 * rng.standard_normal(12), std)
    assert trend.slope == pytest.approx(0.2, abs=3 * trend.slope_std)
    assert trend.changes
    assert not _line("tau_c", "N*m", 2.0 + 0.1 * rng.standard_normal(12), std).changes


def test_two_records_say_nothing_of_a_trend():
    assert not _line("R", "ohm", np.array([1.0, 2.0]), np.array([0.01, 0.01])).changes


def test_growing_friction_is_told_from_a_constant_resistance():
    records = []
    for k, tau_c in enumerate((0.010, 0.014, 0.018, 0.022)):
        s = MACHINES["gate-drive"](seed=k, effects={"coulomb-friction": {"tau_c": tau_c}}, rate=200.0, deviation=0.0).simulate(
            15.0
        )
        records.append(Record(s.channels, s.units, s.sample_time))
    model = load_model("gate-drive").with_effect("coulomb-friction", "shaft", {"tau_c": 0.01})
    found = {trend.parameter: trend for trend in trends(model, records)}
    friction = found["coulomb-friction@shaft.tau_c"]
    assert friction.changes
    assert friction.slope == pytest.approx(0.004, rel=0.1)
    assert not found["R"].changes
