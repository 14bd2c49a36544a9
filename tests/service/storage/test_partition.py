"""A database that falls silent is given up and found again; what waited for it is stored once, in order. SQLite's lock likewise.

Long silences, of a service in a process of its own: `python -m benchmarks.partition`.
"""

import sqlite3
import threading
import time

import httpx
import pytest
from sqlalchemy import text
from sqlalchemy.engine import make_url
from sqlalchemy.exc import OperationalError

from benchmarks.partition import Source, from_the_bus, silence, stored
from benchmarks.silent_proxy import SilentProxy
from residuum.service.machines import pipeline
from residuum.service.storage import DiskStore, database, service_lock
from residuum.service.storage.database import Busy, Database
from residuum.service.storage.service_lock import ServiceRuns, database_lock
from residuum.service.store import StorageUnavailable

PATIENCE = 120.0


def wait_for(condition, what):
    end = time.monotonic() + PATIENCE
    while not (found := condition()):
        assert time.monotonic() < end, what
        time.sleep(0.02)
    return found


@pytest.fixture(params=[True, False], ids=["kept", "thrown away"])
def proxy(request, new_postgresql_database, monkeypatch):
    """A proxy before a database; what is asked through it is given up after a second of silence, not after eight."""
    monkeypatch.setattr(database, "SILENCE", 1.0)
    monkeypatch.setattr(
        "residuum.service.storage.patient_connection.PatientConnection.patience", 1.0
    )
    monkeypatch.setattr("residuum.service.storage.patient_connection.CONNECT_WITHIN", 2)
    monkeypatch.setattr(pipeline, "_STORAGE_RETRY", 0.2)
    url = make_url(new_postgresql_database())
    proxy = SilentProxy((url.host, url.port), keeps=request.param)
    proxy.url = url.set(host="127.0.0.1", port=proxy.port).render_as_string(hide_password=False)
    proxy.direct = url.render_as_string(hide_password=False)
    yield proxy
    proxy.close()


def test_windows_wait_for_a_silent_database_and_go_in_once_and_in_order(
    proxy, run_service, tmp_path
):
    service = run_service(data=tmp_path, database=proxy.url)
    source, stopped, counted = Source(service.port, "press"), threading.Event(), []
    store = service.services.store
    bus = threading.Thread(
        target=lambda: counted.append(from_the_bus(store, "bus", stopped)), daemon=True
    )
    source.start()
    bus.start()
    silence(proxy, [source], 1.5)
    source.stop()
    stopped.set()
    bus.join(PATIENCE)
    assert stored(store, "press") == [float(number) for number, _ in source.answered]
    assert stored(store, "bus") == [float(number) for number in range(counted[0])]


def test_a_statement_that_takes_longer_than_the_patience_is_not_given_up_where_it_may(proxy):
    base = Database(proxy.url)
    with pytest.raises(StorageUnavailable, match="silent for 1 s"), base.read() as connection:
        connection.execute(text("SELECT pg_sleep(30)"))
    with base.patiently(), base.read() as connection:
        connection.execute(text("SELECT pg_sleep(1.3)"))
    with base.read() as connection:
        assert connection.scalar(text("SELECT 1")) == 1
    base.close()


def holders(base):
    """Sessions of the server that hold a data folder."""
    with base.read() as connection:
        return connection.scalars(
            text("SELECT pid FROM pg_locks WHERE locktype = 'advisory'")
        ).all()


def test_the_lock_of_the_folder_is_taken_again_after_a_silence(proxy, monkeypatch):
    monkeypatch.setattr(service_lock, "LOOK_EVERY", 0.1)
    ours, theirs, told = Database(proxy.url), Database(proxy.direct), []
    before = proxy.connections
    with database_lock(ours, "folder", told.append):
        [first] = holders(theirs)
        proxy.fall_silent()
        wait_for(lambda: proxy.connections > before + 1, "the lock's connection was not given up")
        proxy.speak()
        wait_for(
            lambda: len(now := holders(theirs)) == 1 and first not in now,
            "the lock was not taken again",
        )
        with pytest.raises(ServiceRuns), database_lock(theirs, "folder"):
            pass
    wait_for(lambda: not holders(theirs), "the lock was not let go")
    assert not told
    ours.close()
    theirs.close()


def test_an_answer_that_is_lost_while_the_lock_is_taken_again_is_not_the_last(
    new_postgresql_database, monkeypatch
):
    monkeypatch.setattr(service_lock, "LOOK_EVERY", 0.1)
    url, lost, answers, told = new_postgresql_database(), [], [], []
    ours, theirs = Database(url), Database(url)
    free = service_lock._AdvisoryLock._free

    def lost_once(lock, connection):
        answer = free(lock, connection)
        # granted, but the answer does not arrive, and the server believes in the session
        if not lost:
            lost.append(lock._held.pop_all())
            raise OperationalError("SELECT", {}, Exception("the connection is lost"))
        answers.append(answer)
        return answer

    with database_lock(ours, "folder", told.append):
        monkeypatch.setattr(service_lock._AdvisoryLock, "_free", lost_once)
        with theirs.read() as connection:
            connection.execute(
                text("SELECT pg_terminate_backend(pid) FROM pg_locks WHERE locktype = 'advisory'")
            )
        wait_for(lambda: answers and answers[-1], "the lock was not taken again")
        assert len(holders(theirs)) == 1 and not told
    lost[0].close()
    ours.close()
    theirs.close()


def test_who_finds_the_folder_taken_is_told(new_postgresql_database, monkeypatch):
    monkeypatch.setattr(service_lock, "LOOK_EVERY", 0.1)
    url, told = new_postgresql_database(), []
    ours, theirs = Database(url), Database(url)
    with database_lock(ours, "folder", told.append):
        take = service_lock._AdvisoryLock.take
        # while another is faster
        monkeypatch.setattr(service_lock._AdvisoryLock, "take", lambda lock: False)
        with theirs.read() as connection:
            connection.execute(
                text("SELECT pg_terminate_backend(pid) FROM pg_locks WHERE locktype = 'advisory'")
            )
        wait_for(lambda: told, "nobody was told")
        monkeypatch.setattr(service_lock._AdvisoryLock, "take", take)
    assert "another service has taken" in told[0] and len(told) == 1
    ours.close()
    theirs.close()


@pytest.fixture
def locked(run_service, tmp_path, monkeypatch):
    """A service whose SQLite file another process's writer holds: (service, let go)."""
    monkeypatch.setattr(database, "_PATIENCE", 0.5)
    service = run_service(data=tmp_path)
    other = sqlite3.connect(tmp_path / "residuum.db", isolation_level=None, check_same_thread=False)
    other.execute("BEGIN IMMEDIATE")
    yield service, lambda: other.execute("ROLLBACK")
    other.close()


def test_reads_do_not_wait_behind_writes_that_cannot_be_done(locked):
    service, let_go = locked
    # as many as there are threads for requests
    source = [Source(service.port, f"press-{k}") for k in range(40)]
    for each in source:
        each.start()
    wait_for(lambda: sum(each.refused for each in source) >= 40, "nobody was refused")
    with httpx.Client(base_url=service.url, timeout=PATIENCE) as client:
        for path in ("/api/v1/assets", "/api/v1/alarms", "/metrics", "/", "/api/v1/health/live"):
            assert client.get(path).status_code == 200
        refused = client.put("/api/v1/assets/press-0", json={})
        assert (
            refused.status_code == 503
            and refused.headers["Retry-After"]
            and "try again" in refused.json()["detail"]
        )
        ready = client.get("/health/ready")
        assert ready.status_code == 503 and ready.headers["Retry-After"]
        assert all(each.answered == [] for each in source)
        let_go()
        wait_for(lambda: all(each.answered for each in source), "not all windows went in")
    for each in source:
        each.stop()
        assert stored(service.services.store, each._asset) == [
            float(number) for number, _ in each.answered
        ]


def test_more_writers_than_may_wait_are_refused_at_once(tmp_path, monkeypatch):
    monkeypatch.setattr(database, "_PATIENCE", PATIENCE)
    base = Database(f"sqlite:///{tmp_path / 'residuum.db'}")
    base.migrate()
    store = DiskStore(tmp_path, f"sqlite:///{tmp_path / 'residuum.db'}")
    store.close()
    inside, leave = threading.Event(), threading.Event()

    def write():
        with base.write():
            inside.set()
            leave.wait(PATIENCE)

    threads = [threading.Thread(target=write) for _ in range(database._MOST_WRITERS)]
    for thread in threads:
        thread.start()
    assert inside.wait(PATIENCE)
    wait_for(lambda: base._writers._value == 0, "not all wait")
    with pytest.raises(Busy, match="others wait to write"), base.write():
        pass
    leave.set()
    for thread in threads:
        thread.join(PATIENCE)
    with base.write():
        pass
    base.close()
