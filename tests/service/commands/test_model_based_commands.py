"""`train model-based` and `score model-based`, and the same over HTTP."""

import json

import pytest

from residuum.diagnosis.diagnosers.model_based import ModelBased
from residuum.identification.physics import load_model, write_model
from residuum.identification.record_formats import write_record
from residuum.service.cli import run
from residuum.service.fieldbus.settings import MachineSettings


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("model-based")
    example = ModelBased.examples()[0]
    for k, record in enumerate(example.training[:8]):
        write_record(record, folder / f"healthy{k}.csv")
    write_record(example.faulty[0], folder / "faulty.csv")
    write_record(example.healthy[0], folder / "healthy.csv")
    (folder / "press.yaml").write_text(write_model(load_model("linear-axis")), encoding="utf-8")
    return folder


def told(arguments, capsys, status=0):
    assert run(arguments) == status
    return json.loads(capsys.readouterr().out)


def test_a_model_file_and_healthy_records_make_a_baseline_that_names_causes(files, capsys):
    healthy = [str(files / f"healthy{k}.csv") for k in range(8)]
    model, base = str(files / "press.yaml"), str(files / "base")
    trained = told(
        ["train", "model-based", *healthy, "--model", model, "--out", base, "--json"], capsys
    )
    assert trained["windows"] == 8 and trained["parameters"]["M"]["value"] == pytest.approx(
        95.0, rel=0.02
    )
    found = told(
        ["score", "model-based", str(files / "faulty.csv"), "--baseline", base, "--json"],
        capsys,
        status=1,
    )
    first = found["causes"][0]
    assert found["verdict"] == "faulty" and "M" in (first["name"], *first["indistinguishable_from"])
    assert set(first) >= {
        "kind",
        "name",
        "place",
        "probability",
        "indistinguishable_from",
        "value",
        "healthy",
        "onset_time",
        "says",
    }
    assert (
        set(found["parameters"]["M"]) == {"value", "std", "unit", "healthy"}
        and found["false_alarms_per_day"] == 1.0
    )
    seldom = [
        "score",
        "model-based",
        str(files / "healthy.csv"),
        "--baseline",
        base,
        "--false-alarms-per-day",
        "0.1",
        "--json",
    ]
    fine = told(seldom, capsys)
    assert (
        fine["verdict"] == "healthy"
        and fine["causes"] == []
        and fine["false_alarms_per_day"] == 0.1
    )


def test_a_setting_of_models_is_refused_for_other_diagnosers(files, capsys):
    assert (
        run(
            [
                "train",
                "bearing",
                str(files / "faulty.csv"),
                "--model",
                "oven",
                "--out",
                str(files / "x"),
            ]
        )
        == 2
    )
    assert "only the model-based diagnoser" in capsys.readouterr().err


def test_a_machine_names_its_model_in_the_settings():
    sources = [{"kind": "can", "channel": "virtual:a", "map": "a.dbc"}]
    machine = {
        "asset": "press",
        "model": "press.yaml",
        "window": {"cut": "sliding"},
        "sources": sources,
    }
    assert MachineSettings(diagnoser="model-based", **machine).model == "press.yaml"
    with pytest.raises(ValueError, match="only the diagnoser model-based"):
        MachineSettings(diagnoser="bearing", **machine)
