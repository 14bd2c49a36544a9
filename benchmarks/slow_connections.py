"""Connections of strangers that hold their place, beside the plant's source and an operator, who must notice nothing.

    python -m benchmarks.slow_connections --seconds 60

A service by TLS that may open few files. Strangers without a key hold 200 connections of six kinds, from eight addresses, one of
which is the source's and the operator's: heads and uploads of a byte a second, uploads that stop halfway, answers that nobody
takes, handshakes that stop, and requests after which nothing comes. Whoever is sent away comes again a second later. The source
sends windows, each over a connection of its own until it is answered; the operator opens the page, Plotly and the list of assets.
The exit status is 1 when a window is lost, or the 99th percentile of the operator's answers is over 1 s.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import socket
import ssl
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from http.client import HTTPException, HTTPSConnection
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.certificates import certificate_and_key
from benchmarks.free_port import free_port
from residuum.service.security.access import new_key

CONNECTIONS = 200
ADDRESSES = 8
FILES = 256
"""That the service may open: half of them are its places for connections, a quarter those of strangers."""
WITHIN = 1.0
PAGES = ("/", "/vendor/plotly.min.js", "/api/v1/assets")
_HEAD = b"GET / HTTP/1.1\r\nHost: plant.example\r\nX-Padding: "
_POST = b"POST /api/v1/assets/press/windows?diagnoser=bearing HTTP/1.1\r\nHost: plant.example\r\nContent-Length: "


class Strangers:
    """So many connections of six kinds at once, each begun again as soon as it is closed; `closed` counts that by kind."""

    def __init__(self, port: int, count: int) -> None:
        self.closed: Counter[str] = Counter()
        self._port = port
        self._context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
        self._context.check_hostname, self._context.verify_mode = False, ssl.CERT_NONE
        self._stopping = threading.Event()
        self._threads = [
            threading.Thread(target=self._hold, args=(number,), daemon=True)
            for number in range(count)
        ]

    def start(self) -> None:
        """Begin."""
        for thread in self._threads:
            thread.start()

    def stop(self) -> None:
        """Let go."""
        self._stopping.set()
        for thread in self._threads:
            thread.join(60)

    def _hold(self, number: int) -> None:
        kind = list(KINDS)[number % len(KINDS)]
        source = f"127.0.0.{number // len(KINDS) % ADDRESSES + 1}"
        while not self._stopping.is_set():
            with (
                suppress(OSError),
                socket.create_connection(("127.0.0.1", self._port), 60, (source, 0)) as plain,
            ):
                plain.settimeout(1.0)
                if kind == "handshakes that stop":
                    self._say(plain, b"\x16\x03\x01\x02\x00\x01", None)
                else:
                    plain.settimeout(20.0)
                    with self._context.wrap_socket(plain) as safe:
                        safe.settimeout(1.0)
                        self._say(safe, *KINDS[kind])
            self.closed[kind] += 1
            self._stopping.wait(1.0)

    def _say(self, connection: socket.socket, first: bytes, then: bytes | None) -> None:
        """Until it is closed: something, then a byte a second, or nothing; what is answered is taken only by who drips."""
        connection.sendall(first)
        while not self._stopping.is_set():
            if then is None:
                self._stopping.wait(1.0)
                if _closed(connection):
                    return
                continue
            connection.sendall(then)
            with suppress(TimeoutError):
                if not connection.recv(1):
                    return


KINDS: dict[str, tuple[bytes, bytes | None]] = {
    "heads": (_HEAD, b"x"),
    # longer than is taken: it is thrown away before it is refused
    "uploads": (_POST + b"200000000\r\n\r\n", b"x"),
    "uploads that stop": (_POST + b"100000\r\n\r\n{", None),
    "answers not taken": (
        b"GET /vendor/plotly.min.js HTTP/1.1\r\nHost: plant.example\r\n\r\n",
        None,
    ),
    "handshakes that stop": (b"", None),
    "nothing more": (b"GET / HTTP/1.1\r\nHost: plant.example\r\n\r\n", None),
}


def _closed(connection: socket.socket) -> bool:
    """Whether the other side has closed it, without taking what came."""
    with socket.socket(fileno=os.dup(connection.fileno())) as same:
        return same.getsockopt(socket.IPPROTO_TCP, socket.TCP_INFO, 1)[0] != 1  # not ESTABLISHED


class Source(threading.Thread):
    """Sends windows ten times a second; `answered` are the numbers of those that were taken."""

    def __init__(self, ask: Callable[..., tuple[int, bytes]]) -> None:
        super().__init__(daemon=True)
        self.answered: list[int] = []
        self.again = 0
        self._ask, self._stopping = ask, threading.Event()

    def run(self) -> None:
        """Each until it is answered."""
        number = 0
        while not self._stopping.wait(0.1):
            body = {
                "sample_time": 1e-3,
                "t0": float(number),
                "channels": {"a": [0.0, 1.0] * 100},
                "units": {"a": "m/s²"},
            }
            headers = {"Content-Type": "application/json", "Idempotency-Key": f"window-{number}"}
            try:
                path = "/api/v1/assets/press/windows?diagnoser=bearing"
                taken = self._ask("POST", path, json.dumps(body).encode(), headers)[0] in (200, 201)
            except (OSError, HTTPException):
                taken = False
            if taken:
                self.answered.append(number)
                number += 1
            else:
                self.again += 1

    def stop(self) -> None:
        """End with the window that is being sent."""
        self._stopping.set()
        self.join(120)


def campaign(seconds: float, connections: int = CONNECTIONS, files: int = FILES) -> dict[str, Any]:
    """What source and operator met, with strangers about for so long."""
    (key, digest), (operator, operator_digest) = new_key(), new_key()
    with tempfile.TemporaryDirectory() as name:
        folder, port = Path(name), free_port()
        (folder / "keys").write_text(f"gateway engineer {digest}\neva operator {operator_digest}\n")
        certificate, private = certificate_and_key(folder)
        trusted = ssl.create_default_context(cafile=str(certificate))

        def asker(shown: str) -> Callable[..., tuple[int, bytes]]:
            def ask(
                method: str,
                path: str,
                body: bytes | None = None,
                headers: dict[str, str] | None = None,
            ) -> tuple[int, bytes]:
                connection = HTTPSConnection("127.0.0.1", port, timeout=60, context=trusted)
                try:
                    connection.request(method, path, body, {"X-API-Key": shown, **(headers or {})})
                    answer = connection.getresponse()
                    return answer.status, answer.read()
                finally:
                    connection.close()

            return ask

        settings = {
            "RESIDUUM_HOST": "0.0.0.0",
            "RESIDUUM_API_KEYS": str(folder / "keys"),
            "RESIDUUM_TLS_CERTIFICATE": str(certificate),
            "RESIDUUM_TLS_KEY": str(private),
            "RESIDUUM_LOG_LEVEL": "error",
            "RESIDUUM_WORKERS": "1",
        }
        command = [
            sys.executable,
            "-m",
            "residuum",
            "serve",
            "--port",
            str(port),
            "--data",
            str(folder / "data"),
        ]
        limits = (files, files)
        with subprocess.Popen(
            command,
            env=os.environ | settings,
            stdout=subprocess.PIPE,
            preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_NOFILE, limits),  # noqa: PLW1509 - before any thread begins
        ) as service:
            try:
                assert service.stdout is not None
                service.stdout.readline()
                return _counted(asker(key), asker(operator), port, connections, seconds)
            finally:
                service.terminate()


def _counted(
    source_asks: Callable[..., Any],
    operator_asks: Callable[..., Any],
    port: int,
    count: int,
    seconds: float,
) -> dict[str, Any]:
    context, source, times, other = get_context("spawn"), Source(source_asks), [], 0
    ended, told = context.Event(), context.Queue()
    # apart: their work is not the service's
    strangers = context.Process(target=_be_strangers, args=(port, count, ended, told))
    source.start()
    while not source.answered:
        time.sleep(0.05)
    strangers.start()
    told.get(timeout=120)
    time.sleep(2.0)  # until they hold what they can
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        for page in PAGES:
            begun = time.perf_counter()
            try:
                other += operator_asks("GET", page)[0] != 200
            except (OSError, HTTPException):
                other += 1
            times.append(time.perf_counter() - begun)
        time.sleep(0.1)
    source.stop()
    ended.set()
    closed = told.get(timeout=120)
    strangers.join()
    stored = _stored(operator_asks)
    return {
        "windows": len(source.answered),
        "sent again": source.again,
        "lost": len(set(source.answered) - set(stored)),
        "twice": len(stored) - len(set(stored)),
        "pages": len(times),
        "other than 200": other,
        "p99": float(np.quantile(times, 0.99)),
        "longest": max(times),
        "sent away": closed,
    }


def _be_strangers(port: int, count: int, ended: Any, told: Any) -> None:
    strangers = Strangers(port, count)
    strangers.start()
    told.put(None)
    ended.wait()
    strangers.stop()
    told.put(dict(strangers.closed))


def _stored(ask: Callable[..., Any]) -> list[int]:
    found, cursor = [], ""
    while True:
        page = json.loads(ask("GET", f"/api/v1/assets/press/windows?limit=500{cursor}")[1])
        found += [round(each["t0"]) for each in page["items"]]
        if page.get("next_cursor") is None:
            return found
        cursor = f"&cursor={page['next_cursor']}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--connections", type=int, default=CONNECTIONS)
    parser.add_argument("--files", type=int, default=FILES, help="that the service may open")
    given = parser.parse_args()
    found = campaign(given.seconds, given.connections, given.files)
    for what, figure in found.items():
        print(f"{what:<16}{figure}")
    if (
        found["lost"]
        or found["twice"]
        or not found["windows"]
        or found["other than 200"]
        or found["p99"] > WITHIN
    ):
        sys.exit(1)


if __name__ == "__main__":
    main()
