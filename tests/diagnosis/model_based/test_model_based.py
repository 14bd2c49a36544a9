"""The model-based diagnoser on a machine that shares no code with the model: faults found, named and sized."""

import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy import signal

from residuum.diagnosis.diagnosers.model_based import ModelBased
from residuum.diagnosis.finding import Verdict
from residuum.diagnosis.model_based.assessment import detected, estimated_window
from residuum.diagnosis.model_based.baseline import Baseline
from residuum.diagnosis.model_based.training import Undetermined
from residuum.diagnosis.model_based.variant import Variant, edited, shifted
from residuum.diagnosis.model_based.window_fit import Whitening, WindowFitter, information_on_size
from residuum.identification.errors import BadInput
from residuum.identification.physics import load_model, match, read_model
from residuum.identification.record import Record
from residuum.simulation import MACHINES

WINDOW = 6.0
LAG = """
name: lag
inputs: {voltage: V}
states: {w: {unit: rpm}}
parameters:
  T: {value: 0.05, unit: s, fixed: true}
  G: {value: 2.0, unit: rpm/V, lower: 0.1, upper: 10}
balances:
  shaft: {kind: torque, storage: T * der(w), terms: {motor: G * voltage, loss: -w}, velocity: w}
outputs: {speed: {value: w, unit: rpm}}
"""


@cache
def axis_windows(count, mass=1.0, friction=1.0):
    """Windows of one axis with dry friction, which the model lacks; its mass or friction changed from window 20 on."""
    machine = MACHINES["linear-axis"](
        seed=5, effects={"coulomb-friction": {}}, rate=250.0, deviation=0.05
    )
    found = []
    for k in range(20 + count):
        if k == 20:
            machine.axis = machine.axis._replace(
                M=machine.axis.M * mass, tau_c=machine.axis.tau_c * friction
            )
        s = machine.simulate(WINDOW)
        found.append(
            Record(dict(s.channels), dict(s.units), s.sample_time, t0=s.t0, source=f"window {k}")
        )
    return found, machine.axis


def train_axis(file):
    """A baseline, and beside it what the diagnoser says that was not stored yet."""
    trained = ModelBased(model="linear-axis").fit(axis_windows(6)[0][:20])
    trained.save(file)
    file.with_suffix(".json").write_text(
        json.dumps(trained.score(axis_windows(6)[0][21]).to_json())
    )


@pytest.fixture(scope="session")
def axis_file(made_once):
    return made_once("watched-axis.base", train_axis)


@pytest.fixture(scope="session")
def watched(axis_file):
    return ModelBased.load(axis_file)


def lag_window(rng, gain, k):
    u = np.repeat(rng.uniform(2.0, 8.0, 12), 50)
    x = (
        signal.lfilter([0.0, 1.0 - np.exp(-0.01 / 0.05)], [1.0, -np.exp(-0.01 / 0.05)], u - u[0])
        + u[0]
    )
    y = gain * x + 0.1 * rng.standard_normal(len(u))
    return Record(
        {"voltage": u, "speed": y}, {"voltage": "V", "speed": "rpm"}, 0.01, source=f"window {k}"
    )


def group(finding):
    first = finding.to_json()["causes"][0]
    return {f"{first['name']}@{first['place']}".rstrip("@"), *first["indistinguishable_from"]}


def changed(record, **channels):
    return replace(record, channels={**record.channels, **channels})


def test_healthy_windows_are_healthy_and_the_friction_is_told_as_missing_physics(watched):
    findings = [watched.score(record) for record in axis_windows(6)[0][20:]]
    assert [f.verdict for f in findings].count(Verdict.HEALTHY) >= 5
    missing = findings[0].evidence["missing_physics"]
    assert {m["place"] for m in missing} == {"axis"} and any(
        "friction" in m["effect"] for m in missing
    )
    assert "residuum explain" in findings[0].reason and "extrapolated" in findings[0].reason


def test_a_mass_a_fifth_heavier_is_found_named_and_sized(watched):
    windows, axis = axis_windows(10, mass=1.2)
    findings = [watched.score(record) for record in windows[20:]]
    faulty = [f for f in findings if f.verdict is Verdict.FAULTY]
    assert len(faulty) >= 9 and sum("M" in group(f) for f in faulty) >= 0.85 * len(faulty)
    for finding in findings:
        told = finding.to_json()["parameters"]["M"]
        assert told["value"] > told["healthy"]["high"] and told["healthy"]["high"] < axis.M
    size = next(c for c in finding.to_json()["causes"] if c["name"] == "M")["value"]
    assert size["value"] == pytest.approx(axis.M, rel=0.03) and size["unit"] == "kg"


def test_a_sensor_that_reads_too_much_is_told_as_the_sensor(watched):
    record = axis_windows(6)[0][22]
    finding = watched.score(changed(record, velocity=1.06 * record["velocity"]))
    assert finding.verdict is Verdict.FAULTY and "gain@velocity" in group(finding)
    first = finding.to_json()["causes"][0]
    assert first["kind"] == "sensor" and first["value"]["value"] == pytest.approx(0.06, abs=0.01)
    assert "velocity" in first["says"]


def test_two_things_at_once_are_both_named(watched):
    windows, _ = axis_windows(10, mass=1.2)
    record = windows[24]
    finding = watched.score(changed(record, velocity=record["velocity"] + 0.03))
    causes = finding.to_json()["causes"][:2]
    assert {(c["name"], c["place"]) for c in causes} == {("M", ""), ("offset", "velocity")}
    assert (
        all(c["beside"] and c["probability"] > 0.5 for c in causes)
        and f", and {causes[1]['says']}" in finding.reason
    )


def test_a_stuck_sensor_is_told_with_its_onset(watched):
    record = axis_windows(6)[0][23]
    half = record.n // 2
    held = np.where(np.arange(record.n) > half, record["velocity"][half], record["velocity"])
    finding = watched.score(changed(record, velocity=held))
    assert finding.fault_class == "sensor-stuck"
    assert finding.to_json()["causes"][0]["onset_time"] == pytest.approx(
        record.time[half], abs=0.05
    )


def test_lost_readings_are_a_drop_out(watched):
    record = axis_windows(6)[0][24]
    lost = np.random.default_rng(0).random(record.n) < 0.02
    finding = watched.score(changed(record, velocity=np.where(lost, -9.0, record["velocity"])))
    assert finding.fault_class == "sensor-drop-out"


def test_a_machine_that_stands_is_not_assessable(watched):
    record = axis_windows(6)[0][20]
    still = {name: np.full(record.n, float(record[name][0])) for name in record.names}
    finding = watched.score(changed(record, **still))
    assert finding.verdict is Verdict.NOT_ASSESSABLE and "stands still" in finding.reason


def test_a_rarer_alarm_has_a_higher_limit(watched):
    record = axis_windows(6)[0][20]
    often, seldom = (
        watched.with_settings(false_alarms_per_day=rate).score(record) for rate in (10.0, 0.01)
    )
    assert often.thresholds["deviation"] < seldom.thresholds["deviation"]


def test_values_that_the_windows_leave_open_are_refused_by_name_or_held():
    text = load_model("linear-axis")
    resting = [changed(r, force=np.zeros(r.n), velocity=1e-3 * np.random.default_rng(k).standard_normal(r.n),
                       position=1e-4 * np.random.default_rng(k + 99).standard_normal(r.n))
               for k, r in enumerate(axis_windows(6)[0][:8])]  # fmt: skip
    with pytest.raises(Undetermined, match=r"M: record.*fix_undetermined=True"):
        ModelBased(model=text).fit(resting)


def test_without_a_model_that_fits_it_asks_for_one():
    with pytest.raises(BadInput, match="say model=FILE"):
        ModelBased().fit([Record({"a": np.arange(100.0)}, {"a": "V"}, 0.01)])


def test_a_stored_baseline_judges_as_the_trained_one_and_still_knows_what_the_user_s_model_lacks(
    axis_file, watched
):
    told = json.loads(axis_file.with_suffix(".json").read_text())
    assert json.loads(json.dumps(watched.score(axis_windows(6)[0][21]).to_json())) == told
    assert watched.baseline.mended and not watched.model.effects


def test_a_baseline_of_another_version_is_refused(watched, tmp_path, monkeypatch):
    watched.save(tmp_path / "axis.base")
    monkeypatch.setattr("residuum.diagnosis.model_based.baseline._VERSION", 7)
    with pytest.raises(BadInput, match="train it again"):
        Baseline.load(tmp_path / "axis.base", "model-based")


def test_a_window_at_another_rate_or_too_short_or_with_a_gap_is_not_assessable(watched):
    record = axis_windows(6)[0][20]
    gap = np.array(record["velocity"])
    gap[record.n // 2 - 5 : record.n // 2 + 5] = np.nan  # no stretch is longer than half a window
    unfit = [replace(record, sample_time=0.01), record.window(0, 80), changed(record, velocity=gap)]
    for one, says in zip(unfit, ("sampled every", "80 samples", "missing samples"), strict=True):
        finding = watched.score(one)
        assert finding.verdict is Verdict.NOT_ASSESSABLE and says in finding.reason


def test_what_a_baseline_cannot_see_is_told(watched):
    told = watched.learned()
    assert 0.0 < told["parameters"]["M"]["smallest_visible_change"] < 0.1 * axis_windows(6)[1].M
    assert any("would be found in one window" in line for line in told["says"])


def test_a_value_that_no_window_tells_has_no_change_that_would_be_found(watched):
    blind = replace(
        watched.baseline, typical=np.where(np.arange(len(watched.baseline.free)) == 0, 0.0, 1e6)
    )
    first = watched.baseline.free[0]
    assert blind.smallest_visible(0.01)[first] == np.inf
    seeing = type(watched)()
    seeing._baseline = blind
    (line,) = [line for line in seeing.learned()["says"] if line.startswith(f"  {first} = ")]
    assert "no change, however large, would be found in one window" in line


def test_a_window_that_stands_apart_is_told_when_training():
    rng = np.random.default_rng(4)
    windows = [
        lag_window(rng, gain=2.6 if k == 7 else 2.0 + 0.02 * rng.standard_normal(), k=k)
        for k in range(12)
    ]
    told = ModelBased(model=read_model(LAG)).fit(windows).learned()
    assert told["apart"] == [7] and any(
        "window 7" in line and "apart" in line for line in told["says"]
    )


def test_relearned_it_still_lacks_what_it_lacked_and_an_accepted_model_takes_its_place(watched):
    windows = axis_windows(6)[0]
    again = watched.relearned(windows[:8])
    assert again.baseline.mended == watched.baseline.mended and not again.model.effects
    use = watched.baseline.stand_ins[0]
    improved = load_model("linear-axis").with_effect(
        *use.key, {name: p.value for name, p in use.parameters.items()}
    )
    accepted = watched.relearned(windows[:8], improved)
    assert accepted.baseline.mended == () and accepted.baseline.asked.effects == improved.effects
    assert accepted.score(windows[22]).verdict is Verdict.HEALTHY


def test_an_offset_is_held_against_that_of_healthy_windows(watched):
    record, b = axis_windows(6)[0][22], watched.baseline
    seen = estimated_window(b, record)
    moved = estimated_window(b, changed(record, velocity=record["velocity"] + 0.01))
    assert moved.offsets[0][1] - seen.offsets[0][1] == pytest.approx(0.01, rel=0.05)
    untold = (moved.offsets[0], 1e-12 * moved.offsets[1])
    healthy, faulty, open_ = (
        detected(b, seen.fit, each, seen.features).p
        for each in (seen.offsets, moved.offsets, untold)
    )
    assert faulty < 1e-6 < healthy <= open_


def test_the_information_on_an_offset_is_what_it_scatters_by():
    """Beside a gain with a prior, of which a nearly steady input says little: simulated again and again."""
    model, rng = read_model(LAG), np.random.default_rng(3)
    u, told, found = np.repeat(5.0 + 0.3 * rng.standard_normal(8), 50), [], []
    x = (
        signal.lfilter([0.0, 1.0 - np.exp(-0.01 / 0.05)], [1.0, -np.exp(-0.01 / 0.05)], u - u[0])
        + u[0]
    )
    for _ in range(200):
        y = (2.0 + 0.05 * rng.standard_normal()) * x + 0.1 * rng.standard_normal(400)
        _, (window,) = match(
            model, [Record({"voltage": u, "speed": y}, {"voltage": "V", "speed": "rpm"}, 0.01)]
        )
        window = replace(window, hold=np.ones(1))
        fitter = WindowFitter(
            model,
            window,
            np.array([2.0]),
            np.array([[0.05**2]]),
            Whitening.plain(np.array([0.1])),
            1e6,
        )
        fit = fitter.fit(
            Variant(model, sizes=(0.0,), lower=(-np.inf,), reading=edited(0, shifted)), 8
        )
        found.append(fit.own[0])
        told.append(information_on_size(fit, fitter.covariance))
    assert np.std(found) == pytest.approx(np.mean(np.array(told) ** -0.5), rel=0.15)
