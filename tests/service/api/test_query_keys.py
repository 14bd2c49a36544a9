"""What a query says is heeded or refused, never passed over; files over HTTP are read with the options of the command line."""

import gzip
import io
import json

import httpx
import numpy as np
import pytest

from residuum.diagnosis.vibration.moving_lines import faulty_bearing
from tests.identification.record_formats.left_open import LEFT_OPEN

ORDERS = {"bpfi": 5.4152, "bpfo": 3.5848, "bsf": 2.357, "ftf": 0.398}
TOLD = ",".join(f"{name}={order}" for name, order in ORDERS.items())
RATE = 12000
SIGNAL = faulty_bearing(RATE, RATE, 29.95, ORDERS, "bpfo", snr_db=3, seed=1)
BODY = {
    "sample_time": 1 / RATE,
    "channels": {"housing": SIGNAL.tolist()},
    "units": {"housing": "m/s²"},
}


def test_a_query_of_known_keys_is_heeded(client):
    answer = client.post(
        "/api/v1/score/bearing", params={"speed_rpm": 1797, "orders": TOLD}, json=BODY
    )
    assert answer.json()["class"] == "outer-race"


@pytest.mark.parametrize(
    ("wrong", "nearest"),
    [("speed_rmp", "speed_rpm"), ("order", "orders"), ("Orders", "orders"), ("methode", "method")],
)
def test_a_misspelt_key_is_refused_with_the_nearest(refused, wrong, nearest):
    query = {"speed_rpm": 1797, "orders": TOLD} | {wrong: TOLD}
    status, detail = refused("POST", "/api/v1/score/bearing", params=query, json=BODY)
    assert status == 400 and f"query '{wrong}': is not known here; did you mean" in detail
    assert (
        nearest in detail.partition("known are")[0]
        and "speed_rpm" in detail.partition("known are")[2]
    )


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
            named = {
                each["name"]: "x"
                for each in operation.get("parameters", [])
                if each["in"] == "query"
            }
            if named and method == "post":
                answer = client.request(
                    method, path.replace("{", "").replace("}", ""), params=named
                )
                assert "is not known here" not in answer.text, path


def test_pages_are_asked_with_any_query(client):
    assert client.get("/?utm=1", follow_redirects=True).status_code == httpx.codes.OK


def table(head, rows, separator=","):
    return "\n".join([separator.join(head), *(separator.join(row) for row in rows)]) + "\n"


def test_a_record_s_units_names_and_time_are_said_in_the_query(client):
    content = table(["Stempel", "n"], [[f"{0.1 * k:.1f}", f"{60 * k}"] for k in range(40)])
    query = {
        "filename": "log.csv",
        "time": "Stempel",
        "time_form": "seconds",
        "map": "speed=n",
        "unit": "speed=rpm",
    }
    answer = client.post("/api/v1/records", params=query, content=content)
    assert answer.status_code == 201, answer.text
    assert answer.json()["units"] == {"speed": "rpm"}


def test_uneven_stamps_are_accepted_when_asked_for(client, refused):
    content = table(
        ["time [s]", "a [V]"], [["0", "1"], ["1", "2"], ["2.5", "3"], ["3.5", "3"], ["4.5", "3"]]
    )
    status, detail = refused("POST", "/api/v1/records?filename=a.csv", content=content)
    assert status == 422 and "say ?resample=true to accept it" in detail
    assert (
        client.post("/api/v1/records?filename=a.csv&resample=true", content=content).status_code
        == 201
    )


def test_a_sample_time_is_taken_from_the_query(client, refused):
    io, sio = pytest.importorskip("io"), pytest.importorskip("scipy.io")
    file = io.BytesIO()
    sio.savemat(file, {"x": np.arange(50.0)[:, None]})
    status, detail = refused("POST", "/api/v1/records?filename=a.mat", content=file.getvalue())
    assert (
        status == 422 and detail == "a.mat: does not say its sample time; say ?sample_time=SECONDS"
    )
    answer = client.post(
        "/api/v1/records?filename=a.mat&sample_time=0.01&unit=x=V", content=file.getvalue()
    )
    assert answer.status_code == 201 and answer.json()["sample_time"] == pytest.approx(0.01)


def test_a_scored_file_is_read_with_the_same_options(client, refused):
    content = table(
        ["time [s]", "vib"], [[f"{k / RATE:.9f}", f"{v:.6f}"] for k, v in enumerate(SIGNAL)]
    )
    query = {"speed_rpm": 1797, "orders": TOLD, "unit": "vib=m/s**2", "map": "housing=vib"}
    headers = {"content-type": "text/csv"}
    answer = client.post("/api/v1/score/bearing", params=query, content=content, headers=headers)
    assert answer.json()["class"] == "outer-race" and answer.json()["units"]["rms"] == "m/s²", (
        answer.text
    )
    status, detail = refused("POST", "/api/v1/score/bearing", params=query, json=BODY)
    assert status == 422 and "query, unit: is an option for files" in detail
    status, detail = refused(
        "POST", "/api/v1/score/bearing?map=housing", content=content, headers=headers
    )
    assert status == 422 and "map 'housing': must be NAME=COLUMN" in detail
    status, detail = refused(
        "POST", "/api/v1/score/bearing?resample=perhaps", content=content, headers=headers
    )
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
    for key in (
        "or say ?time=COLUMN, or",
        "?time_form=seconds where the first is an axis",
        "or ?sample_time=SECONDS where",
    ):
        assert key in detail, detail
    assert client.post("/api/v1/records?filename=a.csv&sample_time=0.1", content=content).json()[
        "units"
    ] == {
        "Stempel": "",
        "n": "V",
    }


def test_refusals_name_the_key_that_helps(client, refused):
    either = table(["Time", "n [V]"], [[f"00:{k:02d}", "1"] for k in range(20)])
    status, detail = refused("POST", "/api/v1/records?filename=a.csv", content=either)
    assert status == 422 and detail.endswith("say ?time_form=hh:mm or ?time_form=mm:ss")
    assert (
        client.post("/api/v1/records?filename=a.csv&time_form=mm:ss", content=either).status_code
        == 201
    )
    content = table(
        ["time [s]", "vib [m/s**2]", "speed"],
        [[f"{k / RATE:.9f}", f"{v:.6f}", "1797"] for k, v in enumerate(SIGNAL)],
    )
    headers = {"content-type": "text/csv"}
    status, detail = refused(
        "POST", f"/api/v1/score/bearing?orders={TOLD}", content=content, headers=headers
    )
    assert status == 422 and "?unit=speed=rpm" in detail and "--" not in detail


def test_a_file_of_an_older_format_is_taken(client, refused):
    status, detail = refused("POST", "/api/v1/records?filename=old.mdf", content=b"nothing")
    assert status == 422 and "is not an MDF file" in detail


def test_wrapped_bodies_and_words_for_no_number_are_refused_with_the_way_on(refused):
    scored, headers = "/api/v1/score/bearing", {"content-type": "application/json"}
    for path in (scored, "/api/v1/records?filename=a.csv", "/api/v1/identify"):
        status, detail = refused(
            "POST",
            path,
            content=gzip.compress(b"{}"),
            headers=headers | {"content-encoding": "gzip"},
        )
        assert status == 415 and "send it uncompressed" in detail
        status, detail = refused(
            "POST", path, files={"file": ("a.csv", b"time [s],a [V]\n0,1\n1,2\n")}
        )
        assert status == 415 and "not as a form" in detail
    for word in ("NaN", "Infinity", "-Infinity"):
        content = '{"sample_time":0.1,"units":{"a":"V"},"channels":{"a":[1,µ]}}'.replace("µ", word)
        status, detail = refused("POST", scored, content=content, headers=headers)
        assert (
            status == 400
            and "JSON has neither NaN nor Infinity, a missing sample is null" in detail
        )


def test_a_resampled_channel_is_told_by_its_name(client):
    content = table(
        ["time [s]", "a [V]"], [["0", "1"], ["1", "2"], ["2.5", "3"], ["3.5", "3"], ["4.5", "3"]]
    )
    notes = client.post("/api/v1/records?filename=a.csv&resample=true", content=content).json()[
        "notes"
    ]
    assert notes[0].startswith("a resampled to 1 s")


def test_a_cell_that_means_no_value_is_said_in_the_query(client, refused):
    """What a mapping settles for the commands is a key here; the refusal names it."""
    content = table(
        ["Time (s)", "U (V)"], [[f"{k}", "OL" if k == 7 else f"{20 + k / 4}"] for k in range(60)]
    )
    status, detail = refused("POST", "/api/v1/records?filename=a.csv", content=content)
    assert status == 422 and detail.endswith("say ?missing=OL if it means no value")
    stored = client.post("/api/v1/records?filename=a.csv&missing=OL", content=content)
    assert stored.status_code == 201 and stored.json()["n"] == 60


@pytest.mark.parametrize("path", ["/api/v1/records?filename=log.csv", "/api/v1/score/bearing?"])
@pytest.mark.parametrize("kind", LEFT_OPEN)
def test_the_way_on_of_a_refusal_is_a_key_with_which_the_file_is_read(client, refused, kind, path):
    """Tried as it is told, but for the words that stand for what only the sender knows."""
    lines, _, way_on = LEFT_OPEN[kind]
    body = {"content": "\n".join(lines) + "\n", "headers": {"content-type": "text/csv"}}
    status, detail = refused("POST", path, **body)
    assert status == 422 and way_on in detail and "--" not in detail
    assert "`" not in detail.replace("`first`", "").replace("`mean`", "")
    key = way_on.replace("UNIT", "V").replace("COLUMN", "t").replace("SIGN", ",").replace("?", "&")
    assert way_on not in client.post(path + key, **body).text


def test_a_key_of_another_kind_of_body_is_refused(client, refused):
    content = table(["n [V]", "m [V]"], [["1", f"{k}"] for k in range(9)])
    headers = {"content-type": "text/csv"}
    status, detail = refused("POST", "/api/v1/score/bearing", content=content, headers=headers)
    assert status == 422 and "?sample_time=SECONDS" in detail
    read = client.post("/api/v1/score/bearing?sample_time=0.1", content=content, headers=headers)
    assert "sample_time" not in read.text
    status, detail = refused(
        "POST", "/api/v1/score/bearing?sampling_rate=10", content=content, headers=headers
    )
    assert status == 400 and "sampling_rate: is an option for .npy arrays" in detail
    status, detail = refused("POST", "/api/v1/score/bearing?sample_time=0.1", json=BODY)
    assert status == 400 and '"sample_time": seconds' in detail


def npy(array):
    file = io.BytesIO()
    np.save(file, array)
    return file.getvalue()


def test_an_array_or_json_that_is_refused_is_told_how_to_be_sent(client, refused):
    scored, binary = (
        "/api/v1/score/bearing?sample_time=0.01",
        {"content-type": "application/octet-stream"},
    )
    raw = np.zeros(100, dtype="f4")
    for content, way_on, mended in (
        (raw.tobytes(), "numpy.save writes one", npy(raw)),
        (npy(raw > 0), "send array.astype('f8')", npy((raw > 0).astype("f8"))),
        (npy(raw + 0j), "send its real part, array.real", npy((raw + 0j).real)),
    ):
        status, detail = refused("POST", scored, content=content, headers=binary)
        assert status == 400 and detail.endswith(way_on)
        assert client.post(scored, content=mended, headers=binary).status_code == httpx.codes.OK
    text, headers = json.dumps(BODY), {"content-type": "application/json"}
    for other in ("utf-16", "utf-16-le", "utf-32", "cp500"):
        status, detail = refused(
            "POST", "/api/v1/score/bearing", content=text.encode(other), headers=headers
        )
        assert status == 400 and detail.endswith("JSON is UTF-8, send it so")
    assert (
        client.post(
            "/api/v1/score/bearing", content=text.encode("utf-8-sig"), headers=headers
        ).status_code
        == httpx.codes.OK
    )
    for wrong, way_on in (
        ({"channels": {"a": ["1.0"]}}, "numbers stand without quotes"),
        ({"sampling_rate": 100}, "say sample_time, 1 / sampling_rate"),
    ):
        status, detail = refused("POST", "/api/v1/score/bearing", json=BODY | wrong)
        assert status == 400 and way_on in detail


def test_a_rate_that_was_meant_in_kilohertz_is_no_loose_sensor(client):
    query = {"sampling_rate": RATE / 1000, "channel": "acceleration [m/s**2]"}
    answer = client.post(
        "/api/v1/score/bearing",
        params=query,
        content=npy(SIGNAL),
        headers={"content-type": "application/octet-stream"},
    ).json()
    assert (
        answer["verdict"] == "not-assessable" and "meant in kHz, say 12000 Hz" in answer["reason"]
    )


def test_a_unit_is_said_where_the_body_says_it(client, refused):
    """The same refusal of four doors, each with a way on that is one there."""
    scored, column = "/api/v1/score/bearing", "housing"
    content = table(
        ["time [s]", "housing [V]"], [[f"{k / RATE:.9f}", f"{v:.6f}"] for k, v in enumerate(SIGNAL)]
    ).encode()
    binary, described = (
        {"content-type": "application/octet-stream"},
        f"{scored}?sampling_rate={RATE}",
    )
    stored = client.post("/api/v1/records?filename=a.csv", content=content).json()["id"]

    def said(path, way_on, **request):
        status, detail = refused("POST", path, **request)
        assert status == 422 and detail.endswith(f"say {way_on}"), detail

    said(scored, f'"units": {{"{column}": "g"}} in the body', json=BODY | {"units": {column: "V"}})
    assert client.post(scored, json=BODY | {"units": {column: "g"}}).status_code == httpx.codes.OK
    said(
        f"{described}&channel=housing [V]",
        "?channel=housing%20[g]",
        content=npy(SIGNAL),
        headers=binary,
    )
    assert (
        client.post(
            f"{described}&channel=housing%20[g]", content=npy(SIGNAL), headers=binary
        ).status_code
        == httpx.codes.OK
    )
    said(scored, "?unit=housing=g", content=content, headers={"content-type": "text/csv"})
    assert (
        client.post(
            f"{scored}?unit=housing=g", content=content, headers={"content-type": "text/csv"}
        ).status_code
        == 200
    )
    said(f"/api/v1/records/{stored}/score/bearing", "POST /records?unit=housing=g")
    again = client.post("/api/v1/records?filename=a.csv&unit=housing=g", content=content).json()[
        "id"
    ]
    assert client.post(f"/api/v1/records/{again}/score/bearing").status_code == httpx.codes.OK
