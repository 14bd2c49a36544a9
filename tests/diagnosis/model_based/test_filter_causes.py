"""Faults that are no column beside the innovations: pushes that nobody records, a sensor's noise, play in a drive."""

from dataclasses import replace
from functools import cache

import numpy as np

from residuum.diagnosis.diagnosers.model_based import ModelBased
from residuum.diagnosis.finding import Verdict
from residuum.identification.physics import load_model
from residuum.identification.record import Record
from residuum.simulation import MACHINES


def pushed_axis(seed, pushes=0.0, n=1500):
    """M dv/dt = F + p at 200 Hz, F of random levels, p new in each sample and not recorded."""
    rng = np.random.default_rng([seed, 7])
    levels = rng.uniform(30.0, 120.0, n // 50 + 1) * np.where(np.arange(n // 50 + 1) % 2, -1.0, 1.0)
    force = np.repeat(levels, 50)[:n]
    v = np.concatenate([[0.0], np.cumsum((force + pushes * rng.standard_normal(n))[:-1]) * 0.005 / 95.0])
    q = np.concatenate([[0.0], np.cumsum(0.5 * (v[1:] + v[:-1])) * 0.005])
    channels = {
        "force": force,
        "position": q + 1e-4 * rng.standard_normal(n),
        "velocity": v + 2e-3 * rng.standard_normal(n),
    }
    return Record(channels, {"force": "N", "position": "m", "velocity": "m/s"}, 0.005, source=f"pushed {seed}")


@cache
def axis():
    return ModelBased(model="linear-axis").fit([pushed_axis(seed) for seed in range(20)])


def first(finding):
    cause = finding.evidence["causes"][0]
    return f"{cause['name']}@{cause['place']}"


def test_pushes_that_nobody_records_are_a_random_load_and_no_sensor():
    for seed in (31, 32, 33):
        finding = axis().score(pushed_axis(seed, pushes=100.0))
        assert finding.verdict is Verdict.FAULTY and first(finding) == "rough-load@axis"
        low, high = finding.evidence["causes"][0]["value"]["band_95"]
        assert low < 110.0 and high > 90.0 and "at random" in finding.reason


def test_a_noisy_sensor_stays_the_sensor():
    record = pushed_axis(41)
    noisy = record["velocity"] + 8e-3 * np.random.default_rng(5).standard_normal(record.n)
    finding = axis().score(replace(record, channels={**record.channels, "velocity": noisy}))
    assert first(finding) == "noise@velocity"
    assert abs(finding.evidence["causes"][0]["value"]["value"] - np.hypot(8e-3, 2e-3)) < 1e-3


def test_new_play_of_a_drive_is_told_as_a_second_body():
    machine = MACHINES["gate-drive"](97, {"coulomb-friction": {}}, profile="rich")
    found = []
    for k in range(22):
        if k == 20:
            machine._y[2:4] = machine._y[0:2]
            machine.drive = machine.drive._replace(two_bodies=True, gap=0.5)
        run = machine.simulate(8.0)
        found.append(Record(dict(run.channels), dict(run.units), run.sample_time, t0=run.t0, source=f"window {k}"))
    drive = load_model("gate-drive").with_effect("coulomb-friction", "shaft", {"tau_c": 0.02})
    judge = ModelBased(model=drive, fix_undetermined=True).fit(found[:20])
    for record in found[20:]:
        finding = judge.score(record)
        assert first(finding) in ("backlash@shaft", "elastic-transmission@shaft")
