"""Keys guessed from several addresses at once, beside an operator who has the right one.

    python -m benchmarks.wrong_keys --seconds 20

A service with its usual limits, behind a trusted proxy that names the clients' addresses. Each guesser shows another wrong key as
fast as it is answered; an operator reads beside them. At most the burst and one wrong key a second may be answered 401 for an
address, the others 429; no guess may be answered otherwise, the operator always with 200; and the audit trail must tell of all
that was refused. The exit status is 1 when one of this is not so.
"""

from __future__ import annotations

import argparse
import json
import secrets
import sys
import tempfile
import threading
import time
from collections import Counter
from http.client import HTTPConnection
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import uvicorn

from benchmarks.free_port import free_port
from benchmarks.http_cases import _wait
from residuum.service.app import create_app
from residuum.service.security.access import new_key
from residuum.service.settings import load_settings

GUESSERS = 6
NAME = "plant.example"
RATE, BURST = 1.0, 20.0
"""Wrong keys a second, and at once, that are answered 401 for an address under the usual limits."""


def serve(folder: str, port: int) -> None:
    """A service as it stands behind a proxy."""
    settings = load_settings(
        data=Path(folder) / "data",
        port=port,
        workers=1,
        log_level="error",
        api_keys=Path(folder) / "keys",
        public_url=f"https://{NAME}/",
        trusted_proxies=["127.0.0.1"],
    )
    uvicorn.run(
        create_app(settings), port=port, log_config=None, access_log=False, proxy_headers=False
    )


def ask(port: int, key: str, address: str, path: str = "/api/v1/assets") -> tuple[int, bytes]:
    """One question with a key, from an address."""
    connection = HTTPConnection("127.0.0.1", port, timeout=60)
    connection.request(
        "GET", path, headers={"Host": NAME, "X-API-Key": key, "X-Forwarded-For": address}
    )
    answer = connection.getresponse()
    said = answer.status, answer.read()
    connection.close()
    return said


def campaign(seconds: float) -> dict[str, Any]:
    """What guessers and operator were answered, and what the trail counts."""
    with tempfile.TemporaryDirectory() as folder:
        keys = {role: new_key() for role in ("operator", "engineer")}
        (Path(folder) / "keys").write_text(
            "\n".join(f"{role} {role} {digest}" for role, (_, digest) in keys.items())
        )
        port = free_port()
        service = get_context("spawn").Process(target=serve, args=(folder, port))
        service.start()
        try:
            _wait(port)
            guessed: list[Counter[int]] = [Counter() for _ in range(GUESSERS)]
            end = time.monotonic() + seconds

            def guess(number: int) -> None:
                while time.monotonic() < end:
                    guessed[number][
                        ask(port, secrets.token_urlsafe(32), f"192.0.2.{number + 1}")[0]
                    ] += 1

            threads = [threading.Thread(target=guess, args=(number,)) for number in range(GUESSERS)]
            for thread in threads:
                thread.start()
            operator: Counter[int] = Counter()
            while time.monotonic() < end:
                operator[ask(port, keys["operator"][0], "192.0.2.1")[0]] += (
                    1  # from the address of a guesser
                )
                time.sleep(0.05)
            for thread in threads:
                thread.join()
            noted = _noted(port, keys["engineer"][0], sum(each[401] for each in guessed))
            return {"guessed": guessed, "operator": dict(operator), "noted as 401": noted}
        finally:
            service.kill()
            service.join()


def _noted(port: int, key: str, expected: int) -> int:
    """Refusals with 401 that the trail counts, once it counts as many as were answered."""
    end = time.monotonic() + 60
    while True:
        items = json.loads(ask(port, key, "192.0.2.200", "/api/v1/audit?limit=500")[1])["items"]
        refused = [each["detail"] for each in items if each["action"] == "refused"]
        count = sum(each["times"] for each in refused if each["status"] == 401)
        if count >= expected or time.monotonic() > end:
            return count
        time.sleep(0.5)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=20.0)
    given = parser.parse_args()
    found = campaign(given.seconds)
    for what, figure in found.items():
        print(f"{what:<14}{figure}")
    most = BURST + RATE * (given.seconds + 5.0)
    bad = [each for each in found["guessed"] if each[401] > most or set(each) - {401, 429}]
    if (
        bad
        or set(found["operator"]) != {200}
        or found["noted as 401"] < sum(each[401] for each in found["guessed"])
    ):
        sys.exit(1)


if __name__ == "__main__":
    main()
