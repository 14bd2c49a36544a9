"""The answer to a commit is lost: what may have been kept is kept, found again under its key, and stored once."""

import contextlib
import selectors
import socket
import threading

import httpx
import numpy as np
import pytest
from sqlalchemy.engine import make_url

from residuum.diagnosis.finding import Finding
from residuum.identification.record import Record
from residuum.service.cli import run
from residuum.service.storage import DiskStore
from residuum.service.storage.database import OutcomeUnknown

ROUNDS = 8


class LossyProxy:
    """Stands between a service and its database, and can lose the answer to a commit, with the connection."""

    def __init__(self, host, port):
        self._server = socket.create_server(("127.0.0.1", 0))
        self.port = self._server.getsockname()[1]
        self._target = (host, port)
        self.lose, self.lost = None, 0
        """What is said in the transaction whose commit is to be answered to nobody."""
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self):
        with contextlib.suppress(OSError):
            while True:
                client, _ = self._server.accept()
                threading.Thread(target=self._carry, args=(client,), daemon=True).start()

    def _carry(self, client):
        """What the client says is answered by the server, until the connection is lost."""
        with (
            client,
            socket.create_connection(self._target) as server,
            contextlib.suppress(OSError),
            selectors.DefaultSelector() as ready,
        ):
            ready.register(client, selectors.EVENT_READ, server)
            ready.register(server, selectors.EVENT_READ, client)
            said = b""
            while True:
                for key, _ in ready.select():
                    if not (data := key.fileobj.recv(65536)):
                        return
                    key.data.sendall(data)
                    said += data if key.fileobj is client else b""
                    if b"COMMIT" in said and self.lose and self.lose in said:
                        self.lose = None
                        self.lost += 1
                        # the answer: the transaction stands, and nobody hears of it
                        server.recv(65536)
                        return
                    if b"COMMIT" in said or b"ROLLBACK" in said:
                        said = b""

    def close(self):
        self._server.close()


@pytest.fixture
def proxy(new_postgresql_database):
    url = make_url(new_postgresql_database())
    proxy = LossyProxy(url.host, url.port)
    proxy.url = url.set(host="127.0.0.1", port=proxy.port).render_as_string(hide_password=False)
    yield proxy
    proxy.close()


def test_no_window_is_lost_or_stored_twice_over_http(proxy, run_service, tmp_path, capsys):
    service = run_service(data=tmp_path, database=proxy.url)
    ids = []
    with httpx.Client(base_url=service.url, timeout=60) as client:
        for number in range(ROUNDS):
            samples = {"acceleration": [float(number), 1.0] * 500}
            body = {"sample_time": 1e-3, "channels": samples, "units": {"acceleration": "m/s²"}}
            send = {"json": body, "headers": {"Idempotency-Key": f"key-{number}"}}
            proxy.lose = f"key-{number}".encode()
            answer = client.post("/api/v1/assets/press/windows?diagnoser=bearing", **send)
            assert answer.status_code == 503, answer.text
            answer = client.post("/api/v1/assets/press/windows?diagnoser=bearing", **send)
            assert answer.status_code in (200, 201), answer.text
            ids.append(answer.json()["window"]["id"])
    assert proxy.lost == ROUNDS
    store = service.services.store
    assert sorted(window.id for window in store.windows("press", limit=100).items) == sorted(ids)
    for number, window in enumerate(ids):
        assert store.window_record("press", window)["acceleration"][0] == number
    assert (
        run(["backup", str(tmp_path / "backup"), "--data", str(tmp_path), "--database", proxy.url])
        == 0
    )
    capsys.readouterr()


def test_a_record_whose_commit_may_stand_keeps_its_block(proxy, tmp_path):
    store = DiskStore(tmp_path, proxy.url)
    proxy.lose = b"a.csv"
    with pytest.raises(OutcomeUnknown):
        store.add_record("a.csv", Record({"u": np.arange(3.0)}, {"u": "V"}, 0.1))
    (kept,) = store.records().items
    assert store.record_samples(kept.id)["u"].tolist() == [0.0, 1.0, 2.0]
    store.close()


def test_what_certainly_failed_leaves_no_block(tmp_path):
    store = DiskStore(tmp_path, f"sqlite:///{tmp_path / 'residuum.db'}")
    with pytest.raises(ValueError, match="rule"):
        store._rule_of = lambda asset: (_ for _ in ()).throw(ValueError("rule"))
        store.add_window(
            "press",
            Record({"u": np.arange(3.0)}, {"u": "V"}, 0.1),
            Finding("bearing", "faulty", reason="-"),
        )
    assert list(tmp_path.glob("blocks/*/*.block")) == []
    store.close()
