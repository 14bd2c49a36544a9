"""The speed of a shaft, whatever unit its channel is written in, steady or not; where it cannot be known, that is said."""

from itertools import product

import numpy as np
import pytest

from residuum.diagnosis.diagnosers.bearing import Bearing
from residuum.diagnosis.finding import Verdict
from residuum.diagnosis.vibration.moving_lines import faulty_bearing, moving_line
from residuum.diagnosis.vibration.rotation import (
    is_turning,
    speed_channel,
    turns_per_minute,
    usual_speed,
)
from residuum.identification.errors import BadInput
from residuum.identification.record import Record

ORDERS = {"bpfi": 5.4152, "bpfo": 3.5848, "bsf": 2.357, "ftf": 0.398}
RATE, SHAFT = 12000, 29.95
A_TURN_A_SECOND = {
    "Hz": 1.0, "1/s": 1.0, "s^-1": 1.0, "s-1": 1.0, "kHz": 1e-3, "rpm": 60.0, "1/min": 60.0, "min^-1": 60.0, "min**-1": 60.0,
    "U/min": 60.0, "rad/s": 2 * np.pi, "°/s": 360.0, "turn/s": 1.0,
}  # fmt: skip


def inner_race(**speeds):
    """Two seconds of a damaged inner race beside channels of speed: name → (value, unit)."""
    x = faulty_bearing(2 * RATE, RATE, SHAFT, ORDERS, "bpfi", snr_db=0, seed=3)
    channels = {name: value * np.ones(x.shape[0]) for name, (value, _) in speeds.items()}
    return Record(
        {"housing": x, **channels},
        {"housing": "m/s²"} | {name: unit for name, (_, unit) in speeds.items()},
        1 / RATE,
    )


@pytest.mark.parametrize("unit", A_TURN_A_SECOND)
def test_the_part_is_named_in_every_unit_of_the_speed(unit):
    told = SHAFT * A_TURN_A_SECOND[unit]
    assert turns_per_minute(told, unit) == pytest.approx(60 * SHAFT)
    assert Bearing(orders=ORDERS).score(inner_race(speed=(told, unit))).fault_class == "inner-race"


@pytest.mark.parametrize(
    "unit", ["%/s", "count/s", "ticks/min", "rad/s**2", "1/m", "m/s", "s", "V"]
)
def test_what_is_no_speed_of_rotation_is_refused_and_named(unit):
    assert not is_turning(unit)
    with pytest.raises(BadInput, match="no unit of a speed of rotation"):
        turns_per_minute(1.0, unit)
    with pytest.raises(BadInput, match=r"give speed_rpm.*channel 'speed' is in"):
        Bearing(orders=ORDERS).score(inner_race(speed=(1797.0, unit)))


def test_a_speed_without_a_unit_is_asked_for_it():
    with pytest.raises(BadInput, match=r"'speed' has no unit.*say units={'speed': 'rpm'}"):
        Bearing(orders=ORDERS).score(inner_race(speed=(1797.0, "")))


def test_of_two_speeds_the_shaft_s_must_be_named():
    two = {"motor_speed": (3000.0, "rpm"), "shaft_speed": (SHAFT, "Hz")}
    with pytest.raises(
        BadInput,
        match=r"several speeds.*'motor_speed' 3000 rpm, 'shaft_speed' 1797 rpm.*map={'speed': 'CHANNEL'}",
    ):
        Bearing(orders=ORDERS).score(inner_race(**two))
    named = inner_race(**two).rename({"shaft_speed": "speed"})
    assert usual_speed(named, speed_channel(named)) == pytest.approx(60 * SHAFT)
    assert (
        Bearing(orders=ORDERS, speed_rpm=60 * SHAFT).score(inner_race(**two)).fault_class
        == "inner-race"
    )
    hertz = {name: order * SHAFT for name, order in ORDERS.items()}
    assert Bearing(hertz=hertz).score(inner_race(**two)).fault_class == "inner-race"
    same = {"speed_a": (1797.0, "rpm"), "speed_b": (1797.5, "1/min")}
    assert Bearing(orders=ORDERS).score(inner_race(**same)).fault_class == "inner-race"


STRIKES = {
    "bpfi": (ORDERS["bpfi"], 1.0),
    "bpfo": (ORDERS["bpfo"], 0.0),
    "bsf": (2 * ORDERS["bsf"], ORDERS["ftf"]),
}
"""Part → strikes a turn of the shaft, and how often a turn the load on the damage rises and falls."""


def struck(shaft, part, rate=12800, seed=5):
    """Vibration [m/s²] of a bearing whose `part` is damaged, while its shaft turns as `shaft` [Hz] says at each sample."""
    turned, rng = np.cumsum(shaft) / rate, np.random.default_rng(seed)
    impacts = np.zeros(len(shaft))
    if part:
        order, load = STRIKES[part]
        strikes = np.arange(1, int(turned[-1] * order)) / order
        impacts[np.searchsorted(turned, strikes)] = 1 + 0.7 * np.cos(
            2 * np.pi * load * strikes
        ) * bool(load)
    t = np.arange(130) / rate
    rings = np.convolve(impacts, np.exp(-t / 0.0012) * np.sin(2 * np.pi * 3200 * t))[: len(shaft)]
    return rings + 0.3 * rng.standard_normal(len(shaft))


def run_up(first, last, *, fault=True, seconds=6, rate=12800, unit="Hz", known=slice(None)):
    """A damaged outer race while the shaft goes from `first` to `last` Hz; the speed is known at some samples only."""
    n = seconds * rate
    shaft = np.linspace(first, last, n)
    x = struck(shaft, "bpfo" if fault else None, rate)
    speed = np.full(n, np.nan)
    speed[known] = (shaft * A_TURN_A_SECOND[unit])[known]
    return Record({"a": x, "speed": speed}, {"a": "m/s²", "speed": unit}, 1 / rate)


@pytest.mark.parametrize("unit", ["Hz", "rpm", "min^-1", "rad/s"])
def test_a_run_up_is_followed_by_its_speed_channel(unit):
    judged = Bearing(orders=ORDERS).score(run_up(20, 35, unit=unit))
    assert judged.fault_class == "outer-race", judged.reason
    assert (
        Bearing(orders=ORDERS).score(run_up(20, 35, unit=unit, fault=False)).within_absolute_limits
    )


def test_a_speed_that_is_read_four_times_a_second_is_enough():
    assert (
        Bearing(orders=ORDERS).score(run_up(20, 35, known=slice(None, None, 3200))).fault_class
        == "outer-race"
    )


def test_a_run_up_whose_speed_is_not_known_throughout_cannot_be_judged():
    judged = Bearing(orders=ORDERS).score(run_up(20, 35, known=slice(0, 40000)))
    assert judged.verdict is Verdict.NOT_ASSESSABLE and "the speed has gaps" in judged.reason


def test_what_is_said_of_a_changing_speed_must_agree_with_its_channel():
    record = run_up(20, 35)
    judged = Bearing(orders=ORDERS, speed_rpm=1500).score(record)
    assert judged.verdict is Verdict.NOT_ASSESSABLE
    assert "speed_rpm is 1500, but channel 'speed' goes from 1200 to 2100 rpm" in judged.reason
    assert Bearing(orders=ORDERS, speed_rpm=1650).score(record).fault_class == "outer-race"
    in_hertz = Bearing(hertz={name: 27.5 * order for name, order in ORDERS.items()}).score(record)
    assert in_hertz.verdict is Verdict.NOT_ASSESSABLE and "give orders" in in_hertz.reason


def without_speed(record):
    return Record({"a": record["a"]}, {"a": "m/s²"}, record.sample_time)


@pytest.mark.parametrize(("first", "last"), [(20, 35), (35, 20), (23, 32), (28, 29.5)])
def test_a_run_up_that_no_channel_tells_cannot_be_judged(first, last):
    record = without_speed(run_up(first, last))
    for bearing in (
        Bearing(orders=ORDERS, speed_rpm=1650),
        Bearing(hertz={name: 27.5 * o for name, o in ORDERS.items()}),
    ):
        judged = bearing.score(record)
        assert judged.verdict is Verdict.NOT_ASSESSABLE, judged
        assert (
            "a line of the envelope goes from" in judged.reason
            and "record the speed beside the vibration" in judged.reason
        )


CLASSES = {"bpfi": "inner-race", "bpfo": "outer-race", "bsf": "ball"}


def to_and_fro(depth, period, part, seed):
    """A shaft of 28 Hz whose speed rises and falls by the share `depth` once in `period` seconds."""
    t = np.arange(8 * 12800) / 12800
    shaft = 28 * (1 + depth * np.sin(2 * np.pi * t / period + seed))
    return Record(
        {"a": struck(shaft, part, seed=seed), "speed": shaft},
        {"a": "m/s²", "speed": "Hz"},
        1 / 12800,
    )


@pytest.mark.parametrize(("depth", "period"), [(0.01, 5.0), *product((0.03, 0.1), (0.4, 1.5, 5.0))])
def test_a_speed_that_goes_to_and_fro_untold_never_names_another_part_and_mostly_tells_itself(
    depth, period
):
    for part, name in CLASSES.items():
        record = to_and_fro(depth, period, part, seed=len(part))
        judged = Bearing(orders=ORDERS, speed_rpm=60 * 28).score(without_speed(record))
        assert judged.verdict is Verdict.NOT_ASSESSABLE or judged.fault_class == name, (
            part,
            judged.fault_class,
        )
        assert Bearing(orders=ORDERS).score(record).fault_class == name, part


@pytest.mark.parametrize("period", [0.4, 1.5, 5.0])
def test_the_cage_is_not_named_where_its_lines_alone_outlast_a_speed_that_nobody_tells(period):
    judged = Bearing(orders=ORDERS, speed_rpm=60 * 28).score(
        without_speed(to_and_fro(0.03, period, "bsf", seed=2))
    )
    assert judged.fault_class != "cage"


def test_a_line_that_goes_to_and_fro_is_told_by_its_extremes():
    line = moving_line(
        to_and_fro(0.1, 5.0, "bpfo", seed=1)["a"], 12800, {"bpfo": ORDERS["bpfo"] * 28}
    )
    low, high = sorted((line.first, line.last))
    assert (low, high) == pytest.approx(
        (0.9 * 28 * ORDERS["bpfo"], 1.1 * 28 * ORDERS["bpfo"]), rel=0.03
    )


@pytest.mark.parametrize("seed", range(6))
def test_a_healthy_bearing_and_a_steady_fault_show_no_moving_line(seed):
    lines = {name: SHAFT * order for name, order in ORDERS.items() if name != "ftf"}
    for fault in (None, "bpfi", "bpfo", "bsf", "ftf"):
        x = faulty_bearing(4 * RATE, RATE, SHAFT, ORDERS, fault, snr_db=-3 * (seed % 2), seed=seed)
        assert moving_line(x, RATE, lines) is None, fault


def test_the_sweep_is_measured():
    line = moving_line(run_up(20, 35)["a"], 12800, {"bpfo": ORDERS["bpfo"] * 27.5})
    begun = 20 * ORDERS["bpfo"]
    assert begun < line.first < line.last < 35 * ORDERS["bpfo"]
    assert (line.last - line.first) / line.seconds == pytest.approx(
        15 / 6 * ORDERS["bpfo"], rel=0.1
    )


def test_a_part_is_named_only_where_its_lines_stand_out_against_its_neighbours():
    alike = ORDERS | {"bpfo": 5.35}
    judged = Bearing(orders=alike, speed_rpm=60 * SHAFT).score(without_speed(steady_inner_race()))
    assert judged.verdict is Verdict.FAULTY and judged.fault_class == "unknown"
    assert (
        set(judged.evidence["likely"]) == {"inner-race", "outer-race"}
        and "are alike" in judged.reason
    )
    apart = Bearing(orders=ORDERS, speed_rpm=60 * SHAFT).score(without_speed(steady_inner_race()))
    assert apart.fault_class == "inner-race" and "likely" not in apart.evidence


def steady_inner_race():
    return inner_race().rename({"housing": "a"})


def test_each_healthy_record_is_learnt_at_its_own_speed():
    """What modulates a healthy rig at 3.5848 orders of the second record's speed must not pass for healthy at the first's."""
    rig = [at_speed(shaft) for shaft in (20.0, 33.0)]
    learnt = [
        Bearing(orders=ORDERS).fit(records)._baseline.lines["bpfo"] for records in (rig, rig[::-1])
    ]
    assert learnt[0] == pytest.approx(learnt[1]) and learnt[0] > 8


def at_speed(shaft):
    x = faulty_bearing(
        4 * RATE, RATE, shaft, ORDERS, "bpfo" if shaft > 30 else None, snr_db=0, seed=3
    )
    return Record(
        {"a": x, "speed": np.full(x.shape[0], shaft)}, {"a": "m/s²", "speed": "Hz"}, 1 / RATE
    )
