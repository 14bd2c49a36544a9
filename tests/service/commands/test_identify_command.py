import json

import numpy as np
import pytest
from scipy import signal

from residuum.identification.errors import BadModel
from residuum.identification.kernel_based.multivariable import load_multivariable
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
    write_record(
        Record(
            {"voltage": u, "speed": y},
            {"voltage": "V", "speed": "rad/s"},
            0.1,
            notes=("split: 0.8",),
        ),
        path,
    )
    return path


def identify(record_file, *options):
    return run(["identify", str(record_file), "--input", "voltage", "--output", "speed", *options])


@pytest.mark.parametrize("kernel", ["tc", "ss"])
def test_json_has_the_contract_and_the_truth(record_file, tmp_path, capsys, kernel):
    out = tmp_path / "model.json"
    assert (
        identify(
            record_file,
            "--order",
            "60",
            "--delay",
            "1",
            "--kernel",
            kernel,
            "--out",
            str(out),
            "--json",
        )
        == DONE
    )
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
    assert identify(record_file, "--order", "40", "--delay", "1", "--json") == DONE
    result = json.loads(capsys.readouterr().out)
    assert result["samples"] == 1200 - 40 - 12  # order and tail need their past
    assert result["held_out_fit_percent"][0] == pytest.approx(result["fit_percent"][0], abs=3)


def test_delay_is_estimated_where_none_is_said(record_file, capsys):
    assert identify(record_file, "--order", "40", "--json") == DONE
    estimated = capsys.readouterr()
    assert json.loads(estimated.out)["delay"] == 3 and estimated.err == ""
    assert identify(record_file, "--order", "40", "--delay", "estimate", "--json") == DONE
    as_before = capsys.readouterr()
    assert json.loads(as_before.out)["delay"] == 3
    assert as_before.err == "--delay 'estimate': will not be read much longer; leave it out\n"


def test_order_is_chosen_on_held_out_blocks_on_request(record_file, capsys):
    orders = {}
    for criterion in ("bic", "k-fold"):
        assert (
            identify(
                record_file, "--method", "arx", "--criterion", criterion, "--delay", "3", "--json"
            )
            == DONE
        )
        orders[criterion] = len(json.loads(capsys.readouterr().out)["denominator"])
    # white output noise is no ARX: held-out blocks pay for more lags than BIC grants
    assert orders["k-fold"] > orders["bic"]


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
        (["--delay", "-3"], "--delay -3: must be ≥ 0"),
        (["--delay", "soon"], "--delay 'soon': must be a whole number"),
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


@pytest.mark.parametrize("method", ["ridge", "lasso"])
def test_penalised_impulse_responses_find_the_truth(record_file, capsys, method):
    assert (
        identify(record_file, "--order", "40", "--delay", "1", "--method", method, "--json") == DONE
    )
    result = json.loads(capsys.readouterr().out)
    truth = np.concatenate([[0, 0], 0.8 ** np.arange(38)])
    assert np.linalg.norm(result["impulse_response"] - truth) < 0.1 * np.linalg.norm(truth)
    assert result["hyper_parameters"]["strength"] > 0


def test_a_time_series_has_no_input(record_file, tmp_path, capsys):
    file, rng = tmp_path / "series.csv", np.random.default_rng(3)
    v = signal.lfilter([1.0], [1.0, -0.7], 0.5 * rng.standard_normal(2000))
    write_record(Record({"v": v}, {"v": "mm"}, 0.1), file)
    assert run(["identify", str(file), "--output", "v", "--method", "ar", "--order", "1"]) == DONE
    said = capsys.readouterr().out
    assert "A = [1, -0.7" in said and "innovation        0.4" in said
    assert (
        run(
            [
                "identify",
                str(record_file),
                "--input",
                "voltage",
                "--output",
                "speed",
                "--method",
                "ar",
            ]
        )
        == BAD_INPUT
    )
    assert "models an output alone" in capsys.readouterr().err
    assert run(["identify", str(record_file), "--output", "speed"]) == BAD_INPUT
    assert "needs an input" in capsys.readouterr().err


def test_uncertainty_from_an_error_model_is_larger_than_the_estimates_own(record_file, capsys):
    spread = {}
    for choice in ("own", "model-error", "set-membership"):
        assert (
            identify(
                record_file,
                "--method",
                "oe",
                "--order",
                "1",
                "--delay",
                "1",
                "--uncertainty",
                choice,
                "--json",
            )
            == DONE
        )
        spread[choice] = np.linalg.norm(json.loads(capsys.readouterr().out)["std"])
    assert min(spread["model-error"], spread["set-membership"]) > 3 * spread["own"]
    assert identify(record_file, "--noise-bound", "1") == BAD_INPUT
    assert "is used by the uncertainty set-membership alone" in capsys.readouterr().err
    assert identify(record_file, "--uncertainty", "guess") == BAD_INPUT
    assert "known are own, model-error" in capsys.readouterr().err


def test_several_inputs_and_outputs_make_one_model_of_every_path(tmp_path, capsys):
    rng = np.random.default_rng(5)
    valve, heater = rng.standard_normal((2, 1500))
    level = (
        signal.lfilter([0, 1.0], [1, -0.5], valve)
        - signal.lfilter([0, 0.2], [1, -0.5], heater)
        + 0.1 * rng.standard_normal(1500)
    )
    warmth = signal.lfilter([0, 0.5], [1, -0.7], heater) + 0.1 * rng.standard_normal(1500)
    channels = {"valve": valve, "heater": heater, "level": level, "warmth": warmth}
    units = {"valve": "%", "heater": "kW", "level": "m", "warmth": "K"}
    file, out = tmp_path / "plant.csv", tmp_path / "plant.json"
    write_record(Record(channels, units, 1.0, notes=("split: 0.8",)), file)
    names = [option for name in ("valve", "heater") for option in ("--input", name)]
    names += [option for name in ("level", "warmth") for option in ("--output", name)]
    assert (
        run(["identify", str(file), *names, "--order", "25", "--out", str(out), "--json"]) == DONE
    )
    found = json.loads(capsys.readouterr().out)
    np.testing.assert_allclose(found["static_gain"], [[2.0, -0.4], [0.0, 0.5 / 0.3]], atol=0.1)
    np.testing.assert_allclose(np.sum(found["relative_gains"], axis=0), 1.0)
    assert found["held_out_fit_percent"][0]["level"] > 80
    read = load_multivariable(out)
    assert (read.inputs, read.outputs) == (("valve", "heater"), ("level", "warmth"))
    np.testing.assert_array_equal(
        read.models[0][1].impulse_response, found["impulse_responses"][0][1]
    )
    assert run(["identify", str(file), *names, "--method", "arx"]) == BAD_INPUT
    assert "need the method kernel" in capsys.readouterr().err
    (tmp_path / "wrong.json").write_text(out.read_text().replace("covariances", "covariance"))
    with pytest.raises(BadModel, match="covariances"):
        load_multivariable(tmp_path / "wrong.json")


@pytest.mark.parametrize("method", ["elastic-net", "set-membership", "stochastic-embedding"])
def test_other_views_of_the_error_are_methods_as_well(record_file, capsys, method):
    assert (
        identify(record_file, "--order", "30", "--delay", "3", "--method", method, "--json") == DONE
    )
    result = json.loads(capsys.readouterr().out)
    truth = 0.8 ** np.arange(30)
    assert np.linalg.norm(result["impulse_response"] - truth) < 0.3 * np.linalg.norm(truth)
    assert result["method"] == method


def test_check_tests_what_was_kept_aside_and_tells_the_error_on_new_data(record_file, capsys):
    assert (
        identify(record_file, "--method", "oe", "--order", "1", "--delay", "3", "--check", "--json")
        == DONE
    )
    check = json.loads(capsys.readouterr().out)["check"]
    assert check["passed"]
    assert check["parts"][0]["samples"] == 300
    assert check["parts"][0]["whiteness"] is None
    assert check["parts"][0]["input_correlation"]["passed"]
    assert not check["parts"][0]["model_error"]["falsified"]
    assert check["bootstrap"]["error"] == pytest.approx(0.04, rel=0.2)
    assert (
        identify(record_file, "--method", "arx", "--order", "1", "--delay", "3", "--check") == DONE
    )
    said = capsys.readouterr().out
    assert "white: no (p" in said
    assert "falsified at" in said
    assert "by the .632+ bootstrap of" in said


def test_check_and_noise_bound_are_refused_where_they_mean_nothing(record_file, capsys):
    assert (
        run(["identify", str(record_file), "--output", "speed", "--method", "ar", "--check"])
        == BAD_INPUT
    )
    assert "needs a model with an input" in capsys.readouterr().err
    both = ["--input", "voltage", "--output", "speed", "--output", "voltage"]
    assert run(["identify", str(record_file), *both, "--check"]) == BAD_INPUT
    assert "no check" in capsys.readouterr().err


def test_the_static_gain_is_in_every_answer_as_it_is_said(record_file, tmp_path, capsys):
    assert identify(record_file, "--method", "oe", "--order", "1", "--json") == DONE
    gain = json.loads(capsys.readouterr().out)["static_gain"]
    assert abs(gain["value"] - 5.0) < 4 * gain["std"] < 0.5
    assert (gain["unit"], gain["unknown"], gain["formal"]) == ("rad/s/V", None, False)
    assert identify(record_file, "--method", "oe", "--order", "1") == DONE
    assert (
        f"static gain       {gain['value']:.4g} ± {gain['std']:.2g} rad/s/V"
        in capsys.readouterr().out
    )


def test_a_gain_that_is_not_told_is_null_with_its_reason(tmp_path, capsys):
    rng = np.random.default_rng(0)
    u = np.repeat(rng.choice([-1.0, 1.0], 60), 25)
    y = np.cumsum(0.1 * np.r_[0.0, u[:-1]]) + 0.01 * rng.standard_normal(1500)
    write_record(
        Record({"voltage": u, "speed": y}, {"voltage": "V", "speed": "rad/s"}, 0.1),
        tmp_path / "i.csv",
    )
    options = ("--method", "bj", "--integrator")
    assert identify(tmp_path / "i.csv", *options, "--json") == DONE
    gain = json.loads(capsys.readouterr().out)["static_gain"]
    assert (
        gain["value"] is None
        and gain["std"] is None
        and gain["unknown"].startswith("none: the model integrates 0.")
    )
    assert identify(tmp_path / "i.csv", *options) == DONE
    assert f"static gain       {gain['unknown']}" in capsys.readouterr().out


def test_bands_of_an_order_that_the_data_chose_say_so(record_file, capsys):
    for method in ("arx", "oe"):
        assert identify(record_file, "--method", method, "--json") == DONE
        said = json.loads(capsys.readouterr().out)["std_says"]
        assert "orders that bic chose from the data (n" in said and said.endswith(
            "say `order` where it is known"
        )
        assert identify(record_file, "--method", method, "--order", "1", "--json") == DONE
        assert json.loads(capsys.readouterr().out)["std_says"] is None
