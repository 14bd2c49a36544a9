"""Scoring one 4096-sample window over HTTP, beside the framework's own routes and the diagnoser alone.

Every route is asked in turn by one client over one connection that stays open, each server in a process of its own.
Two times are given: what the client waits (which a busy machine stretches), and the processor time that the server spends.
The overhead is the processor time of our route with a diagnoser that costs nothing, over that of the framework's octet route,
which only takes the bytes; the limit is 1.5.
"""

from __future__ import annotations

import atexit
import io
import multiprocessing
import os
import socket
import tempfile
import time
from collections.abc import Callable
from http.client import HTTPConnection
from pathlib import Path

import numpy as np
import orjson
import uvicorn
from fastapi import FastAPI, Request, Response
from pydantic import BaseModel

from benchmarks.free_port import free_port
from residuum.diagnosis.diagnosers import DIAGNOSERS
from residuum.diagnosis.diagnosers.bearing import Bearing
from residuum.diagnosis.finding import Finding
from residuum.identification.record import Record
from residuum.service.app import create_app
from residuum.service.settings import load_settings

N, RATE = 4096, 12_800
ROUNDS, BLOCK = 2000, 100
FREE = "channel=acceleration%20%5Bm%2Fs%C2%B2%5D&sample_time=7.8125e-05"
HEADS = f"{FREE}&speed_rpm=1500"


class Window(BaseModel):
    """The body of the framework's JSON route."""

    sample_time: float
    channels: dict[str, list[float]]
    units: dict[str, str]


def framework() -> FastAPI:
    """What FastAPI itself costs: bytes in, and JSON through pydantic, a small JSON answer."""
    app = FastAPI()

    @app.post("/octets")
    async def octets(request: Request) -> Response:
        body = await request.body()
        return Response(orjson.dumps({"bytes": len(body)}), media_type="application/json")

    @app.post("/pydantic")
    async def pydantic(window: Window) -> Response:
        return Response(orjson.dumps({"n": len(window.channels)}), media_type="application/json")

    return app


class Free(Bearing):
    """A diagnoser that says at once what a bearing's said once: what is left is the cost of the route."""

    _said: Finding | None = None

    def score(self, record: Record) -> Finding:
        """The first window's finding."""
        self._said = self._said or super().score(record)
        return self._said


def service(data: str) -> FastAPI:
    """Ours, with the diagnoser that costs nothing beside the real ones."""
    DIAGNOSERS["free"] = Free
    return create_app(load_settings(data=Path(data), workers=1, log_level="error"))


def serve(make: Callable[..., FastAPI], *arguments: str) -> tuple[int, int]:
    """Run an app in a process of its own; gives its port and process number."""
    port = free_port()
    process = multiprocessing.get_context("spawn").Process(
        target=_run, args=(make, arguments, port)
    )
    process.start()
    atexit.register(process.kill)
    for _ in range(3000):
        with socket.socket() as attempt:
            if attempt.connect_ex(("127.0.0.1", port)) == 0:
                return port, int(process.pid or 0)
        time.sleep(0.1)
    raise RuntimeError("the server did not start")


def _run(make: Callable[..., FastAPI], arguments: tuple[str, ...], port: int) -> None:
    uvicorn.run(make(*arguments), port=port, log_config=None, access_log=False)


def poster(port: int, path: str, body: bytes, kind: str) -> Callable[[], None]:
    """A function that posts once over a connection that stays open."""
    connection = HTTPConnection("127.0.0.1", port)

    def post() -> None:
        connection.request("POST", path, body, {"Content-Type": kind})
        answer = connection.getresponse()
        content = answer.read()
        if answer.status != 200:
            raise RuntimeError(content.decode())

    return post


def processor_seconds(process: int) -> float:
    """Processor time that a process has spent, by the kernel's count (10 ms ticks)."""
    fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def measure(
    jobs: dict[str, tuple[Callable[[], object], int]], rounds: int
) -> dict[str, tuple[float, float]]:
    """(median seconds, mean processor seconds of its process) of each job; blocks of the jobs take turns."""
    waited: dict[str, list[float]] = {name: [] for name in jobs}
    spent = dict.fromkeys(jobs, 0.0)
    for _ in range(rounds // BLOCK):
        for name, (job, process) in jobs.items():
            before = processor_seconds(process)
            for _ in range(BLOCK):
                begun = time.perf_counter()
                job()
                waited[name].append(time.perf_counter() - begun)
            spent[name] += processor_seconds(process) - before
    return {
        name: (float(np.median(times)), spent[name] / len(times)) for name, times in waited.items()
    }


def main(rounds: int = ROUNDS) -> None:
    """Print the table."""
    signal = np.random.default_rng(0).normal(size=N)
    file = io.BytesIO()
    np.save(file, signal)
    npy = file.getvalue()
    as_json = orjson.dumps(
        {
            "sample_time": 1 / RATE,
            "channels": {"acceleration": signal.tolist()},
            "units": {"acceleration": "m/s²"},
        }
    )
    judge = DIAGNOSERS["bearing"](speed_rpm=1500.0)
    record = Record({"acceleration": signal}, {"acceleration": "m/s²"}, 1 / RATE)
    octet, text = "application/octet-stream", "application/json"
    with tempfile.TemporaryDirectory() as data:
        ours, our_process = serve(service, data)
        theirs, their_process = serve(framework)
        jobs: dict[str, tuple[Callable[[], object], int]] = {
            "the diagnoser itself": (lambda: judge.score(record), os.getpid()),
            "framework, octets": (poster(theirs, "/octets", npy, octet), their_process),
            "framework, JSON by pydantic": (
                poster(theirs, "/pydantic", as_json, text),
                their_process,
            ),
            "score, octets, diagnoser for free": (
                poster(ours, f"/api/v1/score/free?{FREE}", npy, octet),
                our_process,
            ),
            "score, octets": (
                poster(ours, f"/api/v1/score/bearing?{HEADS}", npy, octet),
                our_process,
            ),
            "score, JSON": (
                poster(ours, "/api/v1/score/bearing?speed_rpm=1500", as_json, text),
                our_process,
            ),
        }
        measure(jobs, 2 * BLOCK)  # warm
        found = measure(jobs, rounds)
    octets = found["framework, octets"][1]
    print(
        "| 4096 samples, one connection | waited [ms] | processor [ms] | overhead ÷ octet route |"
    )
    print("|---|---|---|---|")
    for name, (waited, spent) in found.items():
        overhead = f"{spent / octets:.2f}" if name.endswith("for free") else ""
        print(f"| {name} | {1e3 * waited:.3f} | {1e3 * spent:.3f} | {overhead} |")


if __name__ == "__main__":
    main()
