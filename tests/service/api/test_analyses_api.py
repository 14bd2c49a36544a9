"""Analyses over HTTP are jobs whose results are those of the console program."""

import json
import time

import numpy as np
import pytest
from scipy import signal
from typer.testing import CliRunner

from residuum.identification.physics import Experiment, Simulator, load_model, read_model
from residuum.identification.record import Record
from residuum.identification.record_formats import write_record
from residuum.service.commands.compare import app as compare_command


@pytest.fixture(scope="module")
def plant():
    """Records of y = 0.3 / (z - 0.7) u + noise, the second with a sensor offset in its second half."""
    rng = np.random.default_rng(5)
    found = []
    for offset in (0.0, 3.0):
        u = rng.normal(size=1500)
        y = signal.lfilter([0, 0.3], [1, -0.7], u) + 0.05 * rng.normal(size=1500)
        y[750:] += offset
        found.append(Record({"u": u, "y": y}, {"u": "V", "y": "V"}, 0.1))
    return found


def upload(client, record, path):
    write_record(record, path)
    answer = client.post(
        "/api/v1/records", params={"filename": path.name}, content=path.read_bytes()
    )
    assert answer.status_code == 201, answer.text
    return answer.json()["id"]


def result(client, answer):
    assert answer.status_code == 202, answer.text
    end = time.monotonic() + 300
    while (job := client.get(answer.headers["location"]).json())["state"] in ("queued", "running"):
        assert time.monotonic() < end, job
        time.sleep(0.05)
    return job


def test_identify_then_residuals(client, plant, tmp_path):
    healthy, faulty = (
        upload(client, record, tmp_path / f"{number}.csv") for number, record in enumerate(plant)
    )
    asked = {
        "records": [healthy],
        "input": "u",
        "output": "y",
        "order": 30,
        "delay": 1,
        "save_as": "plant",
    }
    job = result(client, client.post("/api/v1/identify", json=asked))
    assert job["state"] == "done", job
    g = np.array(job["result"]["impulse_response"])
    np.testing.assert_allclose(g[:10], 0.3 * 0.7 ** np.arange(10), atol=0.02)
    assert job["result"]["stored"] == {"model": "plant", "version": 1}
    asked = {
        "model": "plant",
        "healthy": [healthy],
        "records": [healthy, faulty],
        "gamma": 0.2,
        "epsilon": 0.1,
        "points": 100,
    }
    job = result(client, client.post("/api/v1/residuals", json=asked))
    assert job["state"] == "done", job
    assert [run["alarm"] for run in job["result"]["runs"]] == [False, True]
    assert job["result"]["design"]["gamma"] == 0.2
    assert job["result"]["runs"][1]["first_alarm_time"] == pytest.approx(75, abs=3)
    assert job["result"]["runs"][1]["record"] == faulty


def test_the_weight_lies_above_the_drawn_models_and_the_residual_shows_the_fault(
    client, refused, plant, tmp_path
):
    healthy, faulty = (
        upload(client, record, tmp_path / f"{number}.csv") for number, record in enumerate(plant)
    )
    asked = {
        "records": [healthy],
        "input": "u",
        "output": "y",
        "order": 30,
        "delay": 1,
        "save_as": "trusted",
    }
    assert result(client, client.post("/api/v1/identify", json=asked))["state"] == "done"
    found = client.get("/api/v1/models/trusted/uncertainty", params={"samples": 20}).json()
    samples, weight = np.array(found["samples"]), np.array(found["weight"])
    assert samples.shape == (20, len(found["frequency"])) and found["n_samples"] > 100
    assert np.mean(samples <= weight) > 0.99 and np.max(samples) > 0.3 * np.max(weight)
    forms = {}
    for form in ("additive", "inverse-multiplicative"):
        chosen = {
            "samples": 20,
            "form": form,
            "epsilon": 0.1,
            "zeta": 0.2,
            "order": 1,
            "points": 80,
            "lowest": 0.1,
        }
        answer = client.get("/api/v1/models/trusted/uncertainty", params=chosen)
        forms[form] = answer.json()
        assert (
            answer.headers["Warning"]
            == '299 - "order: will not be read much longer; say weight_order"'
        )
        assert (
            forms[form]["form"] == form
            and forms[form]["n_samples"] == 116
            and len(forms[form]["sampled_frequency"]) == 80
        )
        assert np.mean(np.array(forms[form]["samples"]) <= np.array(forms[form]["weight"])) > 0.99
    # the gain is below 1
    assert np.median(forms["additive"]["samples"]) < np.median(
        forms["inverse-multiplicative"]["samples"]
    )
    asked = {"healthy": [healthy], "record": faulty, "offset": 0.2}
    job = result(client, client.post("/api/v1/models/trusted/residual-views", json=asked))
    assert job["state"] == "done", job
    view = job["result"]
    assert view["alarm_time"] == pytest.approx(75, abs=3) and view["unit"] == "V"
    assert (
        len(view["time"]) == len(view["statistic"]) == len(view["threshold"]) == len(view["lowest"])
    )
    false, hit = np.array(view["roc"]["false_alarms"]), np.array(view["roc"]["detections"])
    assert (
        0.9 < view["roc"]["area"] <= 1 and np.all(np.diff(false) >= 0) and np.all(np.diff(hit) >= 0)
    )
    assert refused("GET", "/api/v1/models/none/uncertainty")[0] == 404
    assert (
        refused("POST", "/api/v1/models/trusted/residual-views", json=asked | {"offset": 0})[0]
        == 422
    )


def test_identify_by_elastic_net_and_check_it(client, plant, tmp_path):
    number = upload(client, plant[0], tmp_path / "checked.csv")
    asked = {
        "records": [number],
        "input": "u",
        "output": "y",
        "method": "elastic-net",
        "order": 30,
        "delay": 1,
        "check": True,
    }
    job = result(client, client.post("/api/v1/identify", json=asked))
    assert job["state"] == "done", job
    assert job["result"]["method"] == "elastic-net"
    assert job["result"]["check"]["parts"][0]["input_correlation"]["p_value"] > 1e-6
    assert job["result"]["check"]["bootstrap"]["error"] > 0


def test_a_controller_is_designed_for_a_stored_model(client, plant, tmp_path):
    number = upload(client, plant[0], tmp_path / "a.csv")
    asked = {
        "records": [number],
        "input": "u",
        "output": "y",
        "method": "oe",
        "order": 1,
        "delay": 1,
        "save_as": "controlled",
    }
    assert result(client, client.post("/api/v1/identify", json=asked))["state"] == "done"
    job = result(client, client.post("/api/v1/control-designs", json={"models": ["controlled"]}))
    assert job["state"] == "done", job
    assert isinstance(job["result"]["file"], dict) and job["result"]["models"] == ["controlled"]


def test_compare_gives_what_the_command_gives(client, tmp_path):
    rng = np.random.default_rng(2)
    force = rng.normal(size=800) * 20
    velocity = np.cumsum(force - 8 * np.sign(force)) * 1e-3 / 95
    record = Record({"force": force, "velocity": velocity}, {"force": "N", "velocity": "m/s"}, 1e-3)
    number = upload(client, record, tmp_path / "axis.npz")
    job = result(
        client, client.post("/api/v1/models/linear-axis/compare", json={"records": [number]})
    )
    assert job["state"] == "done", job
    printed = CliRunner().invoke(
        compare_command, ["linear-axis", str(tmp_path / "axis.npz"), "--json"]
    )
    expected = json.loads(printed.stdout)
    assert job["result"]["outputs"] == expected["outputs"]
    asked = {"records": [number], "effects": ["coulomb-friction"]}
    explained = result(client, client.post("/api/v1/models/linear-axis/explain", json=asked))
    assert explained["state"] == "done", explained
    assert explained["result"]["outputs"] == expected["outputs"]
    assert explained["result"]["verdict"] in ("missing-effect", "adequate", "unknown-effect")
    assert (job["result"]["model"], job["result"]["records"]) == (
        "linear-axis",
        [f"record-{number}.npz"],
    )


@pytest.fixture(scope="module")
def axis_with_friction(client, tmp_path_factory):
    """Number of a record of the linear axis with Coulomb friction of 20 N, and white noise on the position."""
    rng = np.random.default_rng(8)
    t = np.arange(3000) * 0.002
    force = 60 * np.sin(2 * np.pi * 0.7 * t) + 40 * np.sign(np.sin(2 * np.pi * 0.23 * t))
    truth = (
        load_model("linear-axis")
        .with_effect("coulomb-friction", "axis", {"tau_c": 20.0})
        .with_values({"M": 80.0})
    )
    experiment = Experiment(force[:, None], np.full((3000, 2), np.nan), np.zeros(1), 0.002)
    position = Simulator(truth).run(experiment, {"q": 0.0, "v": 0.0}).Y[:, 0] + 5e-5 * rng.normal(
        size=3000
    )
    record = Record({"force": force, "position": position}, {"force": "N", "position": "m"}, 0.002)
    return upload(client, record, tmp_path_factory.mktemp("axis") / "axis.npz")


def test_improve_adds_what_is_named_and_stores_the_version(client, axis_with_friction):
    asked = {
        "records": [axis_with_friction],
        "add": ["coulomb-friction@axis"],
        "effects": [],
        "save_as": "axis-improved",
    }
    answer = client.post("/api/v1/models/linear-axis/improve", json=asked)
    assert (
        answer.headers["Warning"]
        == '299 - "effects []: will not be read much longer; leave it out"'
    )
    job = result(client, answer)
    assert job["state"] == "done", job
    found = job["result"]
    assert [step["added"] for step in found["history"]] == [None, "coulomb-friction"]
    assert (
        found["history"][1]["error"] < 0.5 * found["history"][0]["error"]
        and found["held_out"] is True
    )
    stored = client.get(found["model_file"])
    assert (
        found["stored"] == {"model": "axis-improved", "version": 1} and stored.text == found["file"]
    )
    assert read_model(stored.text).values["coulomb-friction@axis.tau_c"] == pytest.approx(
        20.0, rel=0.05
    )
    newest = client.get("/api/v1/models/axis-improved/versions").json()["items"][0]
    assert newest["note"] == "improved: coulomb-friction"


@pytest.mark.parametrize("said", [{"auto": True}, {}])
def test_improve_finds_the_effect_alone(said, client, axis_with_friction):
    few = ["coulomb-friction", "linear-spring"]
    asked = {"records": [axis_with_friction], "effects": few} | said
    job = result(client, client.post("/api/v1/models/linear-axis/improve", json=asked))
    assert job["state"] == "done", job
    found = job["result"]
    assert (
        "coulomb-friction" in [step["added"] for step in found["history"]]
        and found["verdict"] == "adequate"
    )
    assert found["model_file"] is None and "stored" not in found


TANK = """
name: tank
inputs: {inflow: l/s}
states: {h: {unit: m}}
parameters: {A: {value: 28, unit: l/m, lower: 1, upper: 1000, fixed: true}}
balances: {tank: {kind: volume, storage: A * der(h), terms: {in: inflow}, level: h}}
outputs: {level: {value: h, unit: m}}
"""


@pytest.fixture(scope="module")
def leaking_tank(client, tmp_path_factory):
    """Number of a record of a tank of 31.7 l/m, held to be 28 l/m, whose drain was recorded and is no input of the model."""
    rng = np.random.default_rng(3)
    inflow, drain = (
        np.repeat(rng.uniform(0, high, 40), every)[:1000] for high, every in ((1.0, 40), (0.9, 27))
    )
    level = (
        2.0
        + np.concatenate([[0.0], np.cumsum((inflow - drain) / 31.7)[:-1]])
        + 0.002 * rng.standard_normal(1000)
    )
    record = Record(
        {"inflow": inflow, "drain": drain, "level": level},
        {"inflow": "l/s", "drain": "l/s", "level": "m"},
        1.0,
    )
    answer = client.post("/api/v1/models", params={"name": "tank"}, content=TANK.encode())
    assert answer.status_code == 201, answer.text
    return upload(client, record, tmp_path_factory.mktemp("tank") / "tank.csv")


@pytest.mark.parametrize("written", ["forgotten-input@tank(drain)", "forgotten-input:tank(drain)"])
def test_a_forgotten_input_is_added_and_a_fixed_value_freed_where_it_is_named(
    client, leaking_tank, written
):
    asked = {"records": [leaking_tank], "add": [written], "free": ["A"]}
    job = result(client, client.post("/api/v1/models/tank/improve", json=asked))
    assert job["state"] == "done", job
    (added,) = job["result"]["effects"]
    assert added["channel"] == "drain" and added["gain"]["value"] == pytest.approx(-1.0, rel=0.05)
    assert read_model(job["result"]["file"]).values["A"] == pytest.approx(31.7, rel=0.05)


def test_a_curve_is_added_and_a_fixed_value_stays_where_nobody_names_it(client, leaking_tank):
    asked = {"records": [leaking_tank], "add": ["learned@tank(h)"]}
    job = result(client, client.post("/api/v1/models/tank/improve", json=asked))
    assert job["state"] == "done", job
    (added,) = job["result"]["effects"]
    assert added["signals"] == ["h"] and len(added["curve"]["at"]) == len(added["curve"]["value"])
    assert read_model(job["result"]["file"]).values["A"] == 28


def test_what_is_tied_to_nothing_there_is_the_jobs_one_line(client, leaking_tank):
    for add in ("forgotten-input@tank(nothing)", "coupling@tank(nothing)"):
        job = result(
            client,
            client.post(
                "/api/v1/models/tank/improve", json={"records": [leaking_tank], "add": [add]}
            ),
        )
        assert job["state"] == "refused" and "nothing" in job["error"], job


def test_explain_takes_curves_and_forgotten_inputs(client, refused, leaking_tank):
    asked = {"records": [leaking_tank], "effects": ["forgotten-input"], "learned": True}
    job = result(client, client.post("/api/v1/models/tank/explain", json=asked))
    assert job["state"] == "done", job
    leading = job["result"]["candidates"][0]
    assert (leading["effect"], leading["channel"]) == (
        "forgotten-input",
        "drain",
    ) and "remaining" in job["result"]
    assert refused("POST", "/api/v1/models/tank/explain", json=asked | {"seconds": 0})[0] == 422


DRAINED = (
    TANK.replace("name: tank", "name: drained")
    + """
own_effects:
  - id: half-drain
    title: A drain that opens above the middle
    acts_on: [volume]
    term: -c * max(level - m, 0)
    parameters:
      c: {value: 0, unit: m**2/s, lower: 0, size: true, meaning: outflow per height}
      m: {value: 2.0, unit: m, lower: 0, meaning: height of the opening}
    reference: a measurement of the test
"""
)


def test_effects_that_a_model_file_defines_are_proposed_and_added(client, refused, tmp_path):
    rng = np.random.default_rng(8)
    inflow, level = np.repeat(rng.uniform(0, 1.0, 60), 25), [2.0]
    for flow in inflow[:-1]:
        level.append(level[-1] + (flow - 0.8 * max(level[-1] - 1.5, 0.0)) / 28.0)
    level = np.array(level) + 0.002 * rng.standard_normal(len(level))
    number = upload(
        client,
        Record({"inflow": inflow, "level": level}, {"inflow": "l/s", "level": "m"}, 1.0),
        tmp_path / "drained.csv",
    )
    assert (
        client.post(
            "/api/v1/models", params={"name": "drained"}, content=DRAINED.encode()
        ).status_code
        == 201
    )
    asked = {"records": [number], "effects": ["half-drain", "forgotten-input"]}
    job = result(client, client.post("/api/v1/models/drained/explain", json=asked))
    assert job["state"] == "done", job
    assert job["result"]["candidates"][0]["effect"] == "half-drain"
    job = result(
        client,
        client.post(
            "/api/v1/models/drained/improve", json={"records": [number], "add": ["half-drain"]}
        ),
    )
    assert job["state"] == "done", job
    values = read_model(job["result"]["file"]).values
    # [m**2/s]; the model is in litres
    assert values["half-drain@tank.c"] == pytest.approx(0.8e-3, rel=0.05)
    assert values["half-drain@tank.m"] == pytest.approx(1.5, rel=0.05)
    # another model's
    assert refused("POST", "/api/v1/models/linear-axis/explain", json=asked)[0] == 404


def test_a_catalogue_that_is_none_is_the_jobs_one_line(client, leaking_tank):
    effect = "effects: [{id: %s, acts_on: [volume], term: -c, parameters: {c: {unit: m**3/s, size: true}}}]"
    for text, says in {
        "own.yaml": "catalogue, line 1, column 1: a catalogue is a mapping that begins with 'effects:'",
        effect % "Drain": "catalogue, line 1, column 16: effect 'Drain': an id is of small letters",
        effect % "leak": "effect 'leak': the catalogue has one of this id",
    }.items():
        job = result(
            client,
            client.post(
                "/api/v1/models/tank/explain", json={"records": [leaking_tank], "catalogue": text}
            ),
        )
        assert job["state"] == "refused" and job["error"].startswith(says), job


def test_an_improvement_names_effects_that_there_are(refused, axis_with_friction):
    path, records = "/api/v1/models/linear-axis/improve", {"records": [axis_with_friction]}
    for body in (
        {"add": ["coulomb-friction"], "auto": True},
        {"add": ["coulomb-friction,backlash"]},
    ):
        assert refused("POST", path, json=records | body)[0] == 422
    assert refused("POST", path, json=records | {"add": ["phlogiston"]})[0] == 404
    assert refused("POST", path, json=records | {"auto": True, "effects": ["phlogiston"]})[0] == 404


def test_what_a_command_refuses_is_the_jobs_one_line(client, plant, tmp_path):
    number = upload(client, plant[0], tmp_path / "a.csv")
    job = result(
        client, client.post("/api/v1/models/linear-axis/compare", json={"records": [number]})
    )
    assert job["state"] == "refused" and "force" in job["error"] and "/tmp" not in job["error"]
    assert '"map": {"force": "COLUMN"} in the body' in job["error"]  # the key that the routes take


def test_bad_requests_for_analyses(refused, client, plant, tmp_path):
    number = upload(client, plant[0], tmp_path / "a.csv")
    assert refused("POST", "/api/v1/models/none/compare", json={"records": [number]})[0] == 404
    assert refused("POST", "/api/v1/models/oven/compare", json={"records": [10**9]})[0] == 404
    assert refused("POST", "/api/v1/models/oven/compare", json={"records": []})[0] == 422
    asked = {"records": [number], "effects": ["phlogiston"]}
    assert refused("POST", "/api/v1/models/oven/explain", json=asked)[0] == 404
    assert refused("POST", "/api/v1/control-designs", json={"models": ["none"]})[0] == 404
    assert (
        refused("POST", "/api/v1/models/etc.passwd/compare", json={"records": [number]})[0] == 404
    )
    assert (
        refused(
            "POST",
            "/api/v1/identify",
            json={"records": [number], "input": "u", "output": "y", "method": "magic"},
        )[0]
        == 422
    )


def test_the_catalogue_of_effects_is_listed(client):
    effects = {each["effect"]: each for each in client.get("/api/v1/effects").json()["items"]}
    assert {"coulomb-friction", "backlash", "ambient-loss"} <= set(effects) and effects[
        "coulomb-friction"
    ]["equation"]


def test_a_stored_record_without_a_unit_is_refused_with_the_way_over_http(client):
    content = "time [s],voltage,speed [rad/s]\n" + "\n".join(
        f"{k / 100},{k % 9},{k % 7}" for k in range(400)
    )
    number = client.post("/api/v1/records?filename=a.csv", content=content).json()["id"]
    job = result(
        client, client.post("/api/v1/models/gate-drive/compare", json={"records": [number]})
    )
    assert (
        job["state"] == "refused"
        and "POST /records?unit=voltage=V" in job["error"]
        and "--unit" not in job["error"]
    ), job
