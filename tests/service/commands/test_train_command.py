"""`residuum train`: labels and exemplars of the records from one file."""

import json
from pathlib import Path

import pytest

from residuum.diagnosis.diagnosers.gate_actuator import GateActuator, example_record
from residuum.diagnosis.diagnosers.robust_residual import RobustResidual
from residuum.diagnosis.learning.labels_file import read_labels
from residuum.identification.errors import BadInput
from residuum.identification.record_formats.npz import write_npz
from residuum.service.cli import ANSWER_IS_NO, BAD_INPUT, run

RECORDS = [Path("here/a.npz"), Path("b.npz")]


def labels_file(tmp_path, text):
    file = tmp_path / "labels.csv"
    file.write_text(text)
    return file


def test_labels_come_by_name_or_path_with_or_without_a_header_and_an_exemplar(tmp_path):
    both = labels_file(tmp_path, "record,label\n# a note\nb.npz, rack\nhere/a.npz,healthy\n")
    assert read_labels(both, RECORDS) == (["healthy", "rack"], None)
    three = labels_file(
        tmp_path, "record,label,exemplar\na.npz,healthy,gate 1\nb.npz,rack,gate 2\n"
    )
    assert read_labels(three, RECORDS) == (["healthy", "rack"], ["gate 1", "gate 2"])


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("a.npz\n", "row 1: must be record,label"),
        ("a.npz,healthy\nb.npz,rack,gate 2\n", "row 2: .* the same in every row"),
        ("a.npz,healthy\n", "has no label for b.npz"),
    ],
)
def test_a_labels_file_that_says_too_little_is_refused(tmp_path, text, match):
    with pytest.raises(BadInput, match=match):
        read_labels(labels_file(tmp_path, text), RECORDS)


def test_movements_of_two_actuators_are_counted_as_two(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    files = [f"{k}.npz" for k in range(6)]
    for k, file in enumerate(files):
        write_npz(example_record("healthy", k), file)
    labels_file(tmp_path, "".join(f"{k}.npz,healthy,gate {k // 3}\n" for k in range(6)))
    told = ["--labels", "labels.csv", "--out", "gate"]
    assert run(["train", "gate-actuator", *files, *told]) == 0
    assert GateActuator.load("gate").baseline.exemplars == 2
    assert run(["train", "gripping-pliers", *files, *told]) == BAD_INPUT
    assert "only the gate-actuator diagnoser knows exemplars" in capsys.readouterr().err


def test_actuators_left_out_in_turn_are_judged_by_the_others(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    files = [f"{k}.npz" for k in range(6)]
    for k, file in enumerate(files):
        write_npz(example_record("healthy", k), file)
    labels_file(tmp_path, "".join(f"{k}.npz,healthy,gate {k // 2}\n" for k in range(6)))
    told = ["--labels", "labels.csv", "--out", "gate", "--validate", "object-wise"]
    capsys.readouterr()
    assert run(["train", "gate-actuator", *files, *told, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)["validation"]
    assert (
        found["how"] == "object-wise"
        and found["objects"] == 3
        and sum(map(sum, found["confusion"])) == 6
    )
    assert found["accuracy"] >= 5 / 6


def test_either_method_decides_and_both_are_shown(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    example = RobustResidual.examples()[0]
    write_npz(example.training[0], "healthy.npz")
    write_npz(example.faulty[1], "drift.npz")
    assert (
        run(["train", "robust-residual", "healthy.npz", "--method", "source", "--out", "plant"])
        == 0
    )
    capsys.readouterr()
    said = {}
    for method in ([], ["--method", "source"], ["--method", "default"]):
        status = run(
            ["score", "robust-residual", "drift.npz", "--baseline", "plant", *method, "--json"]
        )
        finding = said[" ".join(method)] = json.loads(capsys.readouterr().out)
        assert status == (ANSWER_IS_NO if finding["verdict"] == "faulty" else 0)
    assert said[""] == said["--method source"]
    assert said["--method source"]["thresholds"].keys() == {"robust_peak"}
    assert said["--method default"]["thresholds"].keys() == {"glr"}
    for finding in said.values():
        evidence = finding["evidence"]
        assert finding["verdict"] == evidence[f"{evidence['method']}_method"]["verdict"]
    assert (
        run(["score", "robust-residual", "drift.npz", "--baseline", "plant", "--method", "best"])
        == BAD_INPUT
    )
    assert "must be default or source" in capsys.readouterr().err
