"""FMUs and baselines that hold one: refused unless a setting allows them, trained and judged by in a process of their own."""

import httpx
import numpy as np
import pytest

import residuum as rs
from residuum.identification.errors import BadInput, Forbidden
from residuum.identification.physics import read_model
from residuum.identification.record_formats import write_record
from residuum.service.fleet.fleet import Rescore
from residuum.service.machines.baselines import train_baseline
from residuum.service.work.worker_pool import parts_of
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
def fmu(tmp_path_factory):
    return exported(read_model(LAG), tmp_path_factory.mktemp("fmu") / "lag.fmu")


@pytest.fixture(scope="module")
def files(tmp_path_factory, fmu):
    """A baseline, and the same with an FMU that breaks down."""
    folder = tmp_path_factory.mktemp("baselines")
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


def posted(client, content, kind="fmu", name="lag"):
    return client.post("/api/v1/models", params={"name": name, "kind": kind}, content=content)


def test_an_fmu_is_stored_as_a_model_where_the_setting_allows_it(run_service, fmu):
    content = fmu.read_bytes()
    with httpx.Client(base_url=run_service().url, timeout=60) as client:
        refused = posted(client, content)
        assert refused.status_code == 403
        assert "setting allow_fmus" in refused.json()["detail"]
        assert client.get("/api/v1/models").json()["items"] == []
    with httpx.Client(base_url=run_service(allow_fmus=True).url, timeout=60) as client:
        answer = posted(client, content)
        assert answer.status_code == 201, answer.text
        (listed,) = client.get("/api/v1/models", params={"kind": "fmu"}).json()["items"]
        assert (listed["model"], listed["kind"]) == ("lag", "fmu")
        stored = client.get("/api/v1/models/lag/versions/1")
        assert stored.content == content
        assert 'filename="lag-1.fmu"' in stored.headers["content-disposition"]
        as_text = posted(client, content, kind="physical", name="text")
        assert as_text.status_code == 422
        assert "an FMU is stored as kind=fmu" in as_text.json()["detail"]
        no_fmu = posted(client, b"PK\x03\x04 nothing", name="nothing")
        assert no_fmu.status_code == 422
        assert "is not an FMU" in no_fmu.json()["detail"]


def trained(content, allowed=True, **settings):
    windows = [parts_of(window(seed)) for seed in range(6)]
    model = ("lag", content)
    given = {"free": ["T"], **settings}
    told = []
    return train_baseline(
        lambda *done: told.append(done), "model-based", windows, {}, model, given, None, allowed
    )


def test_a_baseline_is_trained_by_a_stored_fmu_in_a_process_of_its_own(fmu, tmp_path):
    with pytest.raises(Forbidden, match="allow_fmus"):
        trained(fmu.read_bytes(), allowed=False)
    outcome = trained(fmu.read_bytes())
    assert outcome["learned"]["parameters"]["T"]["value"] == pytest.approx(0.5, rel=0.02)
    file = tmp_path / "baseline"
    file.write_bytes(outcome["baseline"])
    judge = rs.load_monitor("model-based", file, allow_fmus=True)
    assert judge.score(window(22, T=0.8)).verdict == "faulty"


def test_an_fmu_that_breaks_down_in_a_training_is_told_in_one_line(fmu, tmp_path):
    with open(aborting(fmu, tmp_path), "rb") as file:
        broken = file.read()
    with pytest.raises(
        BadInput, match=r"ended the process that trained by it \(SIGABRT\); nothing"
    ):
        trained(broken)
    with pytest.raises(BadInput, match=r"'tau'.*no parameter"):
        trained(fmu.read_bytes(), free=["tau"])


def test_records_of_a_fleet_are_judged_by_an_fmu_apart(files, tmp_path):
    file = tmp_path / "window.csv"
    write_record(window(22, T=0.8), file)
    for name, verdict in (("good", "faulty"), ("broken", "not-assessable")):
        (tmp_path / name).write_bytes(files[name])
        judged = Rescore("model-based", str(tmp_path / name))(str(file))
        assert judged["finding"]["verdict"] == verdict, judged
    assert "(SIGABRT)" in judged["finding"]["reason"]
