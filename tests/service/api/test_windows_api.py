"""Windows over HTTP: every form of body gives what the diagnoser says of the record itself; nothing is stored twice or half."""

import io
import zipfile
from pathlib import Path

import numpy as np
import pytest

from residuum.diagnosis.diagnosers import DIAGNOSERS
from residuum.identification.record import Record
from residuum.identification.record_formats import write_record

BEARING = "/api/v1/score/bearing"
WINDOWS = "/api/v1/assets/press/windows"


@pytest.fixture(scope="module")
def example():
    return DIAGNOSERS["bearing"].examples()[0]


@pytest.fixture(scope="module")
def faulty(example):
    return example.faulty[0]


def npy(*rows):
    file = io.BytesIO()
    np.save(file, rows[0] if len(rows) == 1 else np.stack(rows))
    return file.getvalue()


def as_json(record):
    channels = {
        name: [None if np.isnan(value) else float(value) for value in record[name]]
        for name in record.names
    }
    return {
        "sample_time": record.sample_time,
        "t0": record.t0,
        "channels": channels,
        "units": dict(record.units),
    }


def file_bytes(record, path):
    write_record(record, path)
    return path.read_bytes()


def same(answer, said):
    """Whether an answer says what the diagnoser said (the indicators to the last digits of a double)."""
    for name in ("diagnoser", "verdict", "class", "reason", "thresholds", "units"):
        assert answer[name] == said[name], name
    return answer["indicators"] == pytest.approx(said["indicators"], rel=1e-12)


def test_every_form_of_body_gets_the_same_finding_as_the_diagnoser_itself(client, faulty, tmp_path):
    said = DIAGNOSERS["bearing"]().score(faulty).to_json()
    heads = [f"{name} [{unit}]" for name, unit in faulty.units.items()]
    query = {"sample_time": faulty.sample_time, "channel": heads}
    binary = {"content-type": "application/octet-stream"}
    rows = [faulty[name] for name in faulty.names]
    before = client.get("/api/v1/assets").json()["items"]
    answers = [
        client.post(BEARING, json=as_json(faulty)),
        client.post(BEARING, params=query, content=npy(*rows), headers=binary),
        client.post(
            BEARING,
            params=query,
            content=npy(*[np.asarray(row, ">f8") for row in rows]),
            headers=binary,
        ),
        client.post(
            BEARING,
            content=file_bytes(faulty, tmp_path / "w.npz"),
            headers={"content-type": "application/zip"},
        ),
    ]
    for answer in answers:
        assert answer.status_code == 200, answer.text
        assert same(answer.json(), said)
    csv = client.post(
        BEARING,
        content=file_bytes(faulty, tmp_path / "w.csv"),
        headers={"content-type": "text/csv"},
    )
    assert csv.json()["verdict"] == said["verdict"]
    assert client.get("/api/v1/assets").json()["items"] == before, "scoring stores nothing"


def test_a_stored_window_is_answered_once_and_looked_at_again(client, faulty):
    body, key = as_json(faulty), {"Idempotency-Key": "window-0001"}
    first = client.post(WINDOWS, params={"diagnoser": "bearing"}, json=body, headers=key)
    assert first.status_code == 201 and first.json()["finding"]["diagnoser"] == "bearing"
    again = client.post(WINDOWS, params={"diagnoser": "bearing"}, json=body, headers=key)
    assert (again.status_code, again.json()) == (201, first.json())
    assert len(client.get(WINDOWS).json()["items"]) == 1
    other = client.post(
        WINDOWS, params={"diagnoser": "bearing"}, json=body | {"t0": 5.0}, headers=key
    )
    assert other.status_code == 409 and "another window" in other.json()["detail"]
    place = client.get(first.headers["location"])
    assert place.json() == first.json()
    assert client.get("/api/v1/assets/press/findings").json()["items"][0] == first.json()["finding"]


def test_an_asset_is_judged_by_the_baseline_of_its_name(client, example, tmp_path):
    trained = DIAGNOSERS["bearing"]().fit(example.training, example.labels)
    trained.save(tmp_path / "baseline.zip")
    stored = client.post(
        "/api/v1/models",
        params={"name": "fan", "kind": "baseline", "diagnoser": "bearing"},
        content=(tmp_path / "baseline.zip").read_bytes(),
    )
    assert stored.status_code == 201, stored.text
    for record, path in (
        (example.healthy[0], "/api/v1/assets/fan/windows"),
        (example.faulty[0], "/api/v1/score/bearing?baseline=fan"),
    ):
        answer = client.post(
            path, params=None if "?" in path else {"diagnoser": "bearing"}, json=as_json(record)
        ).json()
        said = trained.score(record).to_json()
        assert same(answer.get("finding", answer), said)
    query = {"baseline": "fan", "speed_rpm": 900, "orders": "bpfi=5.4"}
    answer = client.post(
        "/api/v1/score/bearing", params=query, json=as_json(example.faulty[0])
    ).json()
    judge = trained.with_settings(speed_rpm=900.0, orders={"bpfi": 5.4})
    assert (
        same(answer, judge.score(example.faulty[0]).to_json()) and answer["class"] != said["class"]
    )


def test_the_method_that_decides_is_chosen_by_the_query(client, tmp_path):
    case = DIAGNOSERS["robust-residual"].examples()[0]
    trained = DIAGNOSERS["robust-residual"]().fit(case.training)
    trained.save(tmp_path / "plant.zip")
    query = {"name": "plant", "kind": "baseline", "diagnoser": "robust-residual"}
    assert (
        client.post(
            "/api/v1/models", params=query, content=(tmp_path / "plant.zip").read_bytes()
        ).status_code
        == 201
    )
    for method in ("source", "default"):
        said = trained.with_settings(method=method).score(case.faulty[1]).to_json()
        query = {"baseline": "plant", "method": method}
        assert same(
            client.post(
                "/api/v1/score/robust-residual", params=query, json=as_json(case.faulty[1])
            ).json(),
            said,
        )
        query = {"diagnoser": "robust-residual", "method": method}
        stored = client.post(
            "/api/v1/assets/plant/windows", params=query, json=as_json(case.faulty[1])
        ).json()
        assert stored["finding"]["evidence"]["method"] == method
    answer = client.post("/api/v1/score/bearing?method=source", json=as_json(case.faulty[1]))
    assert 400 <= answer.status_code < 500
    assert "must be default" in answer.json()["detail"]


def test_a_signal_never_loses_its_largest_peak_however_far_it_is_reduced(client):
    rng = np.random.default_rng(3)
    signal = rng.normal(size=1_000_000)
    spikes = {123_457: 60.0, 700_001: -75.0}
    for place, height in spikes.items():
        signal[place] = height
    signal[500_000:500_100] = np.nan
    body = npy(np.asarray(signal, np.float32))
    query = {"diagnoser": "bearing", "sample_time": 1e-4, "channel": "acceleration [m/s²]"}
    stored = client.post(
        "/api/v1/assets/long/windows",
        params=query,
        content=body,
        headers={"content-type": "application/octet-stream"},
    )
    assert stored.status_code == 201, stored.text
    place = stored.headers["location"]
    for points in (10, 333, 2000):
        view = client.get(f"{place}/signal", params={"points": points}).json()
        channel = view["channels"]["acceleration"]
        highest, lowest = np.array(channel["maximum"], float), np.array(channel["minimum"], float)
        assert len(highest) <= points and np.nanmax(highest) == 60.0 and np.nanmin(lowest) == -75.0
        assert (
            int(np.nanargmax(highest) * view["interval"] * 1e4)
            <= 123_457
            < int((np.nanargmax(highest) + 1) * view["interval"] * 1e4)
        )
    near = client.get(f"{place}/signal", params={"from": 12.34, "to": 12.36}).json()
    assert (
        not near["reduced"]
        and near["start"] == pytest.approx(12.34)
        and max(near["channels"]["acceleration"]["values"]) == 60.0
    )
    gap = client.get(f"{place}/signal", params={"from": 49.99, "to": 50.02}).json()["channels"][
        "acceleration"
    ]["values"]
    assert gap.count(None) == 100
    refused = client.get(f"{place}/signal", params={"from": 200})
    assert refused.status_code == 422 and "no sample" in refused.json()["detail"]


def test_the_spectrum_shows_a_sine_with_its_amplitude(client):
    t = np.arange(20_000) / 10_000
    record = Record({"u": 2.5 * np.sin(2 * np.pi * 440 * t) + 7}, {"u": "V"}, 1e-4)
    stored = client.post(
        "/api/v1/assets/tone/windows", params={"diagnoser": "robust-residual"}, json=as_json(record)
    )
    # the diagnoser wants its own channels; the view does not depend on it
    if stored.status_code == 422:
        record = Record(
            {"acceleration": record["u"], "speed": np.full(record.n, 1500.0)},
            {"acceleration": "m/s²", "speed": "rpm"},
            1e-4,
        )
        stored = client.post(
            "/api/v1/assets/tone/windows", params={"diagnoser": "bearing"}, json=as_json(record)
        )
    spectrum = client.get(f"{stored.headers['location']}/spectrum", params={"points": 5000}).json()
    peak = int(np.argmax(spectrum["amplitude"]))
    assert peak * spectrum["step"] == pytest.approx(440, abs=spectrum["step"])
    assert spectrum["amplitude"][peak] == pytest.approx(2.5, rel=1e-3)


def test_records_are_uploaded_read_and_shown(client, faulty, tmp_path):
    name = "<script>alert(1)</script> 😈 \u202eevil.csv"
    stored = client.post(
        "/api/v1/records", params={"filename": name}, content=file_bytes(faulty, tmp_path / "a.csv")
    )
    assert stored.status_code == 201, stored.text
    assert (stored.json()["name"], stored.json()["n"], stored.json()["units"]) == (
        name,
        faulty.n,
        dict(faulty.units),
    )
    number = stored.json()["id"]
    view = client.get(
        f"/api/v1/records/{number}/signal", params={"channel": "acceleration", "points": 100}
    ).json()
    assert max(view["channels"]["acceleration"]["maximum"]) == pytest.approx(
        faulty["acceleration"].max()
    )


def test_an_npz_bomb_is_refused_before_it_is_unpacked(refused):
    file = io.BytesIO()
    with (
        zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive,
        archive.open("y.npy", "w", force_zip64=True) as member,
    ):
        member.write(npy(np.zeros(8))[:128])
        for _ in range(600):
            member.write(bytes(2**20))
    status, detail = refused(
        "POST", BEARING, content=file.getvalue(), headers={"content-type": "application/zip"}
    )
    assert status == 413 and "unpacked" in detail


def test_a_can_log_is_a_record_by_a_dbc_file_that_the_service_knows(client, refused):
    log = (Path(__file__).parents[2] / "recorded" / "gate_actuator.blf").read_bytes()
    stored = client.post(
        "/api/v1/records", params={"filename": "drive.blf", "dbc": "gate_actuator.dbc"}, content=log
    )
    assert stored.status_code == 201, stored.text
    assert (
        set(stored.json()["units"]) >= {"speed", "current", "voltage", "phase"}
        and stored.json()["n"] > 1000
    )
    for query, says in (
        ("filename=drive.blf", "dbc) go together"),
        ("filename=drive.csv&dbc=gate_actuator.dbc", "dbc) go together"),
        (
            "filename=drive.blf&dbc=/etc/passwd",
            "no machine has a DBC file of this name; known are gate_actuator.dbc",
        ),
    ):
        status, detail = refused("POST", f"/api/v1/records?{query}", content=log)
        assert status == 422 and says in detail
    of_log = {
        "filename": "drive.blf",
        "dbc": "gate_actuator.dbc",
        "speed_rpm": 1797,
        "orders": "bpfo=3.5848",
    }
    status, detail = refused("POST", "/api/v1/score/bearing", params=of_log, content=log)
    assert (
        status == 422
        and "has no channel with a unit of acceleration" in detail
        and "'speed': 'rad/s'" in detail
    )
    status, detail = refused("POST", "/api/v1/score/bearing?dbc=gate_actuator.dbc", content=log)
    assert status == 400 and "go together for a body that is a log" in detail
    status, detail = refused(
        "POST", "/api/v1/records?filename=x.blf&dbc=gate_actuator.dbc", content=b"LOGG nonsense"
    )
    assert status == 422 and detail.startswith("x.blf: cannot be read as a CAN log")
