"""A model's signals beside a record, effects' curves, and one more effect, over HTTP."""

import time

import numpy as np
import pytest

from residuum.identification.physics import Experiment, Simulator, load_model, read_model
from residuum.identification.record import Record
from residuum.identification.record_formats import write_record

FRICTION, MASS, NOISE = 20.0, 80.0, 0.002


@pytest.fixture(scope="module")
def axis():
    """The linear axis, lighter than the built-in model, with Coulomb friction and white noise on the velocity."""
    rng = np.random.default_rng(8)
    t = np.arange(4000) * 0.002
    force = 60 * np.sin(2 * np.pi * 0.7 * t) + 40 * np.sign(np.sin(2 * np.pi * 0.23 * t))
    truth = (
        load_model("linear-axis")
        .with_effect("coulomb-friction", "axis", {"tau_c": FRICTION})
        .with_values({"M": MASS})
    )
    experiment = Experiment(force[:, None], np.full((4000, 2), np.nan), np.zeros(1), 0.002)
    velocity = Simulator(truth).run(experiment, {"q": 0.0, "v": 0.0}).Y[:, 1] + NOISE * rng.normal(
        size=4000
    )
    return Record({"force": force, "velocity": velocity}, {"force": "N", "velocity": "m/s"}, 0.002)


@pytest.fixture(scope="module")
def number(client, axis, tmp_path_factory):
    path = tmp_path_factory.mktemp("axis") / "axis.npz"
    write_record(axis, path)
    return client.post(
        "/api/v1/records", params={"filename": "axis.npz"}, content=path.read_bytes()
    ).json()["id"]


def result(client, answer):
    assert answer.status_code == 202, answer.text
    end = time.monotonic() + 300
    while (job := client.get(answer.headers["location"]).json())["state"] in ("queued", "running"):
        assert time.monotonic() < end, job
        time.sleep(0.1)
    assert job["state"] == "done", job
    return job["result"]


def test_a_view_shows_the_friction_against_speed(client, number, axis):
    view = result(
        client, client.post("/api/v1/models/linear-axis/views", json={"records": [number]})
    )
    signals = client.get(
        f"/api/v1/records/{view['signals'][0]}/signal", params={"points": 20_000}
    ).json()["channels"]
    measured, simulated, residual = (
        np.array(signals[f"velocity {what}"]["values"])
        for what in ("measured", "simulated", "residual")
    )
    np.testing.assert_allclose(measured, axis["velocity"], rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(residual, measured - simulated, atol=1e-6)
    rmse = view["comparison"]["outputs"]["velocity"]["rmse"]
    assert np.sqrt(np.mean(residual**2)) == pytest.approx(rmse, rel=1e-4)
    curve = next(c for c in view["curves"] if (c["of"], c["axis"]) == ("axis", "velocity"))
    at, mean = np.array(curve["at"]), np.array(curve["mean"])
    assert mean[at > 0.15].mean() < 0 < mean[at < -0.15].mean()
    phases = next(each for each in view["phases"] if each["of"] == "axis")
    assert (phases["axis"], phases["unit"]) == ("velocity", "N") and {"forward", "backward"} == {
        cell["direction"] for cell in phases["cells"]
    }


def test_records_are_deleted_and_comparisons_keep_only_the_newest(
    client, number, axis, tmp_path, refused, monkeypatch
):
    monkeypatch.setattr("residuum.service.api.model_views.DERIVED_KEPT", 2)
    path, asked = "/api/v1/models/linear-axis/views", {"records": [number]}
    found = [result(client, client.post(path, json=asked))["signals"][0] for _ in range(3)]
    there = [each["id"] for each in client.get("/api/v1/records").json()["items"] if each["notes"]]
    assert there == found[:0:-1] and refused("GET", f"/api/v1/records/{found[0]}/signal")[0] == 404
    assert client.get(f"/api/v1/records/{number}").status_code == 200  # what was uploaded stays
    write_record(axis, tmp_path / "short.npz")
    body = (tmp_path / "short.npz").read_bytes()
    made = client.post("/api/v1/records", params={"filename": "short.npz"}, content=body).json()[
        "id"
    ]
    assert client.delete(f"/api/v1/records/{made}").status_code == 204
    assert (
        refused("GET", f"/api/v1/records/{made}")[0] == 404
        and refused("DELETE", f"/api/v1/records/{made}")[0] == 404
    )


def test_an_effects_curve_is_its_equation(client, number):
    effect = {"effect": "coulomb-friction", "balance": "axis", "parameters": {"tau_c": 7.0}}
    asked = {"records": [number], "effects": [effect]}
    curves = result(client, client.post("/api/v1/models/linear-axis/effect-curves", json=asked))[
        "curves"
    ]
    curve = next(c for c in curves if c["axis"] == "velocity")
    for at, value in zip(curve["at"], curve["value"], strict=True):
        if abs(at) > 0.1:
            assert value == pytest.approx(-7.0 * np.sign(at), rel=1e-6)


def test_an_added_effect_lowers_the_held_out_error_and_is_stored(client, number):
    add = {"effect": "coulomb-friction", "balance": "axis", "parameters": {"tau_c": 5.0}}
    asked = {"records": [number], "add": add, "save_as": "axis-mended"}
    found = result(client, client.post("/api/v1/models/linear-axis/effects", json=asked))
    errors = {
        stage: found["errors"][stage]["velocity"]
        for stage in ("as_given", "re_estimated", "with_effect")
    }
    assert (
        errors["with_effect"] == pytest.approx(NOISE, rel=0.1)
        and errors["with_effect"] < 0.2 * errors["re_estimated"]
    )
    described = client.get("/api/v1/models/axis-mended/description").json()
    values = {each["name"]: each["value"] for each in described["parameters"]}
    assert values["M"] == pytest.approx(MASS, rel=0.01)
    assert values["coulomb-friction@axis.tau_c"] == pytest.approx(FRICTION, rel=0.02)
    assert described["effects"][0]["provenance"]["with_effect"]["velocity"] == pytest.approx(
        errors["with_effect"]
    )
    assert read_model(described["file"]).effects[0].id == "coulomb-friction"


def test_a_description_holds_the_balances_as_trees(client):
    described = client.get("/api/v1/models/linear-axis/description").json()
    axis = described["balances"][0]
    assert axis["storage"] == ["*", "M", ["der", "v"]]
    assert axis["terms"] == [{"name": "drive", "value": "force"}]
    names = [
        each["model"] for each in client.get("/api/v1/models/built-in/descriptions").json()["items"]
    ]
    assert "gate-drive" in names


def test_parameters_are_changed_into_a_new_version(client, refused):
    path = "/api/v1/models/linear-axis/parameters"
    change = {"M": {"value": 50.0, "lower": 40.0, "upper": None, "fixed": True}}
    answer = client.post(path, json={"parameters": change, "save_as": "axis-by-hand"})
    assert answer.status_code == 201 and answer.json()["note"] == "changed by hand: M"
    M = read_model(client.get(answer.headers["location"]).text).parameters["M"]
    assert (M.value, M.lower, M.upper, M.fixed, M.unit) == (50.0, 40.0, np.inf, True, "kg")
    status, detail = refused(
        "POST", path, json={"parameters": {"M": {"upper": 10.0}}, "save_as": "x"}
    )
    assert status == 422 and "'M': value 95 must be within" in detail
    assert refused("POST", path, json={"parameters": {"Z": {"value": 1}}, "save_as": "x"})[0] == 422
    assert refused("POST", path, json={"parameters": {}, "save_as": "x"})[0] == 422
    assert (
        refused("POST", path, json={"parameters": {"M": {"value": None}}, "save_as": "x"})[0] == 422
    )


def test_what_cannot_be_viewed_is_refused(refused, client, number):
    assert refused("POST", "/api/v1/models/none/views", json={"records": [number]})[0] == 404
    assert refused("GET", "/api/v1/models/none/description")[0] == 404
    assert refused("GET", "/api/v1/models/none/frequency-response")[0] == 404
    bad = {"records": [number], "add": {"effect": "phlogiston", "balance": "axis"}, "save_as": "x"}
    answer = client.post("/api/v1/models/linear-axis/effects", json=bad)
    end = time.monotonic() + 300
    while (job := client.get(answer.headers["location"]).json())["state"] in ("queued", "running"):
        assert time.monotonic() < end
        time.sleep(0.1)
    assert job["state"] == "refused" and "phlogiston" in job["error"]
