"""FMUs as models: held against records as the model they were made of, refused before they are loaded, and run apart."""

import json
import re

import numpy as np
import pytest

import residuum as rs
from residuum.identification.errors import BadModel
from residuum.identification.physics import Experiment, Simulator, load_model
from residuum.identification.physics.fmu.description import Description, describe
from residuum.identification.physics.fmu.instance import Instance
from residuum.identification.record import Record
from residuum.identification.record_formats import write_record
from residuum.service.cli import BAD_INPUT, DONE, run
from tests.identification.physics.fmu_files import (
    exported,
    recompiled,
    rewritten,
    without_exchange,
)

pytest.importorskip("fmpy")
DT, N = 0.01, 800


@pytest.fixture(scope="module")
def rubbing(tmp_path_factory):
    """An axis with dry friction, as recorded."""
    model = load_model("linear-axis").with_effect("coulomb-friction", "axis", {"tau_c": 20.0})
    rng = np.random.default_rng(4)
    U = np.repeat(rng.uniform(-90.0, 90.0, (N // 40, 1)), 40, axis=0)
    Y = Simulator(model).run(Experiment(U, np.full((N, 2), np.nan), np.zeros(1), DT), substeps=20).Y
    Y = Y + rng.normal(scale=[1e-4, 1e-3], size=Y.shape)
    file = tmp_path_factory.mktemp("record") / "axis.csv"
    units = {"force": "N", "position": "m", "velocity": "m/s"}
    write_record(
        Record({"force": U[:, 0], "position": Y[:, 0], "velocity": Y[:, 1]}, units, DT), file
    )
    return str(file)


@pytest.fixture(scope="module")
def axis(tmp_path_factory):
    """The axis without friction, as an FMU."""
    return exported(load_model("linear-axis"), tmp_path_factory.mktemp("fmu") / "axis.fmu")


def answer(capfd, *arguments):
    assert run([*arguments, "--json"]) == DONE
    return json.loads(capfd.readouterr().out)


def test_an_fmu_is_compared_as_the_model_that_it_was_made_of(axis, rubbing, capfd):
    ours = answer(capfd, "compare", "linear-axis", rubbing)
    theirs = answer(capfd, "compare", str(axis), rubbing)
    for name in ("position", "velocity"):
        assert theirs["outputs"][name]["rmse"] == pytest.approx(
            ours["outputs"][name]["rmse"], rel=1e-4
        )
    assert theirs["structured_error"]["present"]
    assert theirs["balances"]["v"]["unit"] == "m/s/s"


def test_the_friction_that_an_fmu_lacks_is_named(axis, rubbing, capfd):
    told = answer(
        capfd,
        "explain",
        str(axis),
        rubbing,
        "--effects",
        "coulomb-friction,viscous-friction,quadratic-drag,constant-load",
    )
    first = told["candidates"][0]
    assert (first["effect"], first["balance"]) == ("coulomb-friction", "v")
    assert first["parameters"]["tau_c"]["value"] == pytest.approx(20.0 / 95.0, rel=0.03)


def test_warnings_are_no_failure_however_many(axis, rubbing, tmp_path, capfd):
    def warns(source):
        body = re.compile(r"(fmi2Status fmi2(?:Set|Get)\w+\(.*?\n?\{.*?return )fmi2OK;", re.DOTALL)
        return body.sub(r"\1fmi2Warning;", source)

    warning = recompiled(axis, tmp_path / "warning.fmu", tmp_path / "made", warns)
    told = [answer(capfd, "compare", str(fmu), rubbing)["outputs"] for fmu in (axis, warning)]
    assert told[0] == told[1]


def test_one_that_can_only_simulate_itself_is_compared_by_its_outputs(
    axis, rubbing, tmp_path, capfd
):
    file = rewritten(axis, tmp_path / "alone.fmu", xml=without_exchange)
    told = answer(capfd, "compare", file, rubbing)
    assert told["outputs"]["velocity"]["rmse"] > 0.01 and not told["balances"]


def test_another_platforms_is_refused_before_it_is_loaded(axis, rubbing, tmp_path, capfd):
    file = rewritten(axis, tmp_path / "other.fmu", lambda name: name.replace("linux64", "win64"))
    assert run(["compare", file, rubbing]) == BAD_INPUT
    assert "has libraries for win64, none for linux64" in capfd.readouterr().err


def test_one_that_breaks_down_ends_its_own_process_alone(axis, rubbing, tmp_path, capfd):
    file = recompiled(
        axis,
        tmp_path / "break.fmu",
        tmp_path,
        lambda source: source.replace("if (m) reset(m);", "abort();"),
    )
    assert run(["compare", file, rubbing]) == BAD_INPUT
    assert "the FMU ended the process that ran it (SIGABRT)" in capfd.readouterr().err


def test_fmus_in_one_process_are_not_taken_for_one_another(axis, rubbing, tmp_path):
    heavy = exported(load_model("linear-axis").with_values({"M": 190.0}), tmp_path / "heavy.fmu")
    copied = tmp_path / "copied.fmu"
    copied.write_bytes(axis.read_bytes())
    models = [rs.fmu(axis), rs.fmu(heavy), rs.fmu(copied).with_values(M=150.0)]
    expected = [
        rs.model("linear-axis")
        .with_values(M=mass)
        .compare(rubbing)
        .to_dict()["outputs"]["velocity"]["rmse"]
        for mass in (95.0, 190.0, 150.0)
    ]
    assert len(set(expected)) == 3
    for _ in range(2):
        for model, rmse in zip(models, expected, strict=True):
            told = model.compare(rubbing).to_dict()["outputs"]["velocity"]["rmse"]
            assert told == pytest.approx(rmse, rel=1e-4)


@pytest.mark.parametrize(
    ("content", "says"), [(b"no zip", "is not an FMU"), (None, "no such file")]
)
def test_what_is_no_fmu_is_refused(tmp_path, content, says):
    file = tmp_path / "x.fmu"
    if content:
        file.write_bytes(content)
    with pytest.raises(BadModel, match=says):
        describe(file)


@pytest.mark.parametrize("exchanged, way", [(True, "model exchange"), (False, "co-simulation")])
def test_a_way_that_an_fmu_does_not_offer_is_refused(exchanged, way):
    described = Description("axis.fmu", "axis", 2, "{1}", (), (), (), (), 0, None, None)
    with pytest.raises(BadModel, match=f"'axis.fmu': the FMU does not offer {way}"):
        Instance(described, exchanged=exchanged)


def test_other_commands_say_who_takes_an_fmu(axis, rubbing, capfd):
    assert run(["export", str(axis), "--to", "c", "--out", "/tmp/x.c"]) == BAD_INPUT
    assert "compare, explain, improve, estimate and train take it" in capfd.readouterr().err
