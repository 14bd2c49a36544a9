"""Overload: clients ask without pause for a minute, many times as often as they may, and the service must neither grow nor fall.

    python -m benchmarks.overload --seconds 60

Every request beyond the rate must be answered 429 with Retry-After, and the service's own counters must agree with the clients'.
"""

from __future__ import annotations

import argparse
import multiprocessing
import re
import sys
import tempfile
import threading
import time
from collections import Counter
from http.client import HTTPConnection
from pathlib import Path
from typing import Any

import uvicorn

from benchmarks.free_port import free_port
from benchmarks.http_cases import _npy, _resident, _wait
from residuum.service.app import create_app
from residuum.service.security.access import new_key
from residuum.service.settings import load_settings

RATE = 10.0
CLIENTS = 4
PATH = "/api/v1/assets/press/windows?diagnoser=bearing&channel=acceleration%20%5Bm%2Fs%C2%B2%5D&sample_time=0.001"


def serve(data: str, port: int, keys: str) -> None:
    """The service as other machines reach it."""
    settings = load_settings(
        data=Path(data),
        host="0.0.0.0",
        port=port,
        api_keys=Path(keys),
        rate_limit=RATE,
        workers=1,
        log_level="error",
    )
    uvicorn.run(
        create_app(settings), host="127.0.0.1", port=port, log_config=None, access_log=False
    )


def campaign(seconds: float) -> dict[str, Any]:
    """Overload one key from several connections; what was answered, and how the service grew."""
    (key, digest), (monitor, monitor_digest) = new_key(), new_key()
    with tempfile.TemporaryDirectory() as data:
        (Path(data) / "keys").write_text(
            f"gateway engineer {digest}\nlooker monitor {monitor_digest}\n"
        )
        port = free_port()
        process = multiprocessing.get_context("spawn").Process(
            target=serve, args=(data, port, str(Path(data) / "keys"))
        )
        process.start()
        try:
            _wait(port)
            _ask(port, key, 5.0)
            before, counted_before = _resident(int(process.pid or 0)), _counted(port, monitor)
            begun = time.monotonic()
            answers = _ask(port, key, seconds)
            took = time.monotonic() - begun
            grown = _resident(int(process.pid or 0)) - before
            counted = _counted(port, monitor) - counted_before
        finally:
            process.kill()
            process.join()
    asked = sum(answers.values()) - answers["429 without Retry-After"]
    return {
        "seconds": round(took, 1),
        "asked": asked,
        "times the allowed rate": round(asked / took / RATE, 1),
        "taken (201)": answers["201"],
        "most that may be taken": int(2 * RATE + RATE * took + 1),
        "refused (429)": answers["429"],
        "429 without Retry-After": answers["429 without Retry-After"],
        "other answers": asked - answers["201"] - answers["429"],
        "refusals that the service counted": counted,
        "grown [MiB]": grown,
    }


def _ask(port: int, key: str, seconds: float) -> Counter[str]:
    answers: Counter[str] = Counter()
    lock, end, body = threading.Lock(), time.monotonic() + seconds, _npy()

    def ask() -> None:
        mine: Counter[str] = Counter()
        connection = HTTPConnection("127.0.0.1", port, timeout=60)
        headers = {"X-API-Key": key, "Content-Type": "application/octet-stream"}
        while time.monotonic() < end:
            connection.request("POST", PATH, body, headers)
            answer = connection.getresponse()
            answer.read()
            mine[str(answer.status)] += 1
            mine["429 without Retry-After"] += (
                answer.status == 429 and int(answer.headers.get("Retry-After", 0)) < 1
            )
        with lock:
            answers.update(mine)

    clients = [threading.Thread(target=ask) for _ in range(CLIENTS)]
    for client in clients:
        client.start()
    for client in clients:
        client.join()
    return answers


def _counted(port: int, key: str) -> int:
    connection = HTTPConnection("127.0.0.1", port, timeout=60)
    connection.request("GET", "/metrics", headers={"X-API-Key": key})
    text = connection.getresponse().read().decode()
    found = re.findall(
        r'^residuum_http_requests_total\{[^}]*status="429"[^}]*\} ([0-9.e+]+)$', text, re.M
    )
    return int(sum(map(float, found)))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=60.0)
    found = campaign(parser.parse_args().seconds)
    for what, figure in found.items():
        print(f"{what:<36}{figure}")
    if found["429 without Retry-After"] or found["other answers"] or found["grown [MiB]"] > 64:
        sys.exit(1)


if __name__ == "__main__":
    main()
