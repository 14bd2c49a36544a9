"""Refusals are in the log and the audit trail; keys end, take turns and are withdrawn while the service runs; guesses are slow.

Guessers beside an operator, in a process of its own: `python -m benchmarks.wrong_keys`.
"""

import time
from datetime import UTC, datetime, timedelta
from unittest.mock import Mock

import httpx
import pytest

from residuum.identification.record import Record
from residuum.service import app
from residuum.service.security import access, refusals
from residuum.service.security.access import ApiKeys, new_key
from residuum.service.security.refusals import OTHERS, Refusals
from residuum.service.settings import BadSettings

PATIENCE = 120.0


def wait_for(condition, what):
    end = time.monotonic() + PATIENCE
    while not (found := condition()):
        assert time.monotonic() < end, what
        time.sleep(0.05)
    return found


@pytest.fixture
def keys(tmp_path, monkeypatch):
    """Writes the file of keys anew; gives its place. The service looks at it at once."""
    monkeypatch.setattr(access, "LOOK_EVERY", 0.0)
    file = tmp_path / "keys"

    def write(*lines):
        part = tmp_path / "part"
        part.write_text("\n".join(lines))
        part.replace(file)
        return file

    return write


def test_what_is_refused_and_deleted_is_in_log_and_trail(keys, run_service, monkeypatch):
    monkeypatch.setattr(app, "_AUDIT_EVERY", 0.05)
    (viewer, of_viewer), (engineer, of_engineer) = new_key(), new_key()
    file = keys(f"vera viewer {of_viewer}", f"eva engineer {of_engineer}")
    service = run_service(host="0.0.0.0", api_keys=file)
    logged = []
    monkeypatch.setattr(
        refusals, "log", Mock(warning=lambda event, **told: logged.append(told | {"event": event}))
    )
    with httpx.Client(base_url=service.url, timeout=60) as client:
        for _ in range(3):
            assert client.get("/api/v1/assets").status_code == 401
        assert client.get("/api/v1/no%00where", headers={"X-API-Key": "guess"}).status_code == 401
        assert (
            client.put("/api/v1/assets/press", json={}, headers={"X-API-Key": viewer}).status_code
            == 403
        )
        number = service.services.store.add_record("a.csv", Record({"u": [0.0]}, {"u": "V"}, 1.0))
        assert (
            client.delete(f"/api/v1/records/{number}", headers={"X-API-Key": engineer}).status_code
            == 204
        )

        def trail():
            return client.get("/api/v1/audit?limit=100", headers={"X-API-Key": engineer}).json()[
                "items"
            ]

        def turned_away():
            found = [each for each in trail() if each["action"] == "refused"]
            return found if sum(each["detail"]["times"] for each in found) == 5 else None

        told = {
            (each["by"], each["subject"], each["detail"]["status"])
            for each in wait_for(turned_away, trail)
        }
        assert told == {
            (None, "GET /api/v1/assets", 401),
            (None, "GET /api/v1/no?where", 401),
            ("vera", "PUT /api/v1/assets/press", 403),
        }
        assert {each["detail"]["address"] for each in turned_away()} == {"127.0.0.1"}
        (gone,) = [each for each in trail() if each["action"] == "record removed"]
        assert (gone["by"], gone["subject"], gone["detail"]["name"]) == (
            "eva",
            f"record {number}",
            "a.csv",
        )
    lines = [each for each in logged if each["event"] == "refused"]
    assert len(lines) == 5 and {(each["address"], each["key"]) for each in lines} == {
        ("127.0.0.1", None),
        ("127.0.0.1", "vera"),
    }


def test_keys_are_withdrawn_and_take_turns_while_the_service_runs(keys, run_service):
    (old, of_old), (new, of_new) = new_key(), new_key()
    service = run_service(host="0.0.0.0", api_keys=keys(f"eva engineer {of_old}"))
    with httpx.Client(base_url=service.url, timeout=60) as client:

        def status(key):
            return client.get("/api/v1/assets", headers={"X-API-Key": key}).status_code

        assert (status(old), status(new)) == (200, 401)
        keys(f"eva engineer {of_old}", f"eva engineer {of_new}")
        assert (status(new), status(old)) == (200, 200), "both, while one takes over"
        keys("what is this")
        assert status(new) == 200, "a broken file locks nobody out"
        keys(f"eva engineer {of_new}")
        assert (status(old), status(new)) == (401, 200)
        keys(f"eva engineer {of_new} until=2020-01-01")
        answer = client.get("/api/v1/assets", headers={"X-API-Key": new})
        assert answer.status_code == 401 and "of 'eva' has ended" in answer.json()["detail"]


def test_a_key_ends_at_its_moment(keys):
    key, digest = new_key()
    soon, past = (datetime.now(UTC) + timedelta(hours=sign) for sign in (1, -1))
    for until, there in (
        (soon.isoformat(), True),
        (past.isoformat(), False),
        (past.replace(tzinfo=None).isoformat(), False),
    ):
        known = ApiKeys(keys(f"eva viewer {digest} hall-1 until={until}"))
        caller = known.caller(key)
        assert (caller is not None) == there and known.ended(key) == (None if there else "eva")
        assert caller is None or caller.sites == {"hall-1"}
    with pytest.raises(BadSettings, match="until=2027-01-31"):
        ApiKeys(keys(f"eva viewer {digest} until=tomorrow"))


def test_wrong_keys_again_and_again_are_refused_as_too_many_and_the_right_one_is_not(
    keys, run_service, monkeypatch
):
    monkeypatch.setattr("residuum.service.security.gate._SLOWEST", 0.02)
    key, digest = new_key()
    service = run_service(host="0.0.0.0", api_keys=keys(f"eva viewer {digest}"), rate_limit=100.0)
    with httpx.Client(base_url=service.url, timeout=60) as client:
        found = [
            client.get("/api/v1/assets", headers={"X-API-Key": f"guess {k}"}).status_code
            for k in range(14)
        ]
        assert found[:10] == [401] * 10
        late = client.get("/api/v1/assets", headers={"X-API-Key": "guess"})
        assert 429 in [*found, late.status_code], (
            "not even on a machine on which each takes two seconds"
        )
        assert client.get("/api/v1/assets", headers={"X-API-Key": key}).status_code == 200
        assert client.get("/api/v1/assets").status_code == 401, "who shows none guesses nothing"


def test_many_different_refusals_are_few_entries():
    noted = Refusals()
    for number in range(1000):
        noted.note(f"192.0.2.{number}", None, "GET", "/api/v1/assets", 401, "key")
    taken = dict(noted.take())
    assert (
        len(taken) == 21
        and sum(taken.values()) == 1000
        and taken[OTHERS] == 980
        and noted.take() == []
    )
