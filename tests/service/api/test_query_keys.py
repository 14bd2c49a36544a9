"""What a query says is heeded or refused, never passed over; files over HTTP are read with the options of the command line."""

import gzip

import httpx
import numpy as np
import pytest

from residuum.diagnosis.vibration.bearings.bearing_model import faulty_bearing

ORDERS = {"bpfi": 5.4152, "bpfo": 3.5848, "bsf": 2.357, "ftf": 0.398}
TOLD = ",".join(f"{name}={order}" for name, order in ORDERS.items())
RATE = 12000
SIGNAL = faulty_bearing(RATE, RATE, 29.95, ORDERS, "bpfo", snr_db=3, seed=1)
BODY = {"sample_time": 1 / RATE, "channels": {"housing": SIGNAL.tolist()}, "units": {"housing": "m/s²"}}


def test_a_query_of_known_keys_is_heeded(client):
    answer = client.post("/api/v1/score/bearing", params={"speed_rpm": 1797, "orders": TOLD}, json=BODY)
    assert answer.json()["class"] == "outer-race"


@pytest.mark.parametrize(
    ("wrong", "nearest"), [("speed_rmp", "speed_rpm"), ("order", "orders"), ("Orders", "orders"), ("methode", "method")]
)
def test_a_misspelt_key_is_refused_with_the_nearest(refused, wrong, nearest):
    query = {"speed_rpm": 1797, "orders": TOLD} | {wrong: TOLD}
    status, detail = refused("POST", "/api/v1/score/bearing", params=query, json=BODY)
    assert status == 400 and f"query '{wrong}': is not known here; did you mean" in detail
    assert nearest in detail.partition("known are")[0] and "speed_rpm" in detail.partition("known are")[2]


@pytest.mark.parametrize(
    ("method", "path"),
    [
        ("GET", "/api/v1/records?limits=3"),
        ("GET", "/api/v1/alarms?asset_name=a"),
        ("GET", "/api/v1/diagnosers?q="),
        ("POST", "/api/v1/records?filename=a.csv&resampel=true"),
        ("POST", "/api/v1/assets/press/windows?diagnozer=bearing"),
        ("POST", "/api/v1/identify?orders=3"),
    ],
)
def test_no_route_passes_over_a_key(refused, method, path):
    status, detail = refused(method, path)
    assert status == 400 and ("is not known here" in detail or "takes no query" in detail)


def test_every_key_that_the_document_names_is_known(client):
    for path, methods in client.get("/openapi.json").json()["paths"].items():
        for method, operation in methods.items():
            named = {each["name"]: "x" for each in operation.get("parameters", []) if each["in"] == "query"}
            if named and method == "post":
                answer = client.request(method, path.replace("{", "").replace("}", ""), params=named)
                assert "is not known here" not in answer.text, path


def test_pages_are_asked_with_any_query(client):
    assert client.get("/?utm=1", follow_redirects=True).status_code == httpx.codes.OK


def table(head, rows, separator=","):
    return "\n".join([separator.join(head), *(separator.join(row) for row in rows)]) + "\n"


def test_a_record_s_units_names_and_time_are_said_in_the_query(client):
    content = table(["Stempel", "n"], [[f"{0.1 * k:.1f}", f"{60 * k}"] for k in range(40)])
    query = {"filename": "log.csv", "time": "Stempel", "time_form": "seconds", "map": "speed=n", "unit": "speed=rpm"}
    answer = client.post("/api/v1/records", params=query, content=content)
    assert answer.status_code == 201, answer.text
    assert answer.json()["units"] == {"speed": "rpm"}


def test_uneven_stamps_are_accepted_when_asked_for(client, refused):
    content = table(["time [s]", "a [V]"], [["0", "1"], ["1", "2"], ["2.5", "3"], ["3.5", "3"], ["4.5", "3"]])
    status, detail = refused("POST", "/api/v1/records?filename=a.csv", content=content)
    assert status == 422 and "resample (?resample=true) to accept it" in detail
    assert client.post("/api/v1/records?filename=a.csv&resample=true", content=content).status_code == 201


def test_a_sample_time_is_taken_from_the_query(client, refused):
    io, sio = pytest.importorskip("io"), pytest.importorskip("scipy.io")
    file = io.BytesIO()
    sio.savemat(file, {"x": np.arange(50.0)[:, None]})
    status, detail = refused("POST", "/api/v1/records?filename=a.mat", content=file.getvalue())
    assert status == 422 and detail == "a.mat: does not say its sample time; give it with ?sample_time=SECONDS"
    answer = client.post("/api/v1/records?filename=a.mat&sample_time=0.01&unit=x=V", content=file.getvalue())
    assert answer.status_code == 201 and answer.json()["sample_time"] == pytest.approx(0.01)


def test_a_scored_file_is_read_with_the_same_options(client, refused):
    content = table(["time [s]", "vib"], [[f"{k / RATE:.9f}", f"{v:.6f}"] for k, v in enumerate(SIGNAL)])
    query = {"speed_rpm": 1797, "orders": TOLD, "unit": "vib=m/s**2", "map": "housing=vib"}
    headers = {"content-type": "text/csv"}
    answer = client.post("/api/v1/score/bearing", params=query, content=content, headers=headers)
    assert answer.json()["class"] == "outer-race" and answer.json()["units"]["rms"] == "m/s²", answer.text
    status, detail = refused("POST", "/api/v1/score/bearing", params=query, json=BODY)
    assert status == 422 and "query, unit: is an option for files" in detail
    status, detail = refused("POST", "/api/v1/score/bearing?map=housing", content=content, headers=headers)
    assert status == 422 and "map 'housing': must be NAME=COLUMN" in detail
    status, detail = refused("POST", "/api/v1/score/bearing?resample=perhaps", content=content, headers=headers)
    assert status == 422 and "neither true nor false" in detail


def test_the_column_of_times_is_said_once(refused):
    content = table(["Stempel", "Zeit", "n [V]"], [[f"{k}", f"{2 * k}", "1"] for k in range(9)])
    for both in ("time=Stempel&time_column=Zeit", "time=Stempel&map=time=Zeit"):
        status, detail = refused("POST", f"/api/v1/records?filename=a.csv&{both}", content=content)
        assert status == 400 and "are one option" in detail and "give one of them" in detail


def test_a_file_without_a_time_is_told_each_key_that_gives_one(client, refused):
    content = table(["Stempel", "n [V]"], [[f"{0.1 * k:.1f}", "1"] for k in range(9)])
    status, detail = refused("POST", "/api/v1/records?filename=a.csv", content=content)
    assert status == 422 and "residuum" not in detail and "--" not in detail
    for key in ("name it with ?time=COLUMN", "?time_form=seconds where the first is an axis", "give ?sample_time=SECONDS"):
        assert key in detail, detail
    assert client.post("/api/v1/records?filename=a.csv&sample_time=0.1", content=content).json()["units"] == {
        "Stempel": "",
        "n": "V",
    }


def test_refusals_name_the_key_that_helps(client, refused):
    either = table(["Time", "n [V]"], [[f"00:{k:02d}", "1"] for k in range(20)])
    status, detail = refused("POST", "/api/v1/records?filename=a.csv", content=either)
    assert status == 422 and detail.endswith("say ?time_form='hh:mm' or ?time_form='mm:ss'")
    assert client.post("/api/v1/records?filename=a.csv&time_form=mm:ss", content=either).status_code == 201
    content = table(
        ["time [s]", "vib [m/s**2]", "speed"], [[f"{k / RATE:.9f}", f"{v:.6f}", "1797"] for k, v in enumerate(SIGNAL)]
    )
    headers = {"content-type": "text/csv"}
    status, detail = refused("POST", f"/api/v1/score/bearing?orders={TOLD}", content=content, headers=headers)
    assert status == 422 and "?unit=speed=rpm" in detail and "--" not in detail


def test_a_file_of_an_older_format_is_taken(client, refused):
    status, detail = refused("POST", "/api/v1/records?filename=old.mdf", content=b"nothing")
    assert status == 422 and "is not an MDF file" in detail


def test_wrapped_bodies_and_words_for_no_number_are_refused_with_the_way_on(refused):
    scored, headers = "/api/v1/score/bearing", {"content-type": "application/json"}
    for path in (scored, "/api/v1/records?filename=a.csv", "/api/v1/identify"):
        status, detail = refused("POST", path, content=gzip.compress(b"{}"), headers=headers | {"content-encoding": "gzip"})
        assert status == 415 and "send it uncompressed" in detail
        status, detail = refused("POST", path, files={"file": ("a.csv", b"time [s],a [V]\n0,1\n1,2\n")})
        assert status == 415 and "not as a form" in detail
    for word in ("NaN", "Infinity", "-Infinity"):
        content = '{"sample_time":0.1,"units":{"a":"V"},"channels":{"a":[1,µ]}}'.replace("µ", word)
        status, detail = refused("POST", scored, content=content, headers=headers)
        assert status == 400 and "JSON has neither NaN nor Infinity, a missing sample is null" in detail


def test_a_resampled_channel_is_told_by_its_name(client):
    content = table(["time [s]", "a [V]"], [["0", "1"], ["1", "2"], ["2.5", "3"], ["3.5", "3"], ["4.5", "3"]])
    notes = client.post("/api/v1/records?filename=a.csv&resample=true", content=content).json()["notes"]
    assert notes[0].startswith("a resampled to 1 s")


def test_a_cell_that_means_no_value_is_said_in_the_query(client, refused):
    """What a mapping settles for the commands is a key here; the refusal names it."""
    content = table(["Time (s)", "U (V)"], [[f"{k}", "OL" if k == 7 else f"{20 + k / 4}"] for k in range(60)])
    status, detail = refused("POST", "/api/v1/records?filename=a.csv", content=content)
    assert status == 422 and detail.endswith("say ?missing=OL")
    stored = client.post("/api/v1/records?filename=a.csv&missing=OL", content=content)
    assert stored.status_code == 201 and stored.json()["n"] == 60
