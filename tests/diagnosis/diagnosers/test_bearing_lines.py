"""Bearing diagnoser: named parts on made and real recordings, calm on healthy machines with lines of their own."""

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy import signal
from scipy.io import loadmat
from sklearn.metrics import roc_auc_score

from residuum.diagnosis.diagnosers.bearing import Bearing
from residuum.diagnosis.finding import Verdict
from residuum.diagnosis.vibration.bearing_lines import (
    BearingFrequencies,
    SearchedBands,
    line_evidence,
    orders_from_geometry,
)
from residuum.diagnosis.vibration.moving_lines import faulty_bearing
from residuum.identification.errors import BadInput
from residuum.identification.record import Record

ORDERS = {"bpfi": 5.4152, "bpfo": 3.5848, "bsf": 2.357, "ftf": 0.398}
RIG = Path(__file__).resolve().parents[4] / "shared" / "data" / "cwru"
real = pytest.mark.skipif(not RIG.is_dir(), reason="skipped: no real recordings here")


def acceleration(x, rate, **channels):
    units = {"housing": "g"} | dict.fromkeys(channels, "rpm")
    return Record({"housing": x, **channels}, units, 1 / rate)


@pytest.mark.parametrize(
    ("fault", "part"),
    [("bpfi", "inner-race"), ("bpfo", "outer-race"), ("bsf", "ball"), (None, None)],
)
@pytest.mark.parametrize(("rate", "shaft", "seconds"), [(12000, 29.93, 2), (48828, 25.0, 3)])
def test_the_damaged_part_is_named_without_baseline(fault, part, rate, shaft, seconds):
    for seed in (0, 1):
        x = faulty_bearing(
            int(seconds * rate),
            rate,
            shaft,
            ORDERS,
            fault,
            snr_db=-4,
            seed=seed,
            resonance=0.22 * rate,
        )
        hertz = {name: order * shaft * 1.004 for name, order in ORDERS.items()}
        for judge in (Bearing(orders=ORDERS, speed_rpm=60 * shaft), Bearing(hertz=hertz)):
            assert judge.score(acceleration(x, rate)).fault_class == part


def test_the_cage_is_named_when_it_leads():
    x = faulty_bearing(12000 * 10, 12000, 30.0, ORDERS, "ftf", snr_db=0, seed=1)
    assert (
        Bearing(orders=ORDERS, speed_rpm=1800).score(acceleration(x, 12000)).fault_class == "cage"
    )


def healthy_machine(kind, n, rate, shaft, rng):
    t = np.arange(n) / rate
    x = rng.standard_normal(n)
    if kind == "gear":
        return x + (1 + 0.6 * np.cos(2 * np.pi * shaft * t)) * 2 * np.cos(
            2 * np.pi * 23 * shaft * t
        )
    if kind == "knocks":
        struck = np.bincount(rng.integers(0, n, 24), minlength=n)
        ring = 30 * np.exp(-np.arange(40) / 8) * np.cos(2 * np.pi * 0.2 * np.arange(40))
        return x + np.convolve(struck, ring)[:n]
    if kind == "modulated":
        return x * (1 + 0.5 * np.cos(2 * np.pi * shaft * t))
    return x


@pytest.mark.parametrize("kind", ["noise", "gear", "modulated"])
def test_healthy_machines_with_lines_of_their_own_are_healthy(kind):
    for seed in range(6):
        rng = np.random.default_rng([seed, 5])
        shaft, rate = rng.uniform(15, 50), 12800
        orders = orders_from_geometry(int(rng.integers(7, 13)), rng.uniform(0.15, 0.3), 1.0)
        judged = Bearing(orders=orders, speed_rpm=60 * shaft).score(
            acceleration(healthy_machine(kind, 2 * rate, rate, shaft, rng), rate)
        )
        assert judged.within_absolute_limits, judged.reason


def test_without_a_baseline_health_is_not_said_but_the_limits_that_hold():
    x = faulty_bearing(24000, 12000, 30.0, ORDERS, None, seed=51)
    judged = Bearing(orders=ORDERS, speed_rpm=1800).score(acceleration(x, 12000))
    assert judged.verdict is Verdict.NOT_ASSESSABLE and judged.fault_class is None
    assert "no baseline" in judged.reason and "kurtosis 2.98 of 6, prominence_bpfi" in judged.reason
    assert judged.indicators["severity"] < 1 and not judged.evidence["baseline"]
    assert baseline().score(acceleration(x, 12000)).verdict is Verdict.HEALTHY


def test_impulses_without_a_line_are_unknown():
    x = healthy_machine("knocks", 24000, 12000, 30.0, np.random.default_rng(0))
    judged = Bearing(orders=ORDERS, speed_rpm=1800).score(acceleration(x[:12000], 12000))
    assert (judged.verdict, judged.fault_class) == (Verdict.FAULTY, "unknown")


@pytest.mark.parametrize("knocks", [1, 3])
@pytest.mark.parametrize("trained", [False, True])
def test_a_few_knocks_are_no_fault_and_hide_none(knocks, trained):
    """Someone bumps into the machine: a ring-down 20 to 60 times as strong as the noise, once or three times a second."""
    judge = baseline() if trained else Bearing(orders=ORDERS, speed_rpm=1800)
    t = np.arange(600) / 12000
    for seed, (fault, expected) in enumerate([(None, None), (None, None), ("bpfo", "outer-race")]):
        rng = np.random.default_rng([seed, knocks])
        x = faulty_bearing(12000, 12000, 30.0, ORDERS, fault, snr_db=3.0, seed=70 + seed)
        at = rng.integers(0, 11_000, knocks)
        for k in at:
            f = rng.uniform(800, 5000)
            x[k : k + 600] += rng.uniform(20, 60) * np.exp(-0.1 * f * t) * np.sin(2 * np.pi * f * t)
        judged = judge.score(acceleration(x, 12000))
        assert judged.fault_class == expected, judged.reason
        assert any(
            abs(k / 12000 - found) < 0.02 for k in at for found in judged.evidence["knocks_s"]
        )


def test_slip_of_nearly_two_percent_and_a_loud_gear_hide_no_fault():
    """The lines stand where slip puts them; a gear's mesh in the same band is cut down first."""
    rate, shaft = 12000, 30.0
    slipped = {name: 0.982 * order for name, order in ORDERS.items()}
    t = np.arange(2 * rate) / rate
    gear = 4 * (1 + 0.4 * np.cos(2 * np.pi * shaft * t)) * np.cos(2 * np.pi * 97 * shaft * t)
    for fault, part in (
        ("bpfi", "inner-race"),
        ("bpfo", "outer-race"),
        ("bsf", "ball"),
        (None, None),
    ):
        x = faulty_bearing(2 * rate, rate, shaft, slipped, fault, snr_db=-3.0, seed=80) + gear
        assert (
            Bearing(orders=ORDERS, speed_rpm=60 * shaft).score(acceleration(x, rate)).fault_class
            == part
        )


def test_a_machine_class_puts_the_severity_zone_into_the_evidence():
    x = faulty_bearing(24000, 12000, 30.0, ORDERS, None, seed=90)
    judged = Bearing(orders=ORDERS, speed_rpm=1800, machine_class="II").score(
        acceleration(x, 12000)
    )
    assert (
        judged.evidence["severity"]["zone"] in "ABCD"
        and judged.evidence["severity"]["velocity"] > 0
    )


def test_a_varying_speed_is_followed():
    rate, n = 12800, 4 * 12800
    speed = 1800 * (1 + 0.1 * np.sin(2 * np.pi * 0.4 * np.arange(n) / rate))
    turns = np.cumsum(speed) / 60 / rate
    at = np.searchsorted(turns, np.arange(1, int(turns[-1] * ORDERS["bpfo"])) / ORDERS["bpfo"])
    impacts = np.zeros(n)
    impacts[at] = 1.0
    t = np.arange(300) / rate
    ringing = np.convolve(impacts, np.exp(-900 * t) * np.sin(2 * np.pi * 3200 * t))[:n]
    x = ringing / ringing.std() + np.random.default_rng(0).standard_normal(n)
    followed = Bearing(orders=ORDERS).score(acceleration(x, rate, speed=speed))
    assert followed.fault_class == "outer-race"
    assert (
        Bearing(orders=ORDERS, speed_rpm=1800).score(acceleration(x, rate)).fault_class
        != "outer-race"
    )


@cache
def baseline():
    x = faulty_bearing(12000 * 8, 12000, 30.0, ORDERS, None, seed=50)
    return Bearing(orders=ORDERS, speed_rpm=1800).fit([acceleration(x, 12000)])


def test_baseline_finds_a_change_that_no_line_explains_and_survives_another_rate():
    rng = np.random.default_rng(1)
    healthy = faulty_bearing(24000, 12000, 30.0, ORDERS, None, seed=51)
    hiss = np.convolve(rng.standard_normal(24000), [1, 0, -1, 0, 1, 0, -1, 0, 1], "same")
    assert baseline().score(acceleration(healthy, 12000)).verdict is Verdict.HEALTHY
    judged = baseline().score(acceleration(healthy + hiss, 12000))
    assert judged.fault_class == "unknown" and any(
        "2000_4000" in name for name in judged.evidence["changed"]
    )
    faster = faulty_bearing(2 * 48000, 48000, 30.0, ORDERS, "bpfi", snr_db=-3, seed=52) * 2
    assert baseline().score(acceleration(faster, 48000)).fault_class == "inner-race"


def test_another_sensitivity_is_no_fault():
    x = 3.0 * faulty_bearing(24000, 12000, 30.0, ORDERS, None, seed=53)
    judged = baseline().score(acceleration(x, 12000))
    assert judged.verdict is Verdict.NOT_ASSESSABLE and "sensitivity" in judged.reason


def test_gain_and_time_shift_change_no_line_evidence():
    x = faulty_bearing(24000, 12000, 30.0, ORDERS, "bpfo", seed=2)
    frequencies = BearingFrequencies.from_orders(ORDERS, 30.0)
    once, scaled = (line_evidence(signal, 12000, frequencies) for signal in (x, 1e-3 * x))
    assert all(
        scaled[name].prominence == pytest.approx(once[name].prominence, rel=1e-6) for name in once
    )
    single = line_evidence(x.astype(np.float32), 12000, frequencies)
    assert single["bpfo"].prominence == pytest.approx(once["bpfo"].prominence, rel=1e-2)


ODD = {
    "a pure tone": np.cos(2 * np.pi * 333.0 * np.arange(12000) / 12000),
    "silence": np.zeros(12000),
    "one impact": np.eye(1, 12000, 6000)[0],
    "a prime length": np.random.default_rng(0).standard_normal(11987),
    "one sample": np.ones(1),
    "missing": np.full(12000, np.nan),
    "tiny": 1e-200 * np.random.default_rng(0).standard_normal(12000),
}


@pytest.mark.parametrize("kind", ODD)
@pytest.mark.parametrize("single", [False, True])
def test_odd_signals_give_a_verdict(kind, single):
    x = ODD[kind].astype(np.float32) if single else ODD[kind]
    plain = Bearing(orders=ORDERS, speed_rpm=1800)
    for judge in (plain, baseline()):
        finding = judge.score(acceleration(x, 12000))
        assert finding.verdict is Verdict.NOT_ASSESSABLE or all(
            np.isfinite(list(finding.indicators.values()))
        )
        calm = finding.verdict is Verdict.HEALTHY or finding.within_absolute_limits
        assert not calm or kind in ("a prime length", "a pure tone")


def test_settings_and_speed_are_checked():
    x = np.random.default_rng(0).standard_normal(12000)
    with pytest.raises(BadInput, match="give speed_rpm"):
        Bearing(orders=ORDERS).score(acceleration(x, 12000))
    with pytest.raises(BadInput, match="'gear' is no fault line"):
        Bearing(hertz={"gear": 5.0})
    with pytest.raises(BadInput, match="one of them"):
        Bearing(orders=ORDERS, hertz={"bpfi": 100.0})
    other = baseline().with_settings(orders={"bpfi": 4.9, "bpfo": 3.1})
    assert other.orders == {"bpfi": 4.9, "bpfo": 3.1} and other.speed_rpm == 1800
    with pytest.raises(BadInput, match="has no setting 'colour'"):
        baseline().with_settings(colour=1)
    slow = Bearing(orders=ORDERS, speed_rpm=60000).score(acceleration(x, 12000))
    assert slow.verdict is Verdict.NOT_ASSESSABLE and "sampling rate" in slow.reason


def windows(name, rate=12000, seconds=1, sensor="DE"):
    x, n = (
        next(
            value.ravel()
            for key, value in loadmat(RIG / name).items()
            if key.endswith(f"{sensor}_time")
        ),
        seconds * rate,
    )
    return [acceleration(x[k : k + n], rate) for k in range(0, x.size - n + 1, n)]


@real
@pytest.mark.parametrize("sensor", ["DE", "FE"])
def test_no_healthy_block_of_two_seconds_names_a_part(sensor):
    plain = Bearing(orders=ORDERS, speed_rpm=1796)
    blocks = windows("97_Normal_0.mat", seconds=2, sensor=sensor)
    assert len(blocks) == 10 and all(plain.score(block).within_absolute_limits for block in blocks)


def test_a_second_look_costs_what_chance_gains_by_it():
    """A part at one of two frequencies stands out by the better one, less ln 2 / ln 5 deciles."""
    grid, bands = np.geomspace(50.0, 200.0, 1001), [(0.0, 6000.0)]
    # below what is worth taking its own lines out of the controls for
    height = np.interp(grid, [50, 70, 72, 140, 142, 200], [0, 0.6, 0.6, 1.8, 1.8, 0])[None, :]
    control = np.zeros(len(grid), bool)
    frequencies = BearingFrequencies.from_orders(ORDERS, 30.0)
    searched = SearchedBands(grid, control, bands, [], height, height, height, frequencies)
    once, twice = (searched.evidence(centres) for centres in ([141.0], [141.0, 71.0]))
    assert twice.expected == once.expected == 141.0 and twice.depth == once.depth
    assert once.prominence - twice.prominence == pytest.approx(np.log(2) / np.log(5))


@real
def test_real_bearings_are_separated_and_named():
    healthy, inner, outer = (
        windows(name) for name in ("97_Normal_0.mat", "105_0.mat", "130_0.mat")
    )
    judge = Bearing(orders=ORDERS, speed_rpm=1796).fit(healthy[::2])
    plain = Bearing(orders=ORDERS, speed_rpm=1796)
    held_out = [judge.score(window) for window in healthy[1::2]]
    assert {finding.verdict for finding in held_out} == {Verdict.HEALTHY}
    assert all(plain.score(window).within_absolute_limits for window in healthy)
    scores = [finding.indicators["severity"] for finding in held_out]
    for part, expected in ((inner, "inner-race"), (outer, "outer-race")):
        findings = [judge.score(window) for window in part]
        assert {finding.fault_class for finding in findings} == {expected}
        assert {plain.score(window).fault_class for window in part} == {expected}
        severities = [finding.indicators["severity"] for finding in findings]
        assert (
            roc_auc_score([0] * len(scores) + [1] * len(severities), scores + severities) >= 0.999
        )


def test_a_harmonic_at_the_width_of_a_band_is_no_line():
    """Beyond a band's width its squared envelope is empty: a fourth harmonic there must not stand out of nothing."""
    frequencies = BearingFrequencies.from_hertz(
        {"bpfi": 358.6, "bpfo": 260.2, "bsf": 157.0, "ftf": 21.7}, 51.6
    )
    noise = np.random.default_rng(0).standard_normal((12, 23_000))
    # bands of 1250 Hz, 4 · 2 · 157 Hz = 1256 Hz
    found = [line_evidence(x, 10_000, frequencies) for x in noise]
    assert max(line.prominence for evidence in found for line in evidence.values()) < 5.0


def test_a_strong_fault_does_not_hide_itself_among_its_own_controls():
    """The stronger the impacts, the more control frequencies lie on harmonics and sidebands of theirs."""
    orders = orders_from_geometry(8, 0.235, 1.245)
    judge = Bearing(orders=orders, speed_rpm=1500)
    for seed in range(4):
        x = faulty_bearing(3 * 48_828, 48_828, 25.0, orders, "bpfi", snr_db=-6.0, seed=seed)
        assert judge.score(acceleration(x, 48_828)).fault_class == "inner-race"


def test_two_lines_that_beat_are_no_fault_and_hide_none():
    """A drive at 100 Hz beside the shaft's 30 Hz beats at 70 Hz, near twice the ball's rotation: no ball is damaged."""
    t = np.arange(24000) / 12000
    for seed, (fault, expected) in enumerate([(None, None), (None, None), ("bpfo", "outer-race")]):
        x = faulty_bearing(24000, 12000, 30.0, ORDERS, fault, seed=60 + seed)
        judged = Bearing(orders=ORDERS, speed_rpm=1800).score(
            acceleration(x + 3 * x.std() * np.sin(2 * np.pi * 100 * t), 12000)
        )
        assert judged.fault_class == expected
        assert "one line, at 100 Hz, holds" in judged.reason


def test_a_sensor_that_nothing_reaches_is_never_healthy():
    judge, noise = baseline(), np.random.default_rng(1).standard_normal(24000)
    healthy = faulty_bearing(24000, 12000, 30.0, ORDERS, None, seed=61)
    padded = signal.lfilter(*signal.butter(2, 500, fs=12000), healthy)
    for x, says in (
        (1e-3 * noise, "dead"),
        (padded, "above 2000 Hz"),
        (0.2 * healthy, "another sensitivity"),
    ):
        judged = judge.score(acceleration(x, 12000))
        assert judged.verdict is Verdict.NOT_ASSESSABLE and says in judged.reason
    spiky = healthy.copy()
    spiky[[4000, 9000, 17000]] += 60 * healthy.std()
    judged = judge.score(acceleration(spiky, 12000))
    assert judged.verdict is Verdict.HEALTHY and "3 of 24000" in judged.reason
