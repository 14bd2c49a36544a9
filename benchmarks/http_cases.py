"""Odd requests by the ten thousand: generated from the interface's own document, and bodies made by hand.

    python -m benchmarks.http_cases --cases 20000

Every operation of the OpenAPI document is asked with parameters and bodies that fit, nearly fit, or do not fit at all; a part of
the requests carries a wrong method, content type or header. No answer may be 5xx; every refusal must be a problem document of
RFC 9457 with one line; the service must neither end nor grow.
"""

from __future__ import annotations

import argparse
import io
import json
import multiprocessing
import random
import socket
import sys
import tempfile
import time
from collections import Counter
from http.client import HTTPConnection, HTTPException
from pathlib import Path
from typing import Any
from urllib.parse import quote, urlencode

import numpy as np

from benchmarks.durability import serve
from benchmarks.free_port import free_port
from residuum.service.app import create_app
from residuum.service.settings import load_settings

GOOD = {
    "sample_time": 1e-3,
    "t0": 0.0,
    "channels": {"acceleration": [0.0, 1.0, None]},
    "units": {"acceleration": "m/s²"},
    "notes": ["a"],
}
ODD_JSON = (
    "NaN", "Infinity", "-Infinity", "1e999", "-1e999", "1e-999", "-0.0", "9" * 400, "0.1e", "01", "+1", "0x10", ".5", "null",
    "true", '""', '"1"', '"\\ud800"', '"\\udc00\\ud800"', '"\\u0000"', '"\\uffff"', '"' + "a" * 5000 + '"', '"\u202e\u0000"',
    '"; DROP TABLE assets"', '"../../etc/passwd"', '"{{7*7}}"', '"${jndi:ldap://x}"', "[]", "[[]]", "[null]", '{"a": 1}',
    '{"__proto__": 1}', '{"a": 1, "a": 2}', "[" * 500 + "]" * 500, "[" * 5000 + "]" * 5000, '{"a":' * 3000 + "1" + "}" * 3000,
    "[1,]", "{,}", "'a'", "/* */ 1", "1 2", "\x00", "18446744073709551616", "-9223372036854775809", "1.7976931348623159e308",
    "5e-324", '"\\x41"', "undefined",
)  # fmt: skip
PLACES = ("sample_time", "t0", "channels", "units", "notes", "sample", "unit")
ODD_TEXTS = (
    "", "0", "-1", "1", "2", "99999999999999999999", "1e3", "nan", "inf", "true", "null", "a", "press", "gate-drive",
    "bearing", "%00", "\x00", "..", "../..", "a/b", "a" * 300, "é", "💥", "\ud7ff", "'", '"', "<b>", "1;2", "{}", "[]", "a=b",
    "MQ", "OTk5", "!!", "-0.0", "0x1", "speed [rad/s]", "acceleration [m/s²]", "x [parsec]", "physical", "baseline",
    "identified", "a.csv", "a.exe", "healthy",
)  # fmt: skip
TYPES = (
    "application/json", "application/octet-stream", "text/csv", "application/zip", "application/xml", "",
    "text/plain; charset=utf-7", "application/json; charset=latin-1", "multipart/form-data", "a" * 200,
)  # fmt: skip
FITTING = {
    "asset": "press",
    "diagnoser": "bearing",
    "model": "gate-drive",
    "window": "1",
    "sample_time": "0.001",
    "channel": "acceleration [m/s²]",
}
SLOW = ("/records", "/identify", "/events")
"""Requests that start a process, a job or a stream: asked less often (events never)."""


def handmade() -> list[bytes]:
    """Bodies of a window with one odd value in each place, and odd ones in place of the whole."""
    bodies = [odd.encode("utf-8", "surrogatepass") for odd in ODD_JSON]
    bodies += [
        _with(place).replace('""', odd).encode("utf-8", "surrogatepass")
        for place in PLACES
        for odd in ODD_JSON
    ]
    bodies += [
        b"\xff\xfe" + json.dumps(GOOD).encode("utf-16-le"),
        b"\xef\xbb\xbf" + json.dumps(GOOD).encode(),
        b"\x80",
        b"",
        b"\x1f\x8b",
    ]
    return bodies


def _with(place: str) -> str:
    changed: dict[str, Any] = json.loads(json.dumps(GOOD))
    if place == "sample":
        changed["channels"]["acceleration"][1] = ""
    elif place == "unit":
        changed["units"]["acceleration"] = ""
    else:
        changed[place] = ""
    return json.dumps(changed)


class Cases:
    """Draws requests: (method, target, headers, body)."""

    def __init__(self, document: dict[str, Any], rng: random.Random) -> None:
        self._rng = rng
        self._handmade = handmade()
        self._operations = [
            (method.upper(), path, operation)
            for path, methods in document["paths"].items()
            for method, operation in methods.items()
            if "/events" not in path
        ]

    def __call__(self) -> tuple[str, str, dict[str, str], bytes | None]:
        rng = self._rng
        method, path, operation = rng.choice(self._operations)
        while any(part in path for part in SLOW) and method == "POST" and rng.random() < 0.97:
            method, path, operation = rng.choice(self._operations)
        query = []
        for parameter in operation.get("parameters", []):
            value = self._value(parameter["name"], parameter.get("schema", {}))
            if parameter["in"] == "path":
                path = path.replace(
                    f"{{{parameter['name']}}}", quote(value, safe="", errors="replace")
                )
            elif parameter["in"] == "query" and rng.random() < 0.5:
                query += [(parameter["name"], value)] * rng.choice((1, 1, 1, 3))
        body, kind = self._body(operation) if method in ("POST", "PUT", "PATCH") else (None, None)
        headers = {"Content-Type": kind} if kind is not None else {}
        if rng.random() < 0.1:
            headers["Idempotency-Key"] = rng.choice(
                ("", "k", "k" * 300, "é".encode().decode("latin-1"))
            )
        if rng.random() < 0.05:
            headers[
                rng.choice(("Range", "Accept", "Content-Encoding", "Expect", "Last-Event-ID"))
            ] = rng.choice(("x", "gzip", "*/*;q=9"))
        if rng.random() < 0.03:
            method = rng.choice(("DELETE", "PATCH", "PUT", "HEAD", "OPTIONS", "TRACE"))
        target = path + (f"?{urlencode(query, errors='replace')}" if query else "")
        return method, target, headers, body

    def _value(self, name: str, schema: dict[str, Any]) -> str:
        rng = self._rng
        if name in FITTING and rng.random() < 0.5:
            return FITTING[name]
        if rng.random() < 0.5:
            kinds = [schema.get("type"), *(each.get("type") for each in schema.get("anyOf", []))]
            if "integer" in kinds:
                return str(rng.choice((0, 1, 2, 3, 10, 500, 501, 2**53, -5)))
            if "number" in kinds:
                return str(rng.choice((0.0, 0.001, 1.0, 1e9, -1.0)))
            if "enum" in schema:
                return str(rng.choice(schema["enum"]))
            return rng.choice(
                ("press", "bearing", "gate-drive", "oven", "robust-residual", "a-1.b_2")
            )
        return rng.choice(ODD_TEXTS)

    def _body(self, operation: dict[str, Any]) -> tuple[bytes, str]:
        rng = self._rng
        kinds = list(operation.get("requestBody", {}).get("content", {})) or ["application/json"]
        kind = rng.choice(kinds) if rng.random() < 0.85 else rng.choice(TYPES)
        if "json" in kind:
            schema = (
                operation.get("requestBody", {})
                .get("content", {})
                .get("application/json", {})
                .get("schema", {})
            )
            made = rng.random()
            if made < 0.1:
                return json.dumps(GOOD).encode(), kind
            if made < 0.4:
                return rng.choice(self._handmade), kind
            body = json.dumps(self._filled(schema, 0)).encode()
            return body if made < 0.8 else _mutated(body, rng), kind
        content = {
            "text/csv": b"time [s],acceleration [m/s\xc2\xb2]\n0,1\n0.001,2\n0.002,3\n",
            "application/zip": _npz(),
        }.get(kind, _npy())
        return content if rng.random() < 0.3 else _mutated(content, rng), kind

    def _filled(self, schema: dict[str, Any], depth: int) -> Any:
        """Something that fits a schema here and there."""
        rng = self._rng
        if depth > 5 or rng.random() < 0.1:
            return rng.choice((None, 0, -1, 1.5, "", "a", [], {}, True, 2**63))
        if "anyOf" in schema:
            return self._filled(rng.choice(schema["anyOf"]), depth + 1)
        kind = schema.get("type")
        if kind == "object" or "properties" in schema:
            named = {
                name: self._filled(each, depth + 1)
                for name, each in schema.get("properties", {}).items()
                if rng.random() < 0.8
            }
            if isinstance(more := schema.get("additionalProperties"), dict):
                named |= {rng.choice(("acceleration", "y", "", "é")): self._filled(more, depth + 1)}
            return named
        if kind == "array":
            return [
                self._filled(schema.get("items", {}), depth + 1)
                for _ in range(rng.choice((0, 1, 2, 5)))
            ]
        if kind in ("number", "integer"):
            return rng.choice((0, 1, -1, 0.001, 1e308, 1e-308, 10**12, 3))
        if kind == "boolean":
            return rng.choice((True, False))
        return rng.choice(ODD_TEXTS)


def _mutated(content: bytes, rng: random.Random) -> bytes:
    changed = bytearray(content)
    for _ in range(rng.choice((1, 2, 8))):
        at = rng.randrange(max(1, len(changed)))
        changed[at : at + rng.choice((0, 1, 4))] = rng.randbytes(rng.choice((0, 1, 4)))
    return bytes(changed)


def _npy() -> bytes:
    file = io.BytesIO()
    np.save(file, np.arange(16.0))
    return file.getvalue()


def _npz() -> bytes:
    file = io.BytesIO()
    np.savez(
        file,
        acceleration=np.arange(16.0),
        sample_time=1e-3,
        units=json.dumps({"acceleration": "m/s²"}),
    )
    return file.getvalue()


def wrong_about(status: int, kind: str, content: bytes, method: str) -> str | None:
    """What is wrong about an answer, None when nothing is."""
    if status >= 500:
        return f"status {status}"
    if status < 400 or method == "HEAD":
        return None
    if kind != "application/problem+json":
        return f"{status} as {kind!r}"
    problem = json.loads(content)
    if (
        problem.get("status") != status
        or not problem.get("title")
        or "\n" in problem.get("detail", "\n")
    ):
        return f"{status}: not a problem of one line: {content[:100]!r}"
    return None


def campaign(cases: int, seed: int = 0) -> dict[str, Any]:
    """Ask, and count what was answered."""
    with tempfile.TemporaryDirectory() as data:
        document = create_app(load_settings(data=Path(data), workers=1)).openapi()
        port = free_port()
        process = multiprocessing.get_context("spawn").Process(target=serve, args=(data, "", port))
        process.start()
        try:
            _wait(port)
            return _ask(port, int(process.pid or 0), document, cases, random.Random(seed))
        finally:
            process.kill()
            process.join()


def _ask(
    port: int, pid: int, document: dict[str, Any], cases: int, rng: random.Random
) -> dict[str, Any]:
    draw, statuses, wrong = Cases(document, rng), Counter[int](), Counter[str]()
    by_hand = [
        ("POST", "/api/v1/score/bearing", {"Content-Type": "application/json"}, body)
        for body in handmade()
    ]
    connection = HTTPConnection("127.0.0.1", port, timeout=60)
    grown: list[int] = []
    for number in range(cases + len(by_hand)):
        method, target, headers, body = by_hand[number] if number < len(by_hand) else draw()
        try:
            connection.request(method, target, body, headers)
            answer = connection.getresponse()
            content = answer.read()
        except (OSError, HTTPException) as error:
            wrong[f"no answer: {type(error).__name__}"] += 1
            sys.stderr.write(f"{method} {target} {headers} {body!r:.200}: {error!r}\n")
            connection.close()
            continue
        statuses[answer.status] += 1
        if says := wrong_about(
            answer.status, answer.headers.get("content-type", ""), content, method
        ):
            wrong[says] += 1
            sys.stderr.write(f"{method} {target} {headers} {body!r:.300}: {says}\n")
        if number % 1000 == 999:
            grown.append(_resident(pid))
    return {
        "cases": cases,
        "bodies by hand": len(set(handmade())),
        "operations": len(draw._operations),
        "answers": dict(sorted(statuses.items())),
        "wrong": dict(wrong),
        "MiB after 1000, and at the end": [grown[0], grown[-1]] if grown else [],
    }


def _resident(pid: int) -> int:
    fields = Path(f"/proc/{pid}/statm").read_text().split()
    return int(fields[1]) * 4096 >> 20


def _wait(port: int) -> None:
    end = time.monotonic() + 600
    while time.monotonic() < end:
        with socket.socket() as attempt:
            if attempt.connect_ex(("127.0.0.1", port)) == 0:
                return
        time.sleep(0.1)
    raise RuntimeError("the service did not start")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cases", type=int, default=20_000)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    found = campaign(given.cases, given.seed)
    for what, figure in found.items():
        print(f"{what:<32}{figure}")
    if found["wrong"]:
        sys.exit(1)


if __name__ == "__main__":
    main()
