"""Whatever is wrong gets a 4xx problem document with one line that says what and where, and nothing is stored."""

import io
import json
import re
import socket
import time

import httpx
import numpy as np
import pytest

from residuum.service.cli import BAD_INPUT, run
from residuum.service.commands import as_option
from tests.service.api.doors import options

SCORE = "/api/v1/score/bearing"
WINDOWS = "/api/v1/assets/press/windows?diagnoser=bearing"
GOOD = {
    "sample_time": 1e-3,
    "channels": {"acceleration": [0.0, 1.0]},
    "units": {"acceleration": "m/s²"},
}


def text(**changes):
    return json.dumps({name: value for name, value in (GOOD | changes).items() if value is not ...})


BAD_JSON = {
    "empty": ("", 400, "not JSON"),
    "not JSON": ("{", 400, "not JSON"),
    "not UTF-8": (b"\xff\xfe{}", 400, "not JSON"),
    "array": ("[]", 400, "must be an object"),
    "NaN": ('{"sample_time": NaN}', 400, "not JSON"),
    "infinite": (
        '{"sample_time": 1, "channels": {"a": [1e999]}, "units": {"a": "V"}}',
        400,
        "infinity",
    ),
    "lone surrogate": (
        '{"sample_time": 1, "channels": {"\\ud800": [1]}, "units": {}}',
        400,
        "surrogate",
    ),
    "deep": ("[" * 100_000 + "]" * 100_000, 400, "depth"),
    "huge number": (text().replace("0.001", "9" * 5000), 400, "infinity"),
    "no channels": (text(channels=...), 400, "channels"),
    "text for a number": (
        text(channels={"acceleration": [0.0, "1.0"]}),
        400,
        "sample 1: '1.0' is not a number",
    ),
    "boolean": (text(channels={"acceleration": [True]}), 400, "not a number"),
    "nested": (text(channels={"acceleration": [[1.0]]}), 400, "not a number"),
    "unequal": (
        text(
            channels={"acceleration": [1.0], "b": [1.0, 2.0]}, units={"acceleration": "g", "b": "V"}
        ),
        422,
        "differ in length",
    ),
    "no samples": (text(channels={"acceleration": []}), 422, "not empty"),
    "no unit": (text(units={}), 422, "has no unit"),
    "NUL in a name": (text(channels={"a\0": [1.0]}, units={"a\0": "V"}), 422, "NUL"),
    "NUL in a unit": (text(units={"acceleration": "m/s²\0"}), 422, "NUL"),
    "NUL in a note": (text(notes=["\0"]), 422, "NUL"),
    "a unit beyond all numbers": (
        text(units={"acceleration": "km**99999999"}),
        422,
        "not a known unit",
    ),
    "wrong unit": (text(units={"acceleration": "m//s("}), 422, "not a known unit"),
    "a unit of its own": (text(units={"acceleration": "blorbs"}), 422, "unit of acceleration"),
    "incompatible unit": (text(units={"acceleration": "V"}), 422, "unit of acceleration"),
    "unknown channel": (
        text(channels={"sound": [1.0, 2.0]}, units={"sound": "Pa"}),
        422,
        "acceleration",
    ),
    "negative step": (text(sample_time=-1), 422, "sample_time"),
    "text step": (text(sample_time="1"), 400, "sample_time"),
    "unknown key": (text(chanels={}), 400, "'chanels'"),
}


@pytest.mark.parametrize(("body", "status", "says"), BAD_JSON.values(), ids=BAD_JSON)
@pytest.mark.parametrize("path", [SCORE, WINDOWS], ids=["score", "store"])
def test_bad_json_bodies(refused, client, path, body, status, says):
    found, detail = refused(
        "POST", path, content=body, headers={"content-type": "application/json"}
    )
    assert found == status and says in detail
    assert client.get("/api/v1/assets").json()["items"] == []


def npy(array):
    file = io.BytesIO()
    np.save(file, array, allow_pickle=True)
    return file.getvalue()


def header(text):
    encoded = text.encode("latin-1")
    return b"\x93NUMPY\x01\x00" + len(encoded).to_bytes(2, "little") + encoded


def shaped(shape, dtype="<f8", data=b"\0" * 64):
    return header(f"{{'descr': '{dtype}', 'fortran_order': False, 'shape': {shape}, }}\n") + data


BAD_NPY = {
    "empty": (b"", 400, "is not an .npy array"),
    "no magic": (b"PK\x03\x04" + bytes(40), 400, "is not an .npy array"),
    "giant shape": (shaped("(99999999999999,)"), 400, "needs 799999999999992 bytes; 64 came"),
    "negative shape": (shaped("(-8, -1)"), 400, "negative"),
    "nested without end": (shaped("(" + "-" * 800 + "8,)"), 400, "only plain"),
    "unlike keys": (header("{1: 2, 'shape': (8,)}\n") + bytes(64), 400, "only plain"),
    "rows of a type": (shaped("(1,)", dtype="<f8', (99999999,), '<f8"), 400, "only plain"),
    "giant product": (shaped("(4294967296, 4294967296)"), 400, "bytes; 64 came"),
    "too short": (npy(np.zeros(9))[:-1], 400, "needs 72 bytes; 71 came"),
    "cut header": (npy(np.zeros(9))[:40], 400, "ends inside"),
    "giant header": (
        b"\x93NUMPY\x02\x00" + (2**31).to_bytes(4, "little") + bytes(64),
        413,
        "at most 1024",
    ),
    "objects": (npy(np.array([{}, 1], dtype=object)), 400, "only plain"),
    "text": (npy(np.array(["a", "b"])), 400, "only plain"),
    "complex": (npy(np.zeros(4, complex)), 400, "only plain"),
    "structured": (npy(np.zeros(4, [("a", "<f8")])), 400, "only plain"),
    "code": (
        header("{'descr': '<f8', 'fortran_order': __import__('os'), 'shape': (8,), }\n")
        + bytes(64),
        400,
        "only plain",
    ),
    "scalar": (npy(np.float64(3.0)), 400, "one or two dimensions"),
    "cube": (npy(np.zeros((2, 2, 2))), 400, "one or two dimensions"),
    "no samples": (npy(np.zeros(0)), 400, "hold samples"),
    "rows": (npy(np.zeros((3, 4))), 400, "3 rows"),
    "infinite": (npy(np.array([1.0, np.inf])), 422, "sample 1: is infinite"),
}


@pytest.mark.parametrize(("body", "status", "says"), BAD_NPY.values(), ids=BAD_NPY)
def test_bad_npy_bodies(refused, body, status, says):
    query = {"sample_time": 1e-4, "channel": "acceleration [m/s²]"}
    found, detail = refused(
        "POST",
        SCORE,
        params=query,
        content=body,
        headers={"content-type": "application/octet-stream"},
    )
    assert found == status and says in detail


@pytest.mark.parametrize(
    ("query", "says"),
    [
        ({}, "sample_time is missing"),
        ({"sample_time": "soon"}, "'soon' is not a number"),
        ({"sample_time": "nan"}, "sample_time"),
        ({"sampling_rate": "0"}, "must be positive"),
        ({"sample_time": 1, "channel": "acceleration"}, r"must be 'name \[unit\]'"),
        ({"sample_time": 1, "channel": ["a [V]", "a [V]"]}, "2 rows|named twice|these channels"),
        ({"sample_time": 1, "t0": "inf", "channel": "acceleration [g]"}, "t0"),
    ],
)
def test_bad_queries_of_an_npy_body(refused, query, says):

    body = npy(np.zeros(4))
    _, detail = refused(
        "POST",
        SCORE,
        params=query,
        content=body,
        headers={"content-type": "application/octet-stream"},
    )
    assert re.search(says, detail), detail


@pytest.mark.parametrize(
    ("diagnoser", "query", "says"),
    [
        ("robust-residual", {"speed_rpm": "1500"}, "only the bearing diagnoser has it"),
        ("gripping-pliers", {"orders": "bpfi=5.4"}, "not a setting of gripping-pliers"),
        ("bearing", {"speed_rpm": "-1"}, '"speed_rpm" -1: must be > 0'),
        ("bearing", {"hertz": "bpfi=much"}, "must be a number"),
    ],
)
def test_settings_that_a_diagnoser_does_not_have(refused, diagnoser, query, says):
    _, detail = refused("POST", f"/api/v1/score/{diagnoser}", params=query, content=text())
    assert says in detail


@pytest.mark.parametrize(
    ("body", "says"),
    [
        (b"", "is empty"),
        (b"time [s],a [V]\n0,1\n1,soon\n", "row 3, column 2: 'soon' is not a number"),
        (b"time [s],a [V]\n0,1\n1,inf\n", "infinite"),
        (b"time [s],a [V]\n0,1\n1,2\n5,2\n6,2\n", "time step"),
        (b",".join(b"c%d" % number for number in range(100_000)), "header of"),
        (b"time [s],a [parsec/fortnight/\xff]\n0,1\n", "at least 2 are needed"),
    ],
)
def test_bad_csv_bodies(refused, client, body, says):
    for path, kind in (
        (SCORE, "text/csv"),
        ("/api/v1/records?filename=a.csv", "application/octet-stream"),
    ):
        status, detail = refused("POST", path, content=body, headers={"content-type": kind})
        assert status in (400, 422) and says in detail and "/tmp" not in detail
    assert client.get("/api/v1/records").json()["items"] == []


REQUESTS = [
    ("GET", "/api/v1/nothing", 404, "Not Found"),
    ("DELETE", "/api/v1/assets", 405, "Method Not Allowed"),
    ("GET", "/api/v1/assets/none", 404, "none of this name"),
    ("GET", "/api/v1/assets/..%2f..%2fetc", 404, "Not Found"),
    ("GET", "/api/v1/assets/%3Cscript%3E", 422, "pattern"),
    ("GET", "/api/v1/assets?limit=0", 422, "limit"),
    ("GET", "/api/v1/assets/none/findings?cursor=!!", 404, "none of this name"),
    ("GET", "/api/v1/alarms?cursor=!!", 422, "cursor"),
    ("GET", "/api/v1/alarms?cursor=OTk5OTk5OTk5OTk5OTk5OTk5OTk5OTk", 422, "cursor"),
    ("GET", "/api/v1/assets/a/windows/99999999999999999999", 422, "window"),
    ("POST", "/api/v1/alarms/1/acknowledge", 404, "none of this number"),
    ("POST", "/api/v1/score/nothing", 404, "known are"),
    ("GET", "/api/v1/models/none/versions", 404, "none of this name"),
    ("GET", "/api/v1/jobs/abc", 404, "none of this name"),
    ("GET", "/api/v1/demo/machines/gate/fault", 404, "known are none"),
    ("GET", "/web/js/../../../settings.py", 404, "Not Found"),
    ("GET", "/web/%2e%2e/%2e%2e/settings.py", 404, "Not Found"),
]


@pytest.mark.parametrize(
    ("method", "path", "status", "says"),
    REQUESTS,
    ids=[f"{method} {path[:50]}" for method, path, *_ in REQUESTS],
)
def test_requests_for_what_is_not_there(refused, method, path, status, says):
    found, detail = refused(method, path)
    assert (found, says in detail) == (status, True), detail


@pytest.mark.parametrize(
    ("kind", "content", "says"),
    [
        ("physical", b"name: [", "line"),
        ("physical", b"\xff\xfe\x00", "model file"),
        ("physical", b"name: a\nbalances: " + b"[" * 100_000, "model file"),
        ("identified", b"{}", "model file"),
        ("baseline", b"PK\x03\x04", "model file"),
    ],
)
def test_files_that_are_no_models(refused, kind, content, says):
    query = {"name": "m", "kind": kind, "diagnoser": "bearing"}
    status, detail = refused("POST", "/api/v1/models", params=query, content=content)
    assert status in (400, 422) and says in detail and "/tmp" not in detail


def test_bodies_of_other_types_and_strict_json_everywhere(refused):
    assert (
        refused("POST", SCORE, content=b"<x/>", headers={"content-type": "application/xml"})[0]
        == 415
    )
    assert refused("POST", "/api/v1/records?filename=evil.exe", content=b"MZ")[0] == 415
    for arrow in ("application/vnd.apache.arrow.stream", "application/vnd.apache.arrow.file"):
        for path in (SCORE, WINDOWS):
            status, detail = refused(
                "POST", path, content=b"ARROW1", headers={"content-type": arrow}
            )
            accepted = "application/json, application/octet-stream, text/csv, application/zip"
            assert (
                status == 415 and arrow in detail and detail.endswith(f"is not one of {accepted}")
            )
    for body in ('{"minutes": NaN}', '{"minutes": 1e999}', "{", "[" * 5000):
        status, _ = refused(
            "POST",
            "/api/v1/alarms/1/shelve",
            content=body,
            headers={"content-type": "application/json"},
        )
        assert status == 400
    status, detail = refused("POST", "/api/v1/alarms/1/shelve", json={"minutes": -1, "extra": 1})
    assert status == 422 and "minutes" in detail


@pytest.mark.parametrize(
    ("method", "path", "body"),
    [
        ("POST", "/api/v1/records?filename=a%00.csv", b""),
        ("POST", "/api/v1/models?name=a&note=%00", b""),
        ("PUT", "/api/v1/assets/a", b'{"title": "a\\u0000"}'),
        ("POST", "/api/v1/alarms/1/acknowledge", b'{"comment": "\\u0000"}'),
    ],
)
def test_texts_that_no_database_keeps(refused, method, path, body):
    status, says = refused(method, path, content=body, headers={"Content-Type": "application/json"})
    assert status == 422 and "match pattern" in says


@pytest.mark.parametrize(
    ("diagnoser", "asked"),
    [
        ("bearing", {"speed_rpm": -1}),
        ("bearing", {"orders": "bpfi"}),
        ("bearing", {"hertz": "bpfi=much"}),
        ("bearing", {"false_alarms_per_day": 2}),
        ("gripping-pliers", {"speed_rpm": 1500}),
        ("gate-actuator", {"method": "sorce"}),
    ],
)
def test_a_setting_is_refused_alike_by_command_and_service(
    refused, tmp_path, capsys, diagnoser, asked
):
    (tmp_path / "record.csv").write_text("time [s],acceleration [m/s²]\n0,0\n0.001,1\n")
    words = ["score", diagnoser, str(tmp_path / "record.csv"), *map(str, options(asked))]
    assert run(words) == BAD_INPUT
    by_command = capsys.readouterr().err.removeprefix("residuum: ").strip()
    _, detail = refused("POST", f"/api/v1/score/{diagnoser}", params=asked, content=text())
    assert by_command == re.sub(r'"([^"]+)"', lambda field: as_option(field[1]), detail)


def test_a_client_that_leaves_in_the_midst_of_its_body_is_no_fault_of_the_service(
    run_service, log_lines
):
    service = run_service()
    head = f"POST {WINDOWS} HTTP/1.1\r\nHost: localhost\r\nContent-Type: text/csv\r\n"
    with socket.create_connection(("127.0.0.1", service.port)) as leaving:
        leaving.sendall(f"{head}Content-Length: 1000\r\n\r\ntime [s],a [m/s²]\r\n".encode())
    end = time.monotonic() + 60
    counted = re.compile(r'residuum_http_requests_total{method="POST",.*status="(\d+)"} 1\.0')
    while not (told := counted.search(httpx.get(f"{service.url}/metrics", timeout=60).text)):
        assert time.monotonic() < end, "the request was not counted"
        time.sleep(0.02)
    assert told[1] == "400"
    assert not [line for line in log_lines if line["log_level"] == "error"]
