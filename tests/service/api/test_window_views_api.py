"""Kurtogram, envelope spectrum and residual of a stored window."""

import httpx
import numpy as np
import pytest
from scipy.signal import lfilter

from residuum.diagnosis.diagnosers import DIAGNOSERS
from residuum.diagnosis.finding import Finding
from residuum.identification.record import Record

RATE, RESONANCE, IMPACTS = 10_000, 3000.0, 40.0  # Hz


@pytest.fixture(scope="module")
def service(run_service):
    service = run_service()
    store = service.services.store
    rng = np.random.default_rng(4)
    t = np.arange(2 * RATE) / RATE
    ringing = np.exp(-600 * (t % (1 / IMPACTS))) * np.sin(2 * np.pi * RESONANCE * t)
    vibration = Record(
        {"speed": np.full(t.size, 25.0), "a": ringing + 0.05 * rng.normal(size=t.size)},
        {"speed": "Hz", "a": "g"},
        1 / RATE,
    )
    healthy = Finding("bearing", "healthy", None, {"rms": 0.2}, {"rms": 1.0}, {}, {}, None)
    store.add_window("fan", vibration, healthy)
    holed = Record({"a": np.where(t > 1, np.nan, 0.1)}, {"a": "g"}, 1 / RATE)
    store.add_window("fan", holed, healthy)
    judge = DIAGNOSERS["robust-residual"]().fit([plant(1, 3000)])
    judge.save(service.services.settings.data / "trained")
    store.add_model_version(
        "plant", "baseline", (service.services.settings.data / "trained").read_bytes()
    )
    faulty = plant(2, 600, offset=2.0)
    store.add_window("plant", faulty, judge.score(faulty))
    return service


@pytest.fixture
def client(service):
    with httpx.Client(base_url=service.url, timeout=60) as client:
        yield client


def plant(seed, n, offset=0.0):
    rng = np.random.default_rng(seed)
    u = rng.normal(size=n)
    y = lfilter([0, 0.6], [1, -0.8], u) + 0.3 * rng.normal(size=n) + offset * (np.arange(n) >= 400)
    return Record({"u": u, "y": y}, {"u": "V", "y": "m"}, 0.1)


def test_the_kurtogram_points_to_the_resonance(client):
    found = client.get("/api/v1/assets/fan/windows/1/kurtogram", params={"channel": "a"}).json()
    assert (
        abs(found["best"]["centre"] - RESONANCE) < 0.6 * found["best"]["width"] + 300
        and found["best"]["kurtosis"] > 1
    )
    assert len(found["kurtosis"]) == len(found["level"]) and len(found["kurtosis"][0]) == len(
        found["frequency"]
    )


def test_the_envelope_has_the_rhythm_of_the_impacts(client):
    path = "/api/v1/assets/fan/windows/1/envelope"
    for band in ({}, {"low": 2500, "high": 3500}):
        found = client.get(path, params={"channel": "a", **band}).json()
        loudest = (np.argmax(found["amplitude"]) + 1) * found["step"]
        assert loudest == pytest.approx(IMPACTS, abs=2 * found["step"]) and found["unit"] == "g"


def test_the_residual_leaves_its_threshold_when_the_fault_comes(client):
    found = client.get("/api/v1/assets/plant/windows/3/residual").json()
    statistic = np.array([value or 0.0 for value in found["statistic"]])
    first = found["time"][int(np.argmax(statistic > found["threshold"]))]
    assert 40 <= first < 42 and found["unit"] == "m"
    assert max(value for value in found["highest"][410:] if value is not None) > 1.5


def test_what_cannot_be_drawn_is_refused(refused):
    windows = "/api/v1/assets/fan/windows"
    assert refused("GET", f"{windows}/1/residual")[0] == 409
    assert refused("GET", f"{windows}/1/kurtogram?channel=none")[0] == 404
    assert refused("GET", f"{windows}/1/envelope?low=10")[0] == 422
    assert refused("GET", f"{windows}/1/envelope?channel=a&low=4000&high=3000")[0] == 422
    status, detail = refused("GET", f"{windows}/2/kurtogram")
    assert status == 422 and "missing samples" in detail


def test_the_pictures_that_a_diagnoser_names_are_questions_about_a_window_or_its_machine(client):
    known = client.get("/openapi.json").json()["paths"]
    named = {
        each["name"]: each["views"] for each in client.get("/api/v1/diagnosers").json()["items"]
    }
    assert named["robust-residual"] == ["residual"] and named["gate-actuator"] == [
        "decision-regions"
    ]
    assert named["model-based"] == ["tracks"]
    asked = ("/api/v1/assets/{asset}/windows/{window}/", "/api/v1/assets/{asset}/")
    assert all(
        any(about + view in known for about in asked) for views in named.values() for view in views
    )


def test_the_failure_modes_say_whose_they_are(client):
    assert client.get("/api/v1/failure-modes").json()["machine"] in DIAGNOSERS
