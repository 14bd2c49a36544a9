"""A client of a running service."""

import httpx
import numpy as np
import pytest

import residuum as rs
from tests.service.api.doors import AXIS, answered, sent


@pytest.fixture(scope="module")
def client(run_service):
    with httpx.Client(base_url=run_service().url, timeout=60) as client:
        yield client


@pytest.fixture
def refused(client):
    """Send a request that must be refused: a problem document, one line, no fault of ours; gives (status, detail)."""

    def send(method, path, **request):
        answer = client.request(method, path, **request)
        assert 400 <= answer.status_code < 500, answer.text
        assert answer.headers["content-type"] == "application/problem+json"
        problem = answer.json()
        assert problem["status"] == answer.status_code and "\n" not in problem["detail"]
        return answer.status_code, problem["detail"]

    return send


@pytest.fixture(scope="module")
def axis(tmp_path_factory, client):
    """Two files of an axis with friction, the second with a column in German, and their numbers at the service."""
    force = 60.0 * np.sign(np.sin(2.0 * np.pi * 0.4 * 0.01 * np.arange(1200)))
    truth = (
        rs.model("linear-axis").with_values(M=95.0).with_effect("viscous-friction", "axis", d=40.0)
    )
    out = truth.simulate(rs.from_arrays({"force": force}, units={"force": "N"}, sample_time=0.01))
    rng = np.random.default_rng(1)
    position, velocity = (
        out[name] + 1e-3 * rng.standard_normal(1200) for name in ("position", "velocity")
    )
    found = {}
    for name in ("position", "weg"):
        path = tmp_path_factory.mktemp("axis") / f"{name}.npz"
        channels, units = (
            {"force": force, name: position, "velocity": velocity},
            {"force": "N", name: "m", "velocity": "m/s"},
        )
        rs.from_arrays(channels, units=units, sample_time=0.01).save(path)
        found[name] = path, sent(client, path)
    return found


@pytest.fixture(scope="module")
def plant_file(axis, client, tmp_path_factory):
    """The axis as an output-error model: its file, and at the service `axis`."""
    path, number = axis["position"]
    asked = AXIS | {"method": "oe", "order": 1, "delay": 1}
    file = tmp_path_factory.mktemp("plant") / "axis.json"
    rs.identify(path, **asked).save(file)
    answered(client, "identify", asked | {"records": [number], "save_as": "axis"})
    return file


@pytest.fixture(scope="module")
def short_plant(axis, client, tmp_path_factory):
    """The axis as an impulse response of 20 samples: its file, and at the service `short`."""
    path, number = axis["position"]
    asked = AXIS | {"order": 20, "delay": 1}
    file = tmp_path_factory.mktemp("short") / "axis.json"
    rs.identify(path, **asked).save(file)
    answered(client, "identify", asked | {"records": [number], "save_as": "short"})
    return file
