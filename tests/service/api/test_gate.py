"""Who may in: sizes, hosts, origins, keys and roles, and what every answer carries."""

import contextlib
import http.client
import json
import os
import re
import socket

import httpx
import pytest

from residuum.service.app import create_app
from residuum.service.machines.pipeline import Pipeline
from residuum.service.security.access import new_key
from residuum.service.settings import SETTINGS_FILE, BadSettings, load_settings


def test_a_body_over_the_limit_is_refused_before_it_is_read(run_service):
    service = run_service(body_limit=1_000_000)
    with socket.create_connection(("127.0.0.1", service.port)) as connection:
        head = "POST /api/v1/score/bearing HTTP/1.1\r\nHost: localhost\r\nContent-Length: 104857600\r\n\r\n"
        connection.sendall(head.encode())  # and not one byte of the body
        connection.settimeout(60)
        answer = b"".join(iter(lambda: connection.recv(65536), b""))
    assert (
        answer.startswith(b"HTTP/1.1 413")
        and b"application/problem+json" in answer
        and b"at most 1000000" in answer
    )


def test_a_chunked_body_is_cut_off_at_the_limit(run_service):
    service = run_service(body_limit=100_000)
    with socket.create_connection(("127.0.0.1", service.port)) as connection:
        connection.settimeout(60)
        head = "POST /api/v1/records?filename=a.csv HTTP/1.1\r\nHost: localhost\r\nTransfer-Encoding: chunked\r\n\r\n"
        # the answer may come, and the connection end, before all is sent
        with contextlib.suppress(ConnectionError):
            connection.sendall(
                head.encode() + b"".join(b"10000\r\n" + b"x" * 65536 + b"\r\n" for _ in range(3))
            )
        assert connection.recv(65536).startswith(b"HTTP/1.1 413")


def test_a_body_somewhat_over_the_limit_gets_its_answer(run_service):
    """A client that sends all before it looks for an answer must find one, not a connection that was reset."""
    service = run_service(body_limit=4_000_000)
    for chunked in (False, True):
        connection = http.client.HTTPConnection("127.0.0.1", service.port, timeout=60)
        body = iter([bytes(1_000_000)] * 6) if chunked else bytes(6_000_000)
        head = {"Content-Type": "text/csv"} | ({"Transfer-Encoding": "chunked"} if chunked else {})
        connection.request(
            "POST", "/api/v1/records?filename=a.csv", body, encode_chunked=chunked, headers=head
        )
        answer = connection.getresponse()
        assert answer.status == 413 and answer.headers["Connection"] == "close"
        assert "4000000" in json.loads(answer.read())["detail"]


def test_a_client_that_asks_first_is_not_told_to_send(run_service):
    service = run_service(body_limit=1_000_000)
    with socket.create_connection(("127.0.0.1", service.port)) as connection:
        head = "POST /api/v1/records?filename=a.csv HTTP/1.1\r\nHost: localhost\r\nContent-Length: 2000000\r\n"
        connection.sendall(head.encode() + b"Expect: 100-continue\r\n\r\n")
        connection.settimeout(60)
        assert connection.recv(65536).startswith(b"HTTP/1.1 413")


def test_a_large_head_is_refused(client):
    answer = client.get("/api/v1/assets", headers={"X-Long": "y" * 20_000})
    assert (
        answer.status_code == 431 and answer.headers["content-type"] == "application/problem+json"
    )


def test_foreign_names_and_foreign_pages_are_turned_away(client):
    assert client.get("/api/v1/assets", headers={"Host": "evil.example"}).status_code == 421
    assert client.get("/api/v1/assets", headers={"Host": "localhost:8000"}).status_code == 200
    assert client.get("/api/v1/assets", headers={"Host": "[::1]:8000"}).status_code == 200
    assert (
        client.put(
            "/api/v1/assets/a", json={}, headers={"Origin": "https://evil.example"}
        ).status_code
        == 403
    )
    assert client.put("/api/v1/assets/a", json={}, headers={"Origin": "null"}).status_code == 403
    assert (
        client.put(
            "/api/v1/assets/a", json={}, headers={"Origin": str(client.base_url).rstrip("/")}
        ).status_code
        == 200
    )


def test_every_answer_forbids_what_a_page_does_not_need(client):
    for path in ("/", "/web/js/main.js", "/api/v1/assets", "/api/v1/nothing", "/metrics"):
        headers = client.get(path).headers
        policy = headers["content-security-policy"]
        assert (
            "default-src 'none'" in policy
            and "unsafe" not in policy
            and "frame-ancestors 'none'" in policy
        )
        assert headers["x-content-type-options"] == "nosniff"


def test_a_request_has_an_id_that_answer_and_refusal_tell(client):
    own = client.get("/api/v1/assets/nobody", headers={"X-Request-ID": "plc-7/line:42"})
    assert (
        own.headers.get_list("x-request-id") == ["plc-7/line:42"]
        and own.json()["request_id"] == "plc-7/line:42"
    )
    refused = client.get(
        "/api/v1/assets", headers={"X-Request-ID": "turned-away", "Host": "evil.example"}
    )
    assert refused.headers["x-request-id"] == refused.json()["request_id"] == "turned-away"
    named = [client.get("/api/v1/assets").headers["x-request-id"] for _ in range(2)]
    assert all(re.fullmatch("[0-9a-f]{16}", number) for number in named) and named[0] != named[1]
    for odd in ("a b", "x" * 129, 'x"', "ä", ""):
        answer = client.get("/api/v1/nothing", headers={"X-Request-ID": odd.encode()})
        assert re.fullmatch("[0-9a-f]{16}", answer.json()["request_id"]), (
            "what could harm a log is not taken"
        )


ROLES = {
    "viewer": (200, 403, 403),
    "operator": (200, 404, 403),
    "engineer": (200, 404, 200),
    "admin": (200, 404, 200),
}


def test_keys_and_roles(tmp_path, run_service):
    keys = {role: new_key() for role in ROLES}
    lines = [
        "# name role sha256",
        *(f"{role}-1 {role} {digest}" for role, (_, digest) in keys.items()),
    ]
    (tmp_path / "keys").write_text("\n".join(lines))
    service = run_service(host="0.0.0.0", api_keys=tmp_path / "keys")
    with httpx.Client(
        base_url=service.url, headers={"Host": "plant.example"}, timeout=60
    ) as client:
        assert client.get("/health/live").status_code == 200
        assert client.get("/").status_code == 200
        for key in (None, "wrong", keys["admin"][1]):
            answer = client.get("/api/v1/assets", headers={"X-API-Key": key} if key else {})
            assert answer.status_code == 401 and answer.headers["www-authenticate"] == "Bearer"
        for role, expected in ROLES.items():
            bearer = {"Authorization": f"Bearer {keys[role][0]}"}
            found = (
                client.get("/api/v1/assets", headers=bearer).status_code,
                client.post("/api/v1/alarms/1/acknowledge", headers=bearer).status_code,
                client.put("/api/v1/assets/a", json={}, headers=bearer).status_code,
            )
            assert found == expected, role


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "192.168.1.7", "plant.example"])
def test_an_open_address_without_keys_is_refused(host):
    with pytest.raises(BadSettings, match="api_keys"):
        load_settings(host=host)


def test_settings_are_refused_in_one_line(tmp_path, monkeypatch):
    with pytest.raises(BadSettings, match="setting port: 70000"):
        load_settings(port=70000)
    with pytest.raises(BadSettings, match="colour"):
        load_settings(colour="red")
    (tmp_path / "keys").write_text("eva admin tooshort")
    with pytest.raises(BadSettings, match="line 1"):
        create_app(load_settings(data=tmp_path, api_keys=tmp_path / "keys"), Pipeline)
    (tmp_path / "keys").write_text(f"{'e' * 65} admin {'0' * 64}")
    with pytest.raises(BadSettings, match="line 1: a name has at most 64"):
        create_app(load_settings(data=tmp_path, api_keys=tmp_path / "keys"), Pipeline)
    (tmp_path / "settings.yaml").write_text("port: 9001\nlog_level: error\n")
    monkeypatch.setenv("RESIDUUM_SETTINGS", str(tmp_path / "settings.yaml"))
    monkeypatch.setenv("RESIDUUM_LOG_LEVEL", "debug")
    settings = load_settings(workers=2, host=None)
    assert (settings.port, settings.log_level, settings.workers, settings.host) == (
        9001,
        "debug",
        2,
        "127.0.0.1",
    )
    monkeypatch.setenv("RESIDUUM_SETTINGS", str(tmp_path / "absent.yaml"))
    with pytest.raises(BadSettings, match="no such file"):
        load_settings()


def test_a_client_that_asks_too_often_is_told_when_to_come_again(tmp_path, run_service):
    (key, digest), (other, other_digest) = new_key(), new_key()
    (tmp_path / "keys").write_text(f"eva engineer {digest}\nudo viewer {other_digest}\n")
    service = run_service(host="0.0.0.0", api_keys=tmp_path / "keys", rate_limit=0.01)
    with httpx.Client(base_url=service.url, headers={"X-API-Key": key}, timeout=60) as client:
        answers = [client.get("/api/v1/assets") for _ in range(3)]
        assert [answer.status_code for answer in answers] == [200, 429, 429]
        assert (
            answers[1].headers["content-type"] == "application/problem+json"
            and 1 <= int(answers[1].headers["retry-after"]) <= 100
        )
        assert client.get("/api/v1/assets", headers={"X-API-Key": other}).status_code == 200
        assert client.get("/api/v1/assets", headers={"X-API-Key": "guess"}).status_code == 401
        assert (
            client.get("/api/v1/assets", headers={"X-API-Key": "another guess"}).status_code == 429
        )
        assert {client.get("/health/live").status_code for _ in range(5)} == {200}


def test_the_demo_on_this_machine_has_no_rate_limit_unless_asked_for(tmp_path):
    assert load_settings().requests_per_second is None
    assert load_settings(rate_limit=5).requests_per_second == 5
    assert load_settings(host="0.0.0.0", api_keys=tmp_path).requests_per_second == 200


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("host: [1\n", "not YAML: line 2, column 1"),
        ("- host\n", "is no settings file"),
        ("hoost: a\n", "setting hoost: is not known; did you mean 'host'?"),
        ("#" * 1_000_001, "1000001 bytes; a YAML file has at most 1000000"),
    ],
)
def test_a_settings_file_that_cannot_be_read_is_refused_in_one_line(tmp_path, text, says):
    file = tmp_path / "settings.yaml"
    file.write_text(text)
    with pytest.raises(BadSettings, match=says) as refused:
        load_settings(file)
    assert "\n" not in str(refused.value)


def test_a_settings_file_that_is_given_holds_for_these_settings_alone(tmp_path, monkeypatch):
    monkeypatch.delenv(SETTINGS_FILE, raising=False)
    file = tmp_path / "settings.yaml"
    file.write_text("port: 9000\n")
    assert load_settings(file).port == 9000
    assert load_settings().port == 8000 and SETTINGS_FILE not in os.environ
