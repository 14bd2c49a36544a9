"""Faults that only the error shows: a sensor's noise, and play in a drive."""

import numpy as np
import pytest

from residuum.diagnosis.diagnosers.model_based import ModelBased, _axis
from residuum.diagnosis.finding import Verdict
from residuum.identification.physics import load_model
from residuum.identification.record import Record
from residuum.simulation import MACHINES


def first(finding):
    cause = finding.evidence["causes"][0]
    return f"{cause['name']}@{cause['place']}"


def test_a_noisy_sensor_is_told_as_the_sensor(complete_axis):
    axis = complete_axis
    record = _axis(41)
    noisy = record["velocity"] + 8e-3 * np.random.default_rng(5).standard_normal(record.n)
    finding = axis.score(
        Record(
            {**record.channels, "velocity": noisy}, record.units, record.sample_time, source="noisy"
        )
    )
    assert finding.verdict is Verdict.FAULTY and first(finding) == "noise@velocity"
    assert finding.evidence["causes"][0]["value"]["value"] == pytest.approx(8e-3, rel=0.1)


def test_new_play_of_a_drive_is_told_as_a_second_body():
    machine = MACHINES["gate-drive"](97, {"coulomb-friction": {}}, profile="rich")
    found = []
    for k in range(14):
        if k == 12:
            machine._y[2:4] = machine._y[0:2]
            machine.drive = machine.drive._replace(two_bodies=True, gap=0.5)
        run = machine.simulate(5.0)
        found.append(
            Record(
                dict(run.channels),
                dict(run.units),
                run.sample_time,
                t0=run.t0,
                source=f"window {k}",
            )
        )
    drive = load_model("gate-drive").with_effect("coulomb-friction", "shaft", {"tau_c": 0.02})
    judge = ModelBased(model=drive, fix_undetermined=True).fit(found[:12])
    for record in found[12:]:
        finding = judge.score(record)
        assert first(finding) in ("backlash@shaft", "elastic-transmission@shaft")
