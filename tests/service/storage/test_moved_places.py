"""A data folder or database that is moved while the service runs: nothing is acknowledged that the next start does not find."""

import contextlib
import os
from types import SimpleNamespace

import httpx
import pytest

from residuum.service.storage import disk_store

BODY = {
    "sample_time": 1e-3,
    "channels": {"acceleration": [0.0, 1.0] * 500},
    "units": {"acceleration": "m/s²"},
}
WINDOWS = "/api/v1/assets/press/windows"


@pytest.mark.parametrize("moved", ["data", "data/residuum.db", "data/blocks"])
def test_what_is_moved_takes_nothing_and_is_told_at_once(run_service, tmp_path, moved):
    service = run_service(data=tmp_path / "data")
    with httpx.Client(base_url=service.url, timeout=60) as client:

        def post(key):
            return client.post(
                f"{WINDOWS}?diagnoser=bearing", json=BODY, headers={"Idempotency-Key": key}
            ).status_code

        assert post("first") == 201 and client.get("/health/ready").status_code == 200
        os.rename(tmp_path / moved, tmp_path / "elsewhere")
        assert [post(key) for key in ("second", "third", "first")] == 3 * [503]
        ready = client.get("/health/ready")
        assert ready.status_code == 503 and "was moved" in ready.json()["detail"]
        with contextlib.suppress(OSError):
            (tmp_path / moved).rmdir()
        assert not (tmp_path / moved).exists(), "nothing was written where it was"
        os.rename(tmp_path / "elsewhere", tmp_path / moved)
        assert [post(key) for key in ("second", "third", "first")] == 3 * [201]
        assert client.get("/health/ready").status_code == 200
    service.stop()
    service.start()
    with httpx.Client(base_url=service.url, timeout=60) as client:
        assert len(client.get(WINDOWS).json()["items"]) == 3


def test_readiness_is_looked_at_once_a_second_at_most(run_service, monkeypatch):
    service = run_service()
    now, looks = [0.0], []
    # of the store alone
    monkeypatch.setattr(disk_store, "time", SimpleNamespace(monotonic=lambda: now[0]))
    store = service.services.store
    store._checked_at = -10.0
    probe = store._blocks.probe
    monkeypatch.setattr(store._blocks, "probe", lambda: (looks.append(now[0]), probe()))
    for now[0] in (0.0, 0.1, 0.5, 0.9, 1.0, 1.5, 1.99, 2.0):
        store.check()
    assert looks == [0.0, 1.0, 2.0]
