"""Accepting a model for a machine: thresholds from its healthy windows, old against new, and who accepted what."""

import time

import httpx
import numpy as np
import pytest
from scipy.signal import lfilter

from residuum.diagnosis.diagnosers import DIAGNOSERS
from residuum.identification.physics import load_model, write_model
from residuum.identification.record import Record

MASS, DAMPING, DT = 95.0, 60.0, 0.1  # kg, N·s/m, s
UNITS = {"u": "N", "y": "m/s"}


def axis(seed, n, noise=0.02):
    """M dv/dt = force − d v with the force held over a sample, and white noise on the speed."""
    rng = np.random.default_rng(seed)
    force = 40 * rng.normal(size=n)
    a = np.exp(-DAMPING / MASS * DT)
    speed = lfilter([0, (1 - a) / DAMPING], [1, -a], force) + noise * rng.normal(size=n)
    return Record({"u": force, "y": speed}, UNITS, DT)


@pytest.fixture(scope="module")
def service(run_service):
    """An axis that is watched by a diagnoser trained when its sensor was twice as noisy."""
    service = run_service()
    judge = DIAGNOSERS["robust-residual"]().fit([axis(1, 3000, noise=0.04)])
    folder = service.services.settings.data
    judge.save(folder / "trained")
    service.services.store.add_model_version(
        "axis", "baseline", (folder / "trained").read_bytes(), "trained"
    )
    life = axis(2, 6000)
    for begin in range(0, 6000, 500):
        window = life.window(begin, begin + 500)
        service.services.store.add_window("axis", window, judge.score(window))
    damped = load_model("linear-axis").with_effect("viscous-friction", "axis", {"d": DAMPING})
    service.services.store.add_model_version(
        "damped", "physical", write_model(damped).encode(), "by hand"
    )
    return service


@pytest.fixture
def client(service):
    with httpx.Client(base_url=service.url, timeout=60) as client:
        yield client


def result(client, answer):
    assert answer.status_code == 202, answer.text
    end = time.monotonic() + 300
    while (job := client.get(answer.headers["location"]).json())["state"] in ("queued", "running"):
        assert time.monotonic() < end, job
        time.sleep(0.05)
    return job


def test_a_model_is_proposed_with_its_thresholds_and_accepted(client, service):
    path = "/api/v1/assets/axis/model"
    assert client.get(path).json() == {"active": None, "history": []}
    first = client.post(path, json={"model": "linear-axis", "note": "to begin with"})
    assert (
        first.status_code == 201 and first.json()["active"]["note"] == "linear-axis: to begin with"
    )
    names = {"force": "u", "velocity": "y"}
    asked = {"model": "damped", "version": 1, "map": names}
    job = result(client, client.post("/api/v1/assets/axis/model-proposals", json=asked))
    assert job["state"] == "done", job
    found = job["result"]
    assert found["thresholds"]["glr"]["old"] > 0 and found["thresholds"]["glr"]["new"] > 0
    assert found["alarms"]["windows"] >= 2 and found["alarms"]["new"] == 0
    error = found["model_error"]["outputs"]["velocity"]
    assert error["unit"] == "m/s" and 0.02 < error["new"] < 0.05 and error["old"] > 3 * error["new"]
    # nothing is active yet
    assert client.get(path).json()["active"]["note"] == "linear-axis: to begin with"

    accepted = client.post(
        path, json={"model": "damped", "version": 1, "proposal": found["proposal"]}
    )
    assert accepted.status_code == 201, accepted.text
    history = accepted.json()["history"]
    assert [(entry["number"], entry["created_by"]) for entry in history] == [
        (2, "local"),
        (1, "local"),
    ]
    assert "damped, version 1" in history[0]["note"] and "proposal" in history[0]["note"]
    store = service.services.store
    assert store.model_content("axis.model") == store.model_content("damped", 1)
    assert store.model_content("axis") == store.model_content("axis.proposed", found["proposal"])
    offset = axis(5, 500)
    shifted = Record(
        {"u": offset["u"], "y": offset["y"] + np.where(np.arange(500) > 250, 0.15, 0)}, UNITS, DT
    )
    body = {
        "sample_time": DT,
        "units": UNITS,
        "channels": {name: shifted[name].tolist() for name in UNITS},
    }
    seen = client.post("/api/v1/assets/axis/windows", json=body).json()["finding"]
    assert seen["verdict"] == "faulty" and seen["thresholds"]["glr"] == pytest.approx(
        found["thresholds"]["glr"]["new"]
    )


def test_windows_that_a_model_cannot_read_leave_the_thresholds_alone(client):
    job = result(client, client.post("/api/v1/assets/axis/model-proposals", json={"model": "oven"}))
    assert job["state"] == "done", job
    assert job["result"]["model_error"]["outputs"] == {} and job["result"]["model_error"]["reason"]
    assert job["result"]["thresholds"]["glr"]["new"] > 0


def test_what_cannot_be_accepted_is_refused(client, service, refused):
    service.services.store.ensure_asset("idle", diagnoser="robust-residual")
    service.services.store.ensure_asset("bare")
    assert refused("GET", "/api/v1/assets/none/model")[0] == 404
    assert refused("POST", "/api/v1/assets/none/model", json={"model": "oven"})[0] == 404
    assert refused("POST", "/api/v1/assets/axis/model", json={"model": "none"})[0] == 404
    assert refused("POST", "/api/v1/assets/axis/model", json={"model": "axis"})[0] == 409
    assert (
        refused("POST", "/api/v1/assets/axis/model", json={"model": "oven", "proposal": 999})[0]
        == 404
    )
    status, detail = refused("POST", "/api/v1/assets/idle/model-proposals", json={"model": "oven"})
    assert status == 409 and "0 healthy windows" in detail
    assert refused("POST", "/api/v1/assets/bare/model-proposals", json={"model": "oven"})[0] == 409
