"""The event loop: how long whatever is sent or asked for holds up everybody else.

    python -m benchmarks.event_loop

A service in a process of its own, watched from inside by a timer of 2 ms. One row a request: the answer, its time, and the
longest stall of the loop meanwhile. The exit status is 1 when one exceeds the gate of 100 ms.
"""

from __future__ import annotations

import argparse
import asyncio
import io
import json
import multiprocessing
import sys
import tempfile
import time
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import uvicorn

from benchmarks.free_port import free_port
from benchmarks.http_cases import _wait
from residuum.service.app import create_app, watch_loop
from residuum.service.settings import load_settings
from residuum.service.work.loaded_modules import settle_memory

GATE = 0.1
MEGA = 2**20
WINDOW = "/api/v1/assets/press/windows?diagnoser=bearing"
ARRAY = "&channel=a%20%5Bm%2Fs%C2%B2%5D&sample_time=0.0001"


def serve(data: str, port: int, longest: Any) -> None:
    """The service, with its loop watched."""

    def tell(stall: float) -> None:
        longest.value = max(longest.value, stall)

    async def run() -> None:
        settings = load_settings(
            data=Path(data), port=port, workers=1, log_level="error", body_limit=100 * MEGA
        )
        server = uvicorn.Server(
            uvicorn.Config(create_app(settings), port=port, log_config=None, access_log=False)
        )
        serving = asyncio.create_task(server.serve())
        while not server.started:
            await asyncio.sleep(0.05)
        settle_memory()
        watch = asyncio.create_task(watch_loop(tell, 0.002))
        await serving
        watch.cancel()

    asyncio.run(run())


def requests() -> Iterator[tuple[str, str, str, dict[str, Any]]]:
    """What is sent, in words; method, path, request."""
    rng = np.random.default_rng(0)
    for size in (1, 20, 60):
        yield f"CSV, {size} MB", "POST", WINDOW, _body("text/csv", _csv(rng, size))
        yield f"JSON, {size} MB", "POST", WINDOW, _body("application/json", _json(rng, size))
        yield (
            f".npy, {size} MB",
            "POST",
            WINDOW + ARRAY,
            _body("application/octet-stream", _npy(rng, size)),
        )
        yield (
            f"NPZ of {size} MB",
            "POST",
            WINDOW,
            _body("application/zip", _npz(rng.normal(size=size * MEGA // 8))),
        )
    yield (
        "CSV of 20 MB, its last cell a word",
        "POST",
        WINDOW,
        _body("text/csv", _csv(rng, 20) + b"0,word\n"),
    )
    yield (
        "JSON of 60 MB, nothing but brackets",
        "POST",
        WINDOW,
        _body("application/json", b"[" * 30 * MEGA + b"]" * 30 * MEGA),
    )
    yield (
        "JSON of 60 MB, empty lists",
        "POST",
        WINDOW,
        _body("application/json", b"[" + b"[]," * 20 * MEGA + b"[]]"),
    )
    yield (
        "NPZ of .5 MB that unpacks to 500 MB",
        "POST",
        WINDOW,
        _body("application/zip", _npz(np.zeros(500 * MEGA // 8))),
    )
    yield "NPZ of 60 MB, 400 000 members", "POST", WINDOW, _body("application/zip", _many(400_000))
    ask = "/api/v1/models/gate-drive/compare"
    yield (
        "a question of 2 MB, empty lists",
        "POST",
        ask,
        _body("application/json", b'{"x":[' + b"[]," * 680_000 + b"1]}"),
    )
    yield (
        "a question of 2 MB, numbers",
        "POST",
        ask,
        _body("application/json", b'{"records":[' + b"1," * (MEGA - 20) + b"1]}"),
    )
    yield (
        "a question of 60 MB",
        "POST",
        ask,
        _body("application/json", b"[" + b"[]," * 20 * MEGA + b"[]]"),
    )
    yield (
        "a model of .2 MB",
        "POST",
        "/api/v1/models?name=m",
        _body("application/octet-stream", b"a: {b: c}\n" * 19_000),
    )
    yield (
        "a model of 60 MB",
        "POST",
        "/api/v1/models?name=m",
        _body("application/octet-stream", b"a: {b: c}\n" * 6 * MEGA),
    )
    yield (
        "a record file, CSV, 60 MB",
        "POST",
        "/api/v1/records?filename=r.csv",
        _body("text/csv", _csv(rng, 60)),
    )
    wide = _json(rng, 20, channels=200)
    yield (
        "a window of 200 channels",
        "POST",
        "/api/v1/assets/wide/windows?diagnoser=bearing",
        _body("application/json", wide),
    )
    newest = "/api/v1/assets/{asset}/windows/{window}"
    for asset in ("press", "wide"):
        yield (
            f"its signals, 20 000 points ({asset})",
            "GET",
            newest + "/signal?points=20000",
            {"asset": asset},
        )
        yield f"its record ({asset})", "GET", newest + "/record", {"asset": asset}
        yield f"its spectrum ({asset})", "GET", newest + "/spectrum?points=20000", {"asset": asset}
        yield f"its kurtogram ({asset})", "GET", newest + "/kurtogram", {"asset": asset}
        yield f"its envelope ({asset})", "GET", newest + "/envelope", {"asset": asset}
    yield (
        "scoring 60 MB",
        "POST",
        "/api/v1/score/bearing?" + ARRAY[1:],
        _body("application/octet-stream", _npy(rng, 60)),
    )


def _body(kind: str, content: bytes) -> dict[str, Any]:
    return {"content": content, "headers": {"Content-Type": kind}}


def _csv(rng: np.random.Generator, size: int) -> bytes:
    rows = b"".join(
        b"%.4f,%.9f\n" % (number * 1e-4, value)
        for number, value in enumerate(rng.normal(size=100_000))
    )
    many = size * MEGA * 100_000 // len(rows) // 1000
    values = rng.normal(size=many * 1000)
    return "time [s],a [m/s²]\n".encode() + b"".join(
        b"%.4f,%.9f\n" % (number * 1e-4, value) for number, value in enumerate(values)
    )


def _json(rng: np.random.Generator, size: int, channels: int = 1) -> bytes:
    each = size * MEGA // 20 // channels
    signals = {f"a{number}": rng.normal(size=each).tolist() for number in range(channels)}
    return json.dumps(
        {"sample_time": 1e-4, "channels": signals, "units": dict.fromkeys(signals, "m/s²")}
    ).encode()


def _npy(rng: np.random.Generator, size: int) -> bytes:
    np.save(file := io.BytesIO(), rng.normal(size=size * MEGA // 8))
    return file.getvalue()


def _npz(signal: np.ndarray[Any, Any]) -> bytes:
    np.savez_compressed(
        file := io.BytesIO(), a=signal, sample_time=1e-4, units=np.array('{"a": "m/s²"}')
    )
    return file.getvalue()


def _many(members: int) -> bytes:
    with zipfile.ZipFile(file := io.BytesIO(), "w") as archive:
        for number in range(members):
            archive.writestr(f"{number}.npy", b"")
    return file.getvalue()


def campaign() -> list[dict[str, Any]]:
    """Send one after the other; what was answered, and how long the loop stood still."""
    context = multiprocessing.get_context("spawn")
    longest = context.Value("d", 0.0, lock=False)
    rows: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as data:
        port = free_port()
        process = context.Process(target=serve, args=(data, port, longest))
        process.start()
        try:
            _wait(port)
            with httpx.Client(base_url=f"http://127.0.0.1:{port}", timeout=120) as client:
                windows: dict[str, int] = {}
                client.post(
                    WINDOW + ARRAY,
                    **_body("application/octet-stream", _npy(np.random.default_rng(1), 1)),
                )
                for says, method, path, request in requests():
                    asset = request.pop("asset", None)
                    place = (
                        path
                        if asset is None
                        else path.format(asset=asset, window=windows.get(asset, 0))
                    )
                    time.sleep(0.2)
                    longest.value, begun = 0.0, time.monotonic()
                    answer = client.request(method, place, **request)
                    took = time.monotonic() - begun
                    time.sleep(0.05)
                    stall = round(1e3 * longest.value, 1)
                    rows.append(
                        {
                            "what": says,
                            "status": answer.status_code,
                            "seconds": round(took, 2),
                            "stall_ms": stall,
                        }
                    )
                    print(
                        f"{says:<42} {answer.status_code} {took:7.2f} s  stall {stall:6.1f} ms",
                        flush=True,
                    )
                    if answer.status_code == 201 and "/windows?" in path:
                        windows[path.split("/")[4]] = answer.json()["window"]["id"]
        finally:
            process.kill()
            process.join()
    return rows


def main(arguments: list[str]) -> int:
    """Run it; 1 when the gate was missed or the service failed."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.parse_args(arguments)
    rows = campaign()
    worst = max(rows, key=lambda row: float(row["stall_ms"]))
    print(f"longest stall {worst['stall_ms']} ms ({worst['what']}); gate {1e3 * GATE:.0f} ms")
    return int(
        float(worst["stall_ms"]) > 1e3 * GATE or any(int(row["status"]) >= 500 for row in rows)
    )


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
