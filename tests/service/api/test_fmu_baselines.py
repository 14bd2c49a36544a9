"""Baselines that hold an FMU: refused unless a setting allows them, and judged by in a process of their own."""

import httpx
import numpy as np
import pytest

import residuum as rs
from residuum.identification.physics import read_model
from tests.identification.physics.fmu_files import aborting, exported, with_another_fmu

pytest.importorskip("fmpy")
LAG = """
name: lag
inputs: {drive: ""}
states: {level: {unit: ""}}
parameters: {T: {value: 0.4, unit: s, lower: 0.01}}
balances:
  lag: {kind: signal, storage: T * der(level), terms: {in: 2 * drive, out: -level}}
outputs: {reading: {value: level, unit: ""}}
"""
BASELINE = {"kind": "baseline", "diagnoser": "model-based"}


def window(seed, T=0.5, n=80, dt=0.05):
    """T dx/dt = 2 u − x with held u, solved exactly."""
    rng = np.random.default_rng([seed, 5])
    u = np.repeat(rng.uniform(-5.0, 5.0, n // 8), 8)
    x = np.zeros(n)
    for k in range(n - 1):
        x[k + 1] = 2.0 * u[k] + (x[k] - 2.0 * u[k]) * np.exp(-dt / T)
    y = x + 0.02 * rng.standard_normal(n)
    units = {"drive": "", "reading": ""}
    return rs.from_arrays({"drive": u, "reading": y}, units=units, sample_time=dt)


def as_body(record):
    return {
        "channels": {name: record[name].tolist() for name in record.names},
        "units": dict(record.units),
        "sample_time": record.sample_time,
    }


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A baseline, and the same with an FMU that breaks down."""
    folder = tmp_path_factory.mktemp("baselines")
    fmu = exported(read_model(LAG), folder / "lag.fmu")
    good = folder / "good.npz"
    rs.monitor(rs.fmu(fmu), free=["T"]).fit([window(seed) for seed in range(6)]).save(good)
    with open(aborting(fmu, folder, calls=50), "rb") as file:
        broken = with_another_fmu(good, folder / "broken.npz", file.read())
    return {"good": good.read_bytes(), "broken": (folder / broken).read_bytes()}


def stored(client, name, content):
    return client.post("/api/v1/models", params={"name": name, **BASELINE}, content=content)


def test_a_service_that_was_not_told_to_runs_none(run_service, files):
    with httpx.Client(base_url=run_service().url, timeout=60) as client:
        answer = stored(client, "good", files["good"])
        assert answer.status_code == 403, answer.text
        assert "holds an FMU" in answer.json()["detail"]
        assert "setting allow_fmus" in answer.json()["detail"]
        assert client.get("/api/v1/models").json()["items"] == []


def test_windows_are_judged_apart_from_the_service(run_service, files):
    service = run_service(allow_fmus=True)
    with httpx.Client(base_url=service.url, timeout=120) as client:
        for name, content in files.items():
            answer = stored(client, name, content)
            assert answer.status_code == 201, answer.text
        found = {}
        for name, record in (
            ("good", window(21)),
            ("broken", window(21)),
            ("good", window(22, T=0.8)),
        ):
            answer = client.post(
                f"/api/v1/assets/{name}/windows",
                params={"diagnoser": "model-based"},
                json=as_body(record),
            )
            assert answer.status_code == 201, answer.text
            found.setdefault(name, []).append(answer.json()["finding"])
        assert [finding["verdict"] for finding in found["good"]] == ["healthy", "faulty"]
        (ended,) = found["broken"]
        assert ended["verdict"] == "not-assessable"
        assert "ended the process that judged by it (SIGABRT)" in ended["reason"]
        assert client.get("/health/ready").status_code == 200
