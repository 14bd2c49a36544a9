"""Units as bombs, by every way by which a unit's text comes in: powers of powers, parentheses, new words by the thousand.

    python -m benchmarks.unit_bombs --bombs 500

Units are drawn from a grammar of what would be computed for minutes, fill memory or never end. Each is sent as JSON, as CSV, as
NPZ (as a gateway sends windows) and in a model (YAML) to a service in a process of its own, whose event loop is watched. Each
must be answered within a second, and the loop may not be held up for more than 100 ms. The exit status is 1 when one is not.
"""

from __future__ import annotations

import argparse
import io
import json
import multiprocessing
import random
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from http.client import HTTPConnection
from typing import Any

import numpy as np

from benchmarks.event_loop import GATE, serve
from benchmarks.free_port import free_port
from benchmarks.http_cases import _wait

WITHIN = 1.0
KNOWN = (
    "9**9**9",
    "m**1e9",
    "((m**99)**99)**99",
    "m**-99999999",
    "9" * 80,
    "(" * 40 + ")" * 40,
    "m**(1/0)",
    "1/0*m",
    "m" * 80,
)
_WORDS = ("m", "s", "kg", "degC", "furlong", "kilometer", "ticks", "1", "9", "µ" * 20, "zork")
MODEL = """\
name: bomb
inputs: {{u: "{unit}"}}
states: {{x: {{unit: "{unit}"}}}}
parameters: {{T: {{value: 1.0, unit: s}}}}
balances:
  loop: {{kind: signal, storage: der(x), terms: {{supply: u / T}}}}
outputs: {{y: {{value: x, unit: "{unit}"}}}}
"""


def bombs(rng: random.Random) -> Iterator[str]:
    """Units without end: those that were found by hand first."""
    yield from KNOWN
    while True:
        yield _drawn(rng, 0)[: rng.choice((20, 80, 80, 5000))]


def _drawn(rng: random.Random, depth: int) -> str:
    kind = rng.random()
    if depth > 6 or kind < 0.15:
        return rng.choice(_WORDS) + rng.choice(("", "", str(rng.randrange(10**6))))
    inner = _drawn(rng, depth + 1)
    if kind < 0.45:
        power = rng.choice(
            (
                "9",
                "99",
                "1e9",
                "-9e99",
                "9**9",
                "(9**9)",
                "(1/3)",
                "0.5",
                "nan",
                "1e-999",
                "10000000",
            )
        )
        return f"({inner}){rng.choice(('**', '^'))}{power}"
    if kind < 0.5:
        deep = rng.choice((1, 2, 4, 40))
        return "(" * deep + inner + ")" * rng.choice((deep, deep, deep - 1))
    return rng.choice(("*", "/", " ", "**", " per ", "//", "%", "@", "+")).join(
        (inner, _drawn(rng, depth + 1))
    )


def as_json(bomb: str, number: int) -> tuple[str, str, bytes]:
    """A window of which one channel, or each of a hundred with a word of its own, has the unit."""
    names = ["acceleration"] if number % 5 else [f"a{k}" for k in range(100)]
    units = {
        name: bomb if len(names) == 1 else f"{bomb[:60]}*w{number}x{k}"
        for k, name in enumerate(names)
    }
    body = {"sample_time": 1e-3, "channels": {name: [0.0, 1.0] for name in names}, "units": units}
    return "/api/v1/score/bearing", "application/json", json.dumps(body).encode()


def as_csv(bomb: str, number: int) -> tuple[str, str, bytes]:
    """A window as CSV."""
    return (
        "/api/v1/score/bearing",
        "text/csv",
        f"time [s],acceleration [{bomb}]\n0,0\n0.001,1\n0.002,{number}\n".encode(),
    )


def as_npz(bomb: str, number: int) -> tuple[str, str, bytes]:
    """A window as a gateway sends it."""
    file = io.BytesIO()
    units = np.array(json.dumps({"acceleration": bomb}))
    np.savez(file, acceleration=np.array([0.0, number]), sample_time=1e-3, units=units)
    return "/api/v1/score/bearing", "application/zip", file.getvalue()


def as_model(bomb: str, number: int) -> tuple[str, str, bytes]:
    """A model whose state, parameter and output have the unit."""
    path = f"/api/v1/models?name=bomb-{number}&kind=physical"
    return path, "application/octet-stream", MODEL.format(unit=bomb.replace('"', "")).encode()


WAYS: dict[str, Callable[[str, int], tuple[str, str, bytes]]] = {
    "JSON": as_json,
    "CSV": as_csv,
    "NPZ": as_npz,
    "YAML": as_model,
}


def ask(port: int, way: str, drawn: list[str]) -> dict[str, Any]:
    """Send all by one way; statuses, the longest time to an answer [s], and what was wrong."""
    connection, statuses, longest, wrong = (
        HTTPConnection("127.0.0.1", port, timeout=120),
        Counter[int](),
        0.0,
        [],
    )
    for number, bomb in enumerate(drawn):
        path, kind, body = WAYS[way](bomb, number)
        begun = time.perf_counter()
        connection.request("POST", path, body, {"Content-Type": kind})
        answer = connection.getresponse()
        says = answer.read()
        longest = max(longest, time.perf_counter() - begun)
        statuses[answer.status] += 1
        if answer.status >= 500:
            wrong.append(f"{way} {bomb[:90]!r}: {answer.status} {says[:120]!r}")
    connection.close()
    return {"answers": dict(sorted(statuses.items())), "longest": longest, "wrong": wrong}


def campaign(count: int, seed: int = 0) -> dict[str, Any]:
    """All ways; each with the answers and the longest time, and the longest stall of the service's event loop."""
    drawn = [bomb for bomb, _ in zip(bombs(random.Random(seed)), range(count), strict=False)]
    found: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as folder:
        port, stall = free_port(), multiprocessing.get_context("spawn").Value("d", 0.0)
        service = multiprocessing.get_context("spawn").Process(
            target=serve, args=(f"{folder}/http", port, stall)
        )
        service.start()
        try:
            _wait(port)
            ask(port, "JSON", ["m/s²"])  # the table of units is read beside the start
            for way in WAYS:
                stall.value = 0.0
                found[way] = ask(port, way, drawn) | {"longest stall": stall.value}
        finally:
            service.kill()
            service.join()
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--bombs", type=int, default=500)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    found = campaign(given.bombs, given.seed)
    for way, figures in found.items():
        print(f"{way:<8}{figures}")
    late = [way for way, figures in found.items() if figures.get("longest", 0.0) > WITHIN]
    held_up = [way for way, figures in found.items() if figures.get("longest stall", 0.0) > GATE]
    if late or held_up or any(figures.get("wrong") for figures in found.values()):
        sys.exit(1)


if __name__ == "__main__":
    main()
