"""Results are values: their text and JSON are the command line's, their pictures show what was computed."""

import json
import sys
from itertools import pairwise

import numpy as np
import pytest

import residuum as rs
from residuum.library.picture import Bars, Curve, Panel, Picture
from residuum.library.svg import svg
from residuum.service.cli import DONE, run

TIMES = ("seconds",)


@pytest.fixture(scope="module")
def pushed(tmp_path_factory):
    """A record file of an axis with friction, and the model of its mass alone."""
    path = tmp_path_factory.mktemp("axis") / "axis.csv"
    rng = np.random.default_rng(1)
    force = 60.0 * np.sign(np.sin(2.0 * np.pi * 0.4 * 0.01 * np.arange(1500)))
    truth = (
        rs.model("linear-axis").with_values(M=95.0).with_effect("viscous-friction", "axis", d=40.0)
    )
    clean = rs.from_arrays({"force": force}, units={"force": "N"}, sample_time=0.01)
    out = truth.simulate(clean)
    velocity, position = (
        out["velocity"] + 2e-3 * rng.standard_normal(1500),
        out["position"] + 1e-3 * rng.standard_normal(1500),
    )
    channels = {"force": force, "position": position, "velocity": velocity}
    rs.from_arrays(channels, units={"force": "N", **truth.outputs}, sample_time=0.01).save(path)
    return path


def printed(capsys, *arguments):
    assert run([*map(str, arguments), "--json"]) == DONE
    as_json = json.loads(capsys.readouterr().out)
    assert run([*map(str, arguments)]) == DONE
    return as_json, capsys.readouterr().out.rstrip("\n")


def timeless(answer):
    return {name: value for name, value in answer.items() if name not in TIMES}


def test_compare_says_what_the_command_prints(pushed, capsys):
    comparison = rs.model("linear-axis").compare(rs.read(pushed))
    assert printed(capsys, "compare", "linear-axis", pushed) == (
        comparison.to_dict(),
        str(comparison),
    )
    assert comparison.structured
    assert (
        comparison.table.loc[0, "output"] == "position"
        and "times_noise" in comparison.where.columns
    )


def test_explain_says_what_the_command_prints_and_names_the_truth(pushed, capsys):
    effects = ["viscous-friction", "linear-spring"]
    why = rs.model("linear-axis").explain(pushed, effects=effects)
    as_json, text = printed(
        capsys, "explain", "linear-axis", pushed, "--effects", ",".join(effects)
    )
    assert (timeless(as_json), text) == (timeless(why.to_dict()), str(why))
    assert (why.best.effect, why.candidates.loc[0, "effect"]) == (
        "viscous-friction",
        "viscous-friction",
    )
    assert why.best.parameters["d"].value == pytest.approx(40.0, rel=0.02)


def test_improve_says_what_the_command_prints_and_saves_the_same_model(pushed, capsys, tmp_path):
    improvement = rs.model("linear-axis").improve(pushed, add="viscous-friction")
    as_json, text = printed(
        capsys,
        "improve",
        "linear-axis",
        pushed,
        "--add",
        "viscous-friction",
        "--out",
        tmp_path / "a.yaml",
    )
    assert as_json == improvement.to_dict() | {"model_file": str(tmp_path / "a.yaml")}
    assert text == f"{improvement}\nmodel file (estimated on everything): {tmp_path / 'a.yaml'}"
    improvement.model.save(tmp_path / "b.yaml")
    assert (tmp_path / "a.yaml").read_text() == (tmp_path / "b.yaml").read_text()
    assert rs.model(tmp_path / "b.yaml").parameters[
        "viscous-friction@axis.d"
    ].value == pytest.approx(40.0, rel=0.02)
    assert improvement.history[-1]["error"] < 0.5 * improvement.history[0]["error"]


def test_estimate_says_what_the_command_prints(pushed, capsys, tmp_path):
    estimation = rs.model("linear-axis").with_effect("viscous-friction", "axis").estimate(pushed)
    assert estimation.parameters["M"]["value"] == pytest.approx(95.0, rel=0.02)
    plain = rs.model("linear-axis").estimate(pushed)
    as_json, text = printed(capsys, "estimate", "linear-axis", pushed, "--out", tmp_path / "a.yaml")
    assert as_json == plain.to_dict() | {"model_file": str(tmp_path / "a.yaml")}
    assert text == f"{plain}\nwritten to {tmp_path / 'a.yaml'}"


def test_identify_and_control_say_what_the_commands_print(pushed, capsys, tmp_path):
    plant = rs.identify(pushed, input="force", output="velocity", order=30)
    as_json, text = printed(
        capsys, "identify", pushed, "--input", "force", "--output", "velocity", "--order", 30
    )
    assert (timeless(as_json), text) == (timeless(plant.to_dict()), str(plant))
    plant.save(tmp_path / "plant.json")
    assert np.array_equal(
        rs.load_plant(tmp_path / "plant.json").sample(3, seed=2), plant.sample(3, seed=2)
    )


def test_another_level_draws_the_line_elsewhere_and_another_seed_draws_other_noise():
    rng, force = (
        np.random.default_rng(3),
        60.0 * np.sign(np.sin(2.0 * np.pi * 0.4 * 0.01 * np.arange(600))),
    )
    model = rs.model("linear-axis").with_values(M=95.0)
    given = rs.from_arrays({"force": force}, units={"force": "N"}, sample_time=0.01)
    velocity = model.with_effect("viscous-friction", "axis", d=0.4).simulate(given)[
        "velocity"
    ] + 2e-3 * rng.standard_normal(600)
    record = rs.from_arrays(
        {"force": force, "velocity": velocity},
        units={"force": "N", "velocity": "m/s"},
        sample_time=0.01,
    )
    usual, lenient, other = (
        model.compare(record),
        model.compare(record, level=0.2),
        model.compare(record, seed=1),
    )
    assert (
        not usual.structured
        and lenient.structured
        and other.found.p_value not in (usual.found.p_value, 1.0)
    )


def test_the_catalogue_is_the_command_s(capsys):
    assert printed(capsys, "effects") == (
        json.loads(json.dumps(rs.effects.to_dict())),
        str(rs.effects),
    )


def test_pictures_show_what_was_computed(pushed):
    record = rs.read(pushed)
    model = rs.model("linear-axis")
    comparison = model.compare(record)
    figure = comparison.plot()
    np.testing.assert_allclose(figure.data[0].y, record["position"])
    np.testing.assert_allclose(figure.data[2].y, record["position"] - figure.data[1].y)
    figure.update_layout(title="mine")
    html = comparison._repr_html_()
    assert html.count("<svg") == 1 and html.count("<path") >= 2 and "<td>position</td>" in html


def test_the_picture_of_an_explanation_shows_errors_over_time_and_the_law_over_what_is_missing(
    pushed,
):
    why = rs.model("linear-axis").explain(pushed, effects=["viscous-friction", "linear-spring"])
    # the first of a name
    traces = {trace.name: trace for trace in reversed(why.plot().data) if trace.name}
    law, missing = (
        traces["viscous-friction"],
        next(t for name, t in traces.items() if name.startswith("missing")),
    )
    fast = np.abs(np.asarray(law.x)) > 0.3 * np.abs(law.x).max()
    assert np.asarray(law.y)[fast] / np.asarray(law.x)[fast] == pytest.approx(-40.0, rel=0.1)
    assert np.corrcoef(missing.y, np.interp(missing.x, law.x, law.y))[0, 1] > 0.95

    blocks = why.found.blocks
    before, after = (
        np.nansum(errors**2, axis=0) for errors in (blocks.before, blocks.candidates[why.best.key])
    )
    # blocks of nearly one length
    assert np.mean(1.0 - after / before) == pytest.approx(why.best.share.value, rel=5e-3)
    position = why.to_dict()["blocks"]["outputs"][0]
    np.testing.assert_allclose(traces["the model as it is"].y, position["before"])
    ends = [(block["from"], block["to"]) for block in why.to_dict()["blocks"]["blocks"]]
    assert (
        ends[0][0] == 0.0
        and ends[-1][1] == pytest.approx(15.0)
        and all(b[0] == pytest.approx(a[1]) for a, b in pairwise(ends))
    )
    assert np.mean(np.array(position["after"]) < position["before"]) > 0.9


def test_bode_and_step_show_the_plant(pushed):
    plant = rs.identify(rs.simulate("process-plant", seed=1), input="u", output="y", order=40)
    bode = plant.bode([0.01, 0.1])
    magnitudes = next(trace for trace in bode.data if trace.name == "magnitude")
    truth = 20.0 * np.log10(np.abs(plant.frequency_response(2.0 * np.pi * np.array([0.01, 0.1]))))
    np.testing.assert_allclose(magnitudes.y, truth)
    step = next(trace for trace in plant.step().data if trace.name == "step response")
    assert step.y[-1] == pytest.approx(np.sum(plant.impulse_response), rel=1e-9)
    control = pytest.importorskip("control")
    assert control.dcgain(plant.to_control()) == pytest.approx(np.sum(plant.impulse_response))


def test_a_picture_as_svg_breaks_at_gaps_and_escapes_names():
    curve = Curve("<a>", np.arange(4.0), np.array([0.0, np.nan, 1.0, 2.0]))
    text = svg(Picture([Panel("t", "x", "y", [curve]), Panel("b", "x", "y", Bars(["p"], [1.0]))]))
    assert text.count("M") == 2 and "&lt;a&gt;" in text and text.count("<rect") == 3


@pytest.mark.parametrize(
    ("package", "call"),
    [
        ("plotly", lambda r: r.plot()),
        ("pandas", lambda r: r.to_pandas()),
        ("pandas", lambda r: r.table),
    ],
)
def test_an_optional_package_that_is_missing_is_named(pushed, monkeypatch, package, call):
    comparison = rs.model("linear-axis").compare(pushed)
    for name in [name for name in sys.modules if name.split(".")[0] == package]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(rs.MissingPackage, match=f"needs the package '{package}': pip install"):
        call(comparison)
    assert "<svg" in comparison._repr_html_()


def test_progress_is_told_and_an_interruption_leaves_no_line_and_no_file(pushed, tmp_path, capsys):
    told = []
    rs.model("linear-axis").explain(
        pushed, effects=["viscous-friction"], progress=lambda share, doing: told.append(share)
    )
    assert told and all(0.0 <= share <= 1.0 for share in told)

    def interrupt(share, doing):
        raise KeyboardInterrupt

    target = tmp_path / "better.yaml"
    target.write_text("as it was")
    with pytest.raises(KeyboardInterrupt):
        rs.model("linear-axis").improve(
            pushed, add="viscous-friction", progress=interrupt
        ).model.save(target)
    assert target.read_text() == "as it was" and list(tmp_path.iterdir()) == [target]
    rs.model("linear-axis").explain(pushed, effects=["viscous-friction"], progress=True)
    shown = capsys.readouterr().err
    assert "%" in shown and shown.endswith("\r")


def test_a_save_that_fails_leaves_the_file_as_it_was(tmp_path, monkeypatch):
    target = tmp_path / "m.yaml"
    target.write_text("as it was")

    def broken(*_):
        raise OSError("disk full")

    monkeypatch.setattr("residuum.library.whole_file.os.replace", broken)
    with pytest.raises(OSError, match="disk full"):
        rs.model("linear-axis").save(target)
    assert target.read_text() == "as it was" and list(tmp_path.iterdir()) == [target]


def test_a_model_comes_from_a_name_a_file_or_a_text(tmp_path):
    named = rs.model("linear-axis")
    named.save(tmp_path / "axis.yaml")
    assert rs.model(tmp_path / "axis.yaml").text == rs.model(named.text).text == named.text
    with pytest.raises(rs.BadModel, match="line 1"):
        rs.model("nonsense: 1\nname: x\n")
    with pytest.raises(rs.BadModel, match="no such file; the built-in models are"):
        rs.model("nowhere")


def test_an_effect_goes_in_and_out_of_a_model():
    model = rs.model("linear-axis").with_effect("viscous-friction", "axis", d=3.0)
    assert (
        model.effects == ("viscous-friction@axis",)
        and model.without_effect("viscous-friction").effects == ()
    )
    assert ("viscous-friction", "axis") in rs.model("linear-axis").fitting_effects


@pytest.mark.parametrize("method", ["kernel", "set-membership", "elastic-net"])
def test_a_plant_from_its_file_is_of_the_method_that_found_it(method, tmp_path):
    record = rs.simulate("process-plant", seed=1)
    bounds = {"noise_bound": 5.0} if method == "set-membership" else {}
    plant = rs.identify(record, input="u", output="y", method=method, order=20, **bounds)
    plant.save(tmp_path / "plant.json")
    assert rs.load_plant(tmp_path / "plant.json").to_dict()["method"] == plant.to_dict()["method"]
