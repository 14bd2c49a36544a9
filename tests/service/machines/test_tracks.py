"""Parameters over many windows by HTTP: a drift with its limit, a repair, a temperature taken off, and the recorded windows."""

import time

import httpx
import numpy as np
import pytest

from residuum.diagnosis.finding import Finding
from residuum.identification.record import Record
from residuum.service.machines.tracks import follow

DAY = 86_400.0


def told(values, std, temperatures=None):
    band = {"low": 0.9, "high": 1.1}
    rows = []
    for k, value in enumerate(values):
        parameters = {"R": {"value": value, "std": std, "unit": "ohm", "healthy": band}}
        conditions = (
            {} if temperatures is None else {"winding": {"mean": temperatures[k], "unit": "degC"}}
        )
        rows.append(
            {
                "at": k * DAY,
                "window": k + 1,
                "verdict": "healthy",
                "parameters": parameters,
                "conditions": conditions,
            }
        )
    return rows


def quiet(_share, _doing):
    pass


def test_a_drift_has_a_time_until_its_limit():
    rng = np.random.default_rng(1)
    rows = told(1.0 + 0.01 * np.arange(40) + 0.02 * rng.standard_normal(40), 0.02)
    (item,) = follow(quiet, rows, {"R": 1.8}, None)["items"]
    left = item["track"]["remaining"]
    assert item["track"]["kind"] == "drift" and left["low"] < 41 * DAY < left["high"]


def test_what_a_temperature_does_is_taken_off():
    rng = np.random.default_rng(2)
    temperatures = 20.0 + 0.5 * np.arange(40) + 3.0 * rng.standard_normal(40)
    rows = told(1.0 + 0.004 * temperatures + 0.002 * rng.standard_normal(40), 0.002, temperatures)
    (item,) = follow(quiet, rows, {}, None)["items"]
    assert item["moves_with"] == ["winding"] and item["track"]["kind"] == "steady"
    assert follow(quiet, rows, {}, [])["items"][0]["track"]["kind"] == "drift"


def test_too_few_windows_are_said():
    (item,) = follow(quiet, told([1.0] * 4, 0.1), {}, None)["items"]
    assert item["track"] is None and item["reason"] == "4 windows tell it; at least 8 are needed"


@pytest.fixture
def fan(run_service):
    service = run_service()
    rng = np.random.default_rng(3)
    for k in range(20):
        # an even clock of its own: a store that is held up for a while must not bend the drift
        at = 1_790_000_000.0 + 60.0 * k
        record = Record({"speed": rng.standard_normal(100)}, {"speed": "rad/s"}, 0.01, t0=at)
        value = {
            "value": 1.0 + 0.05 * k + 0.01 * rng.standard_normal(),
            "std": 0.01,
            "unit": "ohm",
            "healthy": None,
        }
        finding = Finding(
            "model-based", "healthy", reason="-", evidence={"parameters": {"R": value}}
        )
        service.services.store.add_window("fan", record, finding)
    return service


def test_limits_are_kept_and_parameters_followed_over_http(fan):
    with httpx.Client(base_url=f"{fan.url}/api/v1", timeout=60) as client:
        assert client.put("/assets/fan/limits", json={"limits": {"R": 3.0}}).json() == {
            "limits": {"R": 3.0}
        }
        job = client.post("/assets/fan/tracks", json={}).json()
        while (job := client.get(f"/jobs/{job['id']}").json())["state"] in ("queued", "running"):
            time.sleep(0.2)
        (item,) = job["result"]["items"]
        assert (
            item["limit"] == 3.0 and item["track"]["kind"] == "drift" and len(item["value"]) == 20
        )
        assert client.get("/models").json()["items"] == []  # limits are no model


def test_a_window_without_a_baseline_raises_no_alarm_and_waits(run_service):
    service = run_service()
    store = service.services.store
    numbers = [
        store.add_window(
            "press",
            Record({"y": np.arange(50.0)}, {"y": "V"}, 0.01, t0=float(k)),
            Finding.recorded("model-based"),
        )
        for k in range(3)
    ]
    assert list(store.recorded_windows("press")) == numbers
    assert store.asset("press").to_json()["state"] == "no-baseline"
    assert store.alarms("press").items == []
