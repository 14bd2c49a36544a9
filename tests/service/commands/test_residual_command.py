"""`residuum residual design` and `run`: the JSON of the contract, and refusals with exit status 2."""

import json

import numpy as np
import pytest

from residuum.identification.kernel_based.impulse_response import identify_impulse_response
from residuum.identification.linear_models.identified_model_file import save_identified
from residuum.identification.linear_models.transfer_function import TransferFunction
from residuum.identification.record import Record
from residuum.service.cli import run

PLANT = TransferFunction([0.5], [1.0, -0.9], 0.1)


def write(path, seed, n, offset=0.0, unit="m"):
    rng = np.random.default_rng(seed)
    u = rng.standard_normal(n)
    y = PLANT.simulate(u) + 0.3 * rng.standard_normal(n) + offset * (np.arange(n) >= n // 2)
    table = np.column_stack([0.1 * np.arange(n), u, y])
    np.savetxt(
        path, table, delimiter=",", header=f"time [s],u [V],y [{unit}]", comments="", fmt="%.9g"
    )
    return Record({"u": u, "y": y}, {"u": "V", "y": unit}, 0.1, source=str(path))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("residual")
    save_identified(
        identify_impulse_response(write(folder / "healthy.csv", 1, 4000), "u", "y", order=60),
        folder / "model.json",
    )
    write(folder / "good.csv", 2, 2000)
    write(folder / "bad.csv", 3, 2000, offset=1.0)
    assert run(["residual", "design", str(folder / "model.json"), "--out", str(folder / "d")]) == 0
    return folder


def answer(capsys, *arguments):
    capsys.readouterr()
    assert run(["residual", *map(str, arguments), "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def test_design_reports_what_it_verified(folder, capsys):
    result = answer(
        capsys, "design", folder / "model.json", "--out", folder / "other", "--fault", "actuator"
    )
    assert (
        result["stable"]
        and result["gamma_verified"] == pytest.approx(0.1)
        and result["gamma_on_grid"] <= 0.1 * (1 + 1e-9)
    )
    assert result["filter_order"] < result["full_order"] and result["healthy_samples"] == 4000
    assert result["fault"] == "actuator" and not result["structured_error"]["present"]
    noise = result["noise"]
    assert (
        noise["shape"] == 2.0
        and noise["tails"] == "Gaussian"
        and 3500 < noise["degrees_of_freedom"] < 4000
    )


@pytest.mark.parametrize("method", ["observer", "kalman", "parity", "h-infinity"])
def test_each_method_of_the_source_makes_a_detector(folder, capsys, method):
    made = answer(
        capsys,
        "design",
        folder / "model.json",
        "--out",
        folder / method,
        "--method",
        method,
        "--rule",
        "worst-case",
    )
    assert made["method"] == method and made["stable"] and made["beta"] > 0
    assert answer(capsys, "run", folder / method, folder / "good.csv")["alarm"] is False


def test_design_says_where_healthy_samples_contradict_every_usual_tail(folder, capsys):
    rng = np.random.default_rng(9)
    u = rng.standard_normal(20_000)
    y = PLANT.simulate(u) + 0.3 * np.clip(rng.standard_normal(20_000), -2.5, 2.5)
    table = np.column_stack([0.1 * np.arange(20_000), u, y])
    np.savetxt(
        folder / "clipped.csv",
        table,
        delimiter=",",
        header="time [s],u [V],y [m]",
        comments="",
        fmt="%.9g",
    )
    result = answer(
        capsys,
        "design",
        folder / "model.json",
        "--healthy",
        folder / "clipped.csv",
        "--out",
        folder / "clipped",
    )
    assert "no usual law fits" in result["noise"]["tails"] and " m " in result["noise"]["tails"]


@pytest.mark.parametrize("threshold", ["posterior", "peak", "source", "calibrated"])
def test_run_answers_in_the_contracts_words(folder, capsys, threshold):
    common = ["--threshold", threshold, "--false-alarms-per-day", "2"]
    healthy = answer(capsys, "run", folder / "d", folder / "good.csv", *common)
    assert (
        healthy["alarm"] is False
        and healthy["first_alarm_time"] is None
        and healthy["fault_estimate"] is None
    )
    assert (
        healthy["exceedances"] == 0
        and healthy["threshold_kind"] == threshold
        and healthy["threshold"] > 0
    )
    if threshold in ("posterior", "calibrated"):
        faulty = answer(capsys, "run", folder / "d", folder / "bad.csv", *common)
        assert (
            faulty["alarm"] is True
            and 100.0 <= faulty["first_alarm_time"] < 102.0
            and faulty["false_alarm_rate"] == 2.0
        )
        estimate = faulty["fault_estimate"]
        assert estimate["kind"] == "sensor-offset" and estimate["shape"] == "step"
        assert (faulty["false_alarm_rate_factor_95"] is not None) == (threshold == "posterior")
        assert (
            abs(estimate["value"] - 1.0) < 4 * estimate["std"]
            and abs(estimate["onset_time"] - 100.0) < 1.0
        )


def test_bad_input_is_exit_status_two_with_one_line(folder, capsys):
    write(folder / "kelvin.csv", 4, 500, unit="K")
    (folder / "nonsense").write_text("nonsense")
    cases = {
        "K": ["run", folder / "d", folder / "kelvin.csv"],
        "not a stored": ["run", folder / "nonsense", folder / "good.csv"],
        "no such file": ["design", folder / "absent.json", "--out", folder / "x"],
        "gamma": ["design", folder / "model.json", "--out", folder / "x", "--gamma", "-1"],
        "false-alarms-per-day 0: must be > 0": [
            "run",
            folder / "d",
            folder / "good.csv",
            "--false-alarms-per-day",
            "0",
        ],
        "does not exist": ["design", folder / "model.json", "--out", folder / "nowhere" / "x"],
    }
    for says, arguments in cases.items():
        capsys.readouterr()
        assert run(["residual", *map(str, arguments)]) == 2
        error = capsys.readouterr().err.strip().splitlines()
        assert says in error[-1], error


def test_text_says_what_the_fault_is_and_since_when(folder, capsys):
    table = np.loadtxt(folder / "good.csv", delimiter=",", skiprows=1)
    for name, first in (("stuck.csv", 1000), ("always.csv", 0)):
        stuck = table.copy()
        stuck[first:, 2] = stuck[first, 2]
        np.savetxt(
            folder / name,
            stuck,
            delimiter=",",
            header="time [s],u [V],y [m]",
            comments="",
            fmt="%.9g",
        )
    said = []
    for file in ("bad.csv", "stuck.csv", "always.csv"):
        capsys.readouterr()
        assert run(["residual", "run", str(folder / "d"), str(folder / file)]) == 0
        said.append(capsys.readouterr().out)
    assert "sensor-offset (step): 1.0" in said[0] and " m, since 100" in said[0]
    assert f"stuck-sensor: the reading stays at {table[1000, 2]:.6g} m, since 100 s" in said[1]
    assert "since before 6 s, the first that is judged" in said[2]


@pytest.fixture(scope="module")
def several(tmp_path_factory):
    """A model of two inputs and three outputs in a file, its record, and records with a fault."""
    folder = tmp_path_factory.mktemp("several")
    rng = np.random.default_rng(7)

    def record(path, offset=0.0, without=()):
        a, b = rng.standard_normal((2, 1500))
        rows = [(1.0, 0.5, 0.4, 0.8), (0.3, 0.7, 0.5, 0.6), (0.2, 0.6, 0.4, 0.5)]
        table = {"a": ("V", a), "b": ("V", b)}
        for i, (k, p, m, q) in enumerate(rows):
            y = TransferFunction([k], [1.0, -p], 0.1).simulate(a) + TransferFunction(
                [m], [1.0, -q], 0.1
            ).simulate(b)
            table[f"y{i}"] = (
                "m",
                y + 0.2 * rng.standard_normal(1500) + (i == 1) * offset * (np.arange(1500) >= 800),
            )
        kept = {name: column for name, column in table.items() if name not in without}
        header = ",".join(["time [s]", *(f"{name} [{unit}]" for name, (unit, _) in kept.items())])
        columns = np.column_stack([0.1 * np.arange(1500), *(column for _, column in kept.values())])
        np.savetxt(path, columns, delimiter=",", header=header, comments="", fmt="%.9g")

    record(folder / "healthy.csv")
    record(folder / "bad.csv", 0.5)
    record(folder / "blind.csv", 0.5, without=("b",))
    channels = [option for name in "ab" for option in ("--input", name)]
    channels += [option for i in range(3) for option in ("--output", f"y{i}")]
    model = folder / "model.json"
    assert (
        run(
            [
                "identify",
                str(folder / "healthy.csv"),
                *channels,
                "--order",
                "30",
                "--out",
                str(model),
            ]
        )
        == 0
    )
    return folder


def test_several_inputs_and_outputs_make_one_detector_that_names_the_sensor(several, capsys):
    made = answer(capsys, "design", several / "model.json", "--out", several / "d")
    assert made["method"] == "robust" and made["residuals"] == 3 and made["healthy_samples"] > 1400
    assert len(made["noise"]["innovation_std"]) == 3
    assert answer(capsys, "run", several / "d", several / "healthy.csv")["alarm"] is False
    found = answer(capsys, "run", several / "d", several / "bad.csv")
    assert found["alarm"] and found["first_alarm_time"] >= 80.0 and found["false_alarm_rate"] == 1.0
    fault = found["fault_estimate"]
    assert (fault["kind"], fault["place"], fault["unit"]) == ("sensor-offset", "y1", "m")
    assert fault["band_95"][0] < 0.5 < fault["band_95"][1]
    assert run(["residual", "run", str(several / "d"), str(several / "bad.csv")]) == 0
    assert "sensor-offset of y1" in capsys.readouterr().out


def test_an_unknown_input_observer_needs_no_record_of_that_input(several, capsys):
    options = ("--method", "unknown-input-observer", "--unknown-input", "b")
    made = answer(capsys, "design", several / "model.json", "--out", several / "u", *options)
    assert made["unknown_inputs"] == ["b"] and made["residuals"] == 2 and made["filter_order"] > 0
    assert (
        answer(capsys, "run", several / "u", several / "blind.csv")["fault_estimate"]["place"]
        == "y1"
    )


def test_what_belongs_to_one_kind_of_design_is_refused_of_the_other(several, folder, capsys):
    def refused(*arguments):
        capsys.readouterr()
        assert run(["residual", *map(str, arguments)]) == 2
        return capsys.readouterr().err

    answer(capsys, "design", several / "model.json", "--out", several / "d2")
    assert "threshold posterior alone" in refused(
        "run", several / "d2", several / "bad.csv", "--threshold", "peak"
    )
    assert "'b'" in refused("run", several / "d2", several / "blind.csv")
    one = ("design", folder / "model.json", "--out", folder / "no")
    assert "several outputs" in refused(*one, "--method", "unknown-input-observer")
    assert "several outputs" in refused(*one, "--unknown-input", "u")
    assert not (folder / "no").exists()
