"""Long bodies are read apart, within bounds, and hold up nobody."""

import asyncio
import gc
import io
import json
import threading
import time
import zipfile

import httpx
import numpy as np
import pytest

from residuum.service import model_files
from residuum.service.api import responses, signal_body
from residuum.service.app import watch_loop
from residuum.service.work.loaded_modules import settle_memory

WINDOWS = "/api/v1/assets/press/windows?diagnoser=bearing"
MANY = 60_000
SIGNAL = np.round(np.random.default_rng(0).normal(size=MANY), 9)


def csv():
    rows = (f"{number / 1000:.3f},{value:.9f}\n" for number, value in enumerate(SIGNAL))
    return ("time [s],a [m/s²]\n" + "".join(rows)).encode()


def as_json():
    return json.dumps(
        {"sample_time": 1e-3, "channels": {"a": SIGNAL.tolist()}, "units": {"a": "m/s²"}}
    ).encode()


def npz(signal, **more):
    np.savez_compressed(
        file := io.BytesIO(), a=signal, sample_time=1e-3, units=np.array('{"a": "m/s²"}'), **more
    )
    return file.getvalue()


@pytest.fixture
def read_apart(monkeypatch):
    """Counts what is read in a process of its own."""
    seen, real = [], signal_body.read_body

    def counted(body, kind, **limits):
        seen.append(kind)
        return real(body, kind, **limits)

    monkeypatch.setattr(signal_body, "read_body", counted)
    return seen


@pytest.mark.parametrize(("kind", "body"), [("text/csv", csv), ("application/json", as_json)])
def test_a_long_text_is_read_in_a_process_of_its_own_and_is_the_same(
    client, read_apart, kind, body
):
    answer = client.post(WINDOWS, content=body(), headers={"Content-Type": kind})
    assert answer.status_code == 201 and read_apart == [kind]
    stored = client.get(
        f"/api/v1/assets/press/windows/{answer.json()['window']['id']}/record"
    ).content
    np.testing.assert_array_equal(np.load(io.BytesIO(stored))["a"], SIGNAL)


def test_an_npz_is_read_apart_when_it_is_large_unpacked(client, read_apart):
    for signal, apart in ((SIGNAL, []), (np.tile(SIGNAL[:500], 4000), ["application/zip"])):
        content = npz(signal)
        assert len(content) < signal_body._APART
        answer = client.post(WINDOWS, content=content, headers={"Content-Type": "application/zip"})
        assert (
            answer.status_code == 201
            and answer.json()["window"]["n"] == len(signal)
            and read_apart == apart
        )


def test_an_npz_unpacks_to_no_more_than_a_body_may_have(run_service):
    service = run_service(body_limit=2**20)
    bomb = npz(np.zeros(2**18))
    assert len(bomb) < 5000
    for path, unpacked in ((WINDOWS, bomb), ("/api/v1/score/bearing", bomb)):
        answer = httpx.post(
            service.url + path,
            content=unpacked,
            headers={"Content-Type": "application/zip"},
            timeout=60,
        )
        assert answer.status_code == 413
        assert (
            answer.json()["detail"]
            == "body: an NPZ of more than 256 arrays or 1048576 bytes unpacked; no more are read"
        )
    fits = npz(np.zeros(2**16))
    answer = httpx.post(
        service.url + WINDOWS, content=fits, headers={"Content-Type": "application/zip"}, timeout=60
    )
    assert answer.status_code == 201


def test_an_npz_that_says_less_than_it_holds_gives_no_more_than_it_says(client):
    content = bytearray(npz(np.zeros(100_000)))
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        size = archive.getinfo("a.npy").file_size
    told = content.replace(size.to_bytes(4, "little"), (1000).to_bytes(4, "little"))
    answer = client.post(WINDOWS, content=bytes(told), headers={"Content-Type": "application/zip"})
    assert answer.status_code == 400 and answer.json()["detail"].startswith("body: ")


def test_readers_that_take_long_hold_up_neither_the_loop_nor_other_routes(client, monkeypatch):
    """Though there are more of them than threads for requests."""
    may_end, busy = threading.Event(), threading.Semaphore(0)

    def slow(*_, **__):
        busy.release()
        assert may_end.wait(60)
        raise signal_body.BadBody("body: enough")

    monkeypatch.setattr(signal_body, "read_body", slow)
    content, kind = csv(), {"Content-Type": "text/csv"}
    asked = {"content": content, "headers": kind, "timeout": 60}
    url = f"{str(client.base_url).rstrip('/')}{WINDOWS}"
    senders = [threading.Thread(target=httpx.post, args=(url,), kwargs=asked) for _ in range(50)]
    for sender in senders:
        sender.start()
    try:
        assert busy.acquire(timeout=60) and busy.acquire(timeout=60)
        for path in ("/api/v1/health/live", "/api/v1/health/ready", "/api/v1/assets"):
            assert client.get(path).status_code == 200
        # needs no process, so it waits for none
        short = client.post("/api/v1/models?name=short", content=b"name: short")
        assert short.status_code == 422 and short.json()["detail"].startswith("model file")
        assert not busy.acquire(timeout=0.1), "two at once"
    finally:
        may_end.set()
        for sender in senders:
            sender.join(60)


def test_a_question_is_short(client, refused):
    kind = {"Content-Type": "application/json"}
    path = "/api/v1/models/gate-drive/compare"
    status, says = refused("POST", path, content=b" " * (responses._LARGEST + 1), headers=kind)
    assert status == 413 and "no more are read here" in says
    status, says = refused("POST", path, content=b"[" + b"[]," * 60_000 + b"[]]", headers=kind)
    assert (status, says) == (413, "body: more than 50000 lists and objects; no more are read here")
    status, _ = refused("POST", path, content=b"[" + b"[]," * 20_000 + b"[]]", headers=kind)
    assert status == 422


def test_a_long_model_and_a_packed_one_are_checked_within_limits(client, refused):
    # the service has it; its own text is short
    model = client.get("/api/v1/models/gate-drive/description")
    assert model.status_code == 200
    long = (
        "name: long\n"
        + "".join(f"# note {number}\n" for number in range(2000))
        + (
            "inputs: {u: V}\nstates: {x: {unit: V}}\nparameters: {T: {value: 1, unit: s}}\n"
            "balances: {store: {kind: heat, storage: T * der(x), terms: {in: u - x}}}\noutputs: {y: {value: x, unit: V}}\n"
        )
    )
    answer = client.post("/api/v1/models?name=long", content=long.encode())
    assert answer.status_code in (201, 422) and "ended the process" not in answer.text
    broken = long.replace("states: {x: {unit: V}}", "states: {x: {unit: V}, x: {unit: V}}")
    status, says = refused("POST", "/api/v1/models?name=long", content=broken.encode())
    assert status == 422 and says.startswith("model file, line 2003") and "stands twice" in says
    with zipfile.ZipFile(packed := io.BytesIO(), "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("schema.json", b" " * 2**30)
    status, says = refused(
        "POST", "/api/v1/models?name=b&kind=baseline&diagnoser=bearing", content=packed.getvalue()
    )
    assert status == 422 and says.startswith("model file: ")


def test_what_is_wrong_is_of_the_same_kind_in_a_long_body_and_in_a_short_one(client):
    told = []
    for samples in (10, MANY):
        wrong = {
            "sample_time": 1e-3,
            "channels": {"a": SIGNAL[:samples].tolist()},
            "units": {"a": "m//s("},
        }
        answer = client.post(
            WINDOWS,
            content=json.dumps(wrong).encode(),
            headers={"Content-Type": "application/json"},
        )
        assert "unit 'm//s(': not a known unit" in answer.json()["detail"]
        told.append((answer.status_code, answer.json()["type"]))
    assert told == [(422, "urn:residuum:problem:bad-unit")] * 2


def test_a_baseline_of_an_unknown_diagnoser_is_refused_before_a_process_is_started(
    refused, monkeypatch
):
    monkeypatch.setattr(
        model_files, "run_limited", lambda *_, **__: pytest.fail("a process was started")
    )
    status, says = refused(
        "POST", "/api/v1/models?name=b&kind=baseline&diagnoser=nope", content=b"PK"
    )
    assert status == 404 and says.startswith("diagnoser 'nope': there is none of this name")
    status, says = refused("POST", "/api/v1/models?name=b&kind=baseline", content=b"PK")
    assert status == 422 and "diagnoser is missing" in says


def test_routes_are_put_together_before_anybody_asks(run_service):
    assert run_service().app.openapi_schema is not None


def test_the_watch_tells_how_long_the_loop_was_held_up():
    told = []

    async def held_up():
        watch = asyncio.create_task(watch_loop(told.append, 0.01))
        await asyncio.sleep(0.05)
        time.sleep(0.2)
        await asyncio.sleep(0.05)
        watch.cancel()

    asyncio.run(held_up())
    assert max(told) >= 0.15


def test_what_is_loaded_is_looked_at_no_more():
    settle_memory()
    assert gc.get_freeze_count() > 1000
    gc.unfreeze()


def test_an_npz_whose_packed_bytes_are_damaged_is_refused(client, refused):
    content = bytearray(npz(SIGNAL))
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        begin = archive.getinfo("a.npy").header_offset + 60
    content[begin : begin + 40] = bytes(40)
    for path in (WINDOWS, "/api/v1/records?filename=a.npz"):
        status, says = refused(
            "POST", path, content=bytes(content), headers={"Content-Type": "application/zip"}
        )
        assert status == 400 and "is not an NPZ file" in says
