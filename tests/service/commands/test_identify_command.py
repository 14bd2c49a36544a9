import json

import numpy as np
import pytest
from scipy import signal

from residuum.identification.linear_models.identified_model_file import load_identified
from residuum.identification.record import Record
from residuum.identification.record_formats import write_record
from residuum.service.cli import BAD_INPUT, DONE, run

CONTRACT = {
    "method",
    "order",
    "sample_time",
    "impulse_response",
    "std",
    "hyper_parameters",
    "noise_variance",
    "negative_log_likelihood",
    "seconds",
}


@pytest.fixture
def record_file(tmp_path):
    rng = np.random.default_rng(0)
    u = rng.standard_normal(1500)
    y = 7 + signal.lfilter([0, 0, 0, 1.0], [1, -0.8], u) + 0.2 * rng.standard_normal(1500)
    path = tmp_path / "plant.csv"
    write_record(Record({"voltage": u, "speed": y}, {"voltage": "V", "speed": "rad/s"}, 0.1, notes=("split: 0.8",)), path)
    return path


def identify(record_file, *options):
    return run(["identify", str(record_file), "--input", "voltage", "--output", "speed", *options])


@pytest.mark.parametrize("kernel", ["tc", "ss"])
def test_json_has_the_contract_and_the_truth(record_file, tmp_path, capsys, kernel):
    out = tmp_path / "model.json"
    assert identify(record_file, "--order", "60", "--kernel", kernel, "--out", str(out), "--json") == DONE
    result = json.loads(capsys.readouterr().out)
    assert set(result) >= CONTRACT
    assert (result["method"], result["order"], result["sample_time"]) == ("kernel", 60, 0.1)
    truth = np.concatenate([[0, 0], 0.8 ** np.arange(58)])
    assert np.linalg.norm(result["impulse_response"] - truth) < 0.08 * np.linalg.norm(truth)
    assert result["noise_variance"] == pytest.approx(0.04, rel=0.15)
    model = load_identified(out)
    np.testing.assert_array_equal(model.impulse_response, result["impulse_response"])
    np.testing.assert_allclose(model.std, result["std"])
    assert (model.input_unit, model.output_unit) == ("V", "rad/s")


def test_text_has_units_where_the_record_has_them(record_file, tmp_path, capsys):
    assert identify(record_file, "--order", "40") == DONE
    said = capsys.readouterr().out
    assert "voltage [V] → speed [rad/s]" in said and " rad/s/V (one standard deviation)" in said
    bare = tmp_path / "bare.csv"
    text = record_file.read_text().replace(" [V]", "").replace(" [rad/s]", "")
    bare.write_text(text)
    assert identify(bare, "--order", "40") == DONE
    said = capsys.readouterr().out
    assert "voltage → speed" in said and "[]" not in said and "1/1" not in said


def test_split_keeps_the_rest_for_validation(record_file, capsys):
    assert identify(record_file, "--order", "40", "--json") == DONE
    result = json.loads(capsys.readouterr().out)
    assert result["samples"] == 1200 - 40 - 12  # order and tail need their past
    assert result["held_out_fit_percent"][0] == pytest.approx(result["fit_percent"][0], abs=3)


def test_delay_is_estimated_on_request(record_file, capsys):
    assert identify(record_file, "--order", "40", "--delay", "estimate", "--json") == DONE
    assert json.loads(capsys.readouterr().out)["delay"] == 3


def test_order_is_chosen_on_held_out_blocks_on_request(record_file, capsys):
    orders = {}
    for criterion in ("bic", "k-fold"):
        assert identify(record_file, "--method", "arx", "--criterion", criterion, "--delay", "3", "--json") == DONE
        orders[criterion] = len(json.loads(capsys.readouterr().out)["denominator"])
    assert orders["k-fold"] > orders["bic"]  # white output noise is no ARX: held-out blocks pay for more lags than BIC grants


def test_human_report_carries_units_and_uncertainty(record_file, tmp_path, capsys):
    assert identify(record_file, "--order", "60", "--out", str(tmp_path / "m.json")) == DONE
    text = capsys.readouterr().out
    assert "voltage [V] → speed [rad/s]" in text
    assert "rad/s/V" in text
    assert "±" in text
    assert "held-out fit" in text


@pytest.mark.parametrize(
    ("options", "match"),
    [
        (["--kernel", "rbf"], "known are tc, dc, ss, di"),
        (["--method", "magic"], "'magic': there is none"),
        (["--method", "oe", "--criterion", "cv"], "known are bic, aic, k-fold, record-wise"),
        (["--method", "oe", "--criterion", "record-wise"], "record-wise: has one record"),
        (["--order", "5000"], "samples in a row"),
        (["--delay", "-3"], "--delay '-3'"),
        (["--noise-variance", "guess"], "must be a number or one of"),
        (["--out", "/nowhere/m.json"], "folder '/nowhere' does not exist"),
        (["--output", "torque"], "no channel 'torque'"),
    ],
)
def test_bad_requests_are_one_line_and_status_two(record_file, capsys, options, match):
    assert identify(record_file, *options) == BAD_INPUT
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.count("\n") == 1
    assert match in captured.err
