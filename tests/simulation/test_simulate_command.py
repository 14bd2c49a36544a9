"""`residuum simulate`: files without the truth, a report with it, one line for what is wrong."""

import json

import numpy as np
import pytest

from residuum.identification.record_formats import read_record
from residuum.service.cli import run


def test_the_file_holds_the_record_and_the_report_holds_the_truth(tmp_path, capsys):
    file = tmp_path / "drive.csv"
    arguments = [
        "gate-drive",
        "--out",
        str(file),
        "--effect",
        "coulomb-friction:tau_c=0.03",
        "--duration",
        "2",
        "--json",
    ]
    assert run(["simulate", *arguments]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["truth"]["effects"] == {"coulomb-friction": {"tau_c": 0.03}}
    record = read_record(file)
    assert dict(record.units) == {"voltage": "V", "speed": "rad/s", "current": "A"}
    assert (record.n, record.sample_time) == (1000, pytest.approx(0.002))
    assert "coulomb" not in file.read_text()
    assert run(["simulate", *arguments, "--reveal"]) == 0
    assert "coulomb-friction" in file.read_text()


def test_npz_and_csv_hold_the_same_numbers(tmp_path):
    for ending in ("csv", "npz"):
        assert (
            run(
                [
                    "simulate",
                    "process-plant",
                    "--out",
                    str(tmp_path / f"p.{ending}"),
                    "--fault",
                    "sensor-offset:3",
                ]
            )
            == 0
        )
    csv, npz = (read_record(tmp_path / f"p.{ending}") for ending in ("csv", "npz"))
    np.testing.assert_allclose(csv["y"], npz["y"], rtol=1e-8)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["toaster"], "known are gate-actuator"),
        (["process", "--fault", "magic"], "known are sensor-offset"),
        (["gate-drive", "--effect", "magic"], "known are viscous-friction"),
        (["gate-drive", "--effect", "coulomb-friction:mu=1"], "known are tau_c"),
        (["gate-drive", "--effect", "coulomb-friction:tau_c=x"], "'x' is not a number"),
        (
            ["gate-drive", "--effect", "coulomb-friction:huge"],
            "must be par=value, or one of small, medium, large",
        ),
        (["process", "--profile", "rich"], "has no setting 'profile'"),
        (["gate-actuator", "--set", "wear=9"], "must be between 0 and 1"),
        (["gate-actuator", "--set", "wear"], "must have the form NAME=VALUE"),
        (["process", "--duration", "1e12"], "must be ≤ 1000000"),
        (["gate-drive", "--duration", "1e6"], "at most 5e+07"),
        (["process", "--duration", "-1"], "must be > 0"),
        (["gate-actuator", "--event", "earthquake"], "known are cut-short"),
    ],
)
def test_bad_requests_end_with_status_two_and_one_line(arguments, says, tmp_path, capsys):
    file = tmp_path / "x.csv"
    assert run(["simulate", *arguments, "--out", str(file)]) == 2
    error = capsys.readouterr().err
    assert says in error
    assert error.count("\n") == 1
    assert not file.exists()
