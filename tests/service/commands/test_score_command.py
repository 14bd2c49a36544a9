"""`residuum score`: its exit status is its answer, and without a baseline it does not speak of health."""

import json

from residuum.diagnosis.diagnosers.bearing import Bearing
from residuum.identification.record_formats.npz import write_npz
from residuum.service.cli import ANSWER_IS_NO, DONE, run

ORDERS = ["--orders", "bpfi=5.4152,bpfo=3.5848,bsf=2.357,ftf=0.398"]


def test_the_exit_status_says_whether_a_window_is_faulty(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    example = Bearing.examples()[0]
    files = {
        "healthy.npz": example.healthy[0],
        "faulty.npz": example.faulty[1],
        "training.npz": example.training[0],
    }
    for name, record in files.items():
        write_npz(record, name)
    assert run(["train", "bearing", "training.npz", *ORDERS, "--out", "base"]) == DONE
    capsys.readouterr()
    for baseline, calm in ([], "not-assessable"), (["--baseline", "base"], "healthy"):
        asked = baseline or ORDERS
        for windows, status, verdict in (
            (["healthy.npz"], DONE, calm),
            (["faulty.npz"], ANSWER_IS_NO, "faulty"),
            (["healthy.npz", "faulty.npz"], ANSWER_IS_NO, "faulty"),
        ):
            assert run(["score", "bearing", *windows, *asked, "--json"]) == status
            assert json.loads(capsys.readouterr().out)["verdict"] == verdict
    assert run(["score", "bearing", "healthy.npz", *ORDERS]) == DONE
    said = capsys.readouterr().out
    assert (
        "health cannot be told; no absolute limit is passed: kurtosis" in said
        and "healthy records for a baseline" in said
    )
