"""A machine watched by an FMU: its parameters followed, its baseline moved; one that breaks down ends its own process."""

import json
import shutil

import numpy as np
import pytest

import residuum as rs
from residuum.diagnosis.learning.stored import load_stored
from residuum.diagnosis.model_based.hypotheses import hypotheses
from residuum.diagnosis.model_based.training import following
from residuum.identification.errors import BadInput, BadModel, Forbidden
from residuum.identification.physics import Experiment, Simulator, load_model
from residuum.identification.physics.fmu.watched_model import declaring
from residuum.identification.record import Record
from residuum.identification.record_formats import write_record
from residuum.service.cli import ANSWER_IS_NO, BAD_INPUT, run
from tests.identification.physics.fmu_files import (
    aborting,
    exported,
    rewritten,
    with_another_fmu,
    without_exchange,
)

pytest.importorskip("fmpy")
DT, N = 0.02, 120
DOTTED = ["viscous_friction_axis.d"]
UNITS = {"force": "N", "position": "m", "velocity": "m/s"}
# The model of the file: its mass is 95 kg, that of the machine is not.
SLIDING = load_model("linear-axis").with_effect("viscous-friction", "axis", {"d": 40.0})


def window(seed, model=SLIDING, M=110.0):
    """A window of the machine, as our own model of the same equations moves."""
    rng = np.random.default_rng([seed, 3])
    U = np.repeat(rng.uniform(-90.0, 90.0, (N // 15, 1)), 15, axis=0)
    blank = Experiment(U, np.full((N, 2), np.nan), np.zeros(1), DT)
    Y = Simulator(model.with_values({"M": M})).run(blank, {}, substeps=20).Y
    Y = Y + rng.normal(scale=[1e-4, 1e-3], size=Y.shape)
    channels = {"force": U[:, 0], "position": Y[:, 0], "velocity": Y[:, 1]}
    return Record(channels, UNITS, DT, source=f"window {seed}")


@pytest.fixture(scope="module")
def axis(tmp_path_factory):
    return exported(SLIDING, tmp_path_factory.mktemp("fmu") / "axis.fmu")


@pytest.fixture(scope="module")
def watch(axis):
    return rs.monitor(rs.fmu(axis), free=["M"]).fit([window(seed) for seed in range(6)])


@pytest.fixture(scope="module")
def baseline(watch, tmp_path_factory):
    """The baseline in a file, far from the FMU."""
    file = tmp_path_factory.mktemp("baseline") / "axis.npz"
    watch.save(file)
    return file


def test_its_parameters_are_learned_and_a_healthy_window_is_healthy(watch):
    learned = watch.diagnoser_.learned()["parameters"]
    assert learned["M"]["value"] == pytest.approx(110.0, rel=0.02)
    assert watch.score(window(101)).verdict == "healthy"


def test_a_parameter_that_changed_is_named_with_its_size(watch):
    found = watch.score(window(102, M=132.0)).found
    first = found.evidence["causes"][0]
    assert found.verdict == "faulty"
    assert (first["kind"], first["name"], first["place"]) == ("parameter", "M", "")
    assert first["value"]["value"] == pytest.approx(132.0, rel=0.05)


def test_a_dot_in_the_name_of_a_parameter_is_no_place_of_an_effect(axis):
    model = following(declaring(rs.fmu(axis).watched, DOTTED), DOTTED)
    (value,) = [h for h in hypotheses(model, model.free) if h.kind == "parameter"]
    assert (value.name, value.place, value.unit) == (DOTTED[0], "", "N*s/m")


def test_a_friction_that_the_fmu_lacks_is_named_or_in_its_group(watch):
    rubbing = SLIDING.with_effect("coulomb-friction", "axis", {"tau_c": 10.0})
    found = watch.score(window(104, rubbing)).found
    first = found.evidence["causes"][0]
    group = [f"{first['name']}@{first['place']}", *first["indistinguishable_from"]]
    assert found.verdict == "faulty"
    assert any(name.endswith("friction@v") for name in group)


def test_a_baseline_that_was_moved_judges_without_the_fmu_s_file(
    watch, baseline, tmp_path, capfd, axis
):
    moved = shutil.copy(baseline, tmp_path / "moved.npz")
    write_record(window(102, M=132.0), tmp_path / "window.csv")
    assert axis.read_bytes() == load_stored(moved, "model-based").arrays["fmu"].tobytes()
    words = ["score", "model-based", str(tmp_path / "window.csv"), "--baseline", str(moved)]
    assert run([*words, "--json"]) == ANSWER_IS_NO
    told = json.loads(capfd.readouterr().out)
    here = watch.score(window(102, M=132.0)).found
    assert told["causes"][0]["name"] == here.evidence["causes"][0]["name"] == "M"
    assert told["indicators"]["deviation"] == pytest.approx(here.indicators["deviation"], rel=1e-3)


def test_a_baseline_with_an_fmu_is_read_where_that_was_allowed(watch, baseline):
    with pytest.raises(Forbidden, match=r"holds an FMU, .* allow_fmus=True"):
        rs.load_monitor("model-based", baseline)
    loaded = rs.load_monitor("model-based", baseline, allow_fmus=True)
    assert loaded.score(window(101)).found.to_json() == watch.score(window(101)).found.to_json()


def test_another_fmu_than_it_was_trained_with_is_refused(baseline, tmp_path):
    changed = with_another_fmu(baseline, tmp_path / "changed.npz", b"another", digest=None)
    with pytest.raises(BadModel, match="the FMU in it is not the one that it was trained with"):
        rs.load_monitor("model-based", changed, allow_fmus=True)


def test_one_that_breaks_down_in_the_middle_ends_its_own_process_alone(
    axis, baseline, tmp_path, capfd
):
    fmu, out = aborting(axis, tmp_path), tmp_path / "b.npz"
    files = []
    for seed in range(6):
        files.append(str(tmp_path / f"{seed}.csv"))
        write_record(window(seed), files[-1])
    words = ["train", "model-based", *files, f"--model={fmu}", "--free", "M", "--out", str(out)]
    assert run(words) == BAD_INPUT
    assert "the FMU ended the process that ran it (SIGABRT)" in capfd.readouterr().err
    assert not out.exists()
    with open(fmu, "rb") as file:
        broken = with_another_fmu(baseline, tmp_path / "broken.npz", file.read())
    assert run(["score", "model-based", files[0], "--baseline", str(broken)]) == BAD_INPUT
    says = capfd.readouterr().err
    assert f"baseline '{broken}': the FMU ended the process that ran it (SIGABRT)" in says


def test_what_an_fmu_cannot_be_watched_by_is_said(axis, tmp_path):
    alone = rewritten(axis, tmp_path / "alone.fmu", xml=without_exchange)
    with pytest.raises(BadModel, match=r"can only simulate itself.*export it for model exchange"):
        rs.monitor(rs.fmu(alone)).fit([window(1)])
    with pytest.raises(BadInput, match=r"'force': is of the kind 'input'"):
        rs.monitor(rs.fmu(axis), free=["force"]).fit([window(1)])


def test_a_value_that_is_held_wrong_is_told_before_what_it_is_taken_for(axis):
    lighter = rs.fmu(axis)  # its mass of 95 kg is held; that of the machine is 110 kg
    watch = rs.monitor(lighter, free=DOTTED).fit([window(seed) for seed in range(6)])
    told = watch.diagnoser_.learned()
    (held,) = told["held_values"]
    assert (held["name"], held["held"], held["unit"]) == ("M", 95.0, "kg")
    assert held["value"] == pytest.approx(110.0, rel=0.02)
    taken = [f"{m['effect']}@{m['place']}" for m in told["missing_physics"]]
    assert held["as_much_as"] == tuple(taken) != ()
    at = [
        k for k, line in enumerate(told["says"]) if " held at " in line or "which the model" in line
    ]
    assert "M is held at 95 kg; healthy windows ask for 1" in told["says"][at[0]]
    assert "M is held at 95 kg" in watch.score(window(101)).reason
