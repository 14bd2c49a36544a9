"""Every route × every role below the one that it asks for × odd names in its path × every field of its body: all refused.

    python -m benchmarks.role_walk

The names are those that mean something elsewhere in an address (`acknowledge`, `health`, `live`): a rule that looks at a part of
a path lets an asset of such a name through. Every text of a body is then sent, by an engineer, as the path of a file of this
computer, which nobody may open. The exit status is 1 when a request passes or the file is opened.
"""

from __future__ import annotations

import json
import os
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from http.client import HTTPConnection
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from benchmarks.durability import serve
from benchmarks.free_port import free_port
from benchmarks.http_cases import _wait
from residuum.service.app import create_app
from residuum.service.security.access import new_key
from residuum.service.settings import load_settings

API = "/api/v1"
ROLES = ("monitor", "viewer", "operator", "engineer", "admin")
VERBS = ("acknowledge", "reset", "shelve", "unshelve")
NAMES = (*VERBS, "live", "ready", "health", "metrics", "alarms", "1")
_MONITOR = {f"{API}/metrics", f"{API}/health/live", f"{API}/health/ready"}
_OPERATOR = {f"{API}/alarms/{{alarm}}/{verb}" for verb in VERBS} | {
    f"{API}/assets/{{asset}}/findings/{{finding}}/confirmations"
}


def needed(method: str, path: str) -> str:
    """The role that a route of the document asks for; written apart from the code."""
    if method == "GET":
        return "monitor" if path in _MONITOR else "viewer"
    return "operator" if path in _OPERATOR and method == "POST" else "engineer"


def routes(document: Mapping[str, Any]) -> list[tuple[str, str, Mapping[str, Any]]]:
    """(method, path with its parameters, schema of the JSON body or nothing) of every operation."""
    known = document.get("components", {}).get("schemas", {})
    found = []
    for path, methods in document["paths"].items():
        for method, operation in methods.items():
            content = (
                operation.get("requestBody", {}).get("content", {}).get("application/json", {})
            )
            found.append(
                (method.upper(), path, _without_references(content.get("schema", {}), known, 0))
            )
    return found


def _without_references(schema: Any, known: Mapping[str, Any], depth: int) -> Any:
    if isinstance(schema, list):
        return [_without_references(each, known, depth) for each in schema]
    if not isinstance(schema, Mapping) or depth > 12:
        return schema
    if "$ref" in schema:
        return _without_references(known[schema["$ref"].rsplit("/", 1)[1]], known, depth + 1)
    return {name: _without_references(each, known, depth + 1) for name, each in schema.items()}


def fields(schema: Mapping[str, Any]) -> list[str]:
    """Names of a body's fields, those of each form that it may have."""
    forms = [schema, *schema.get("anyOf", [])]
    return sorted({name for form in forms for name in form.get("properties", {})})


def named(path: str, name: str) -> str:
    """The path with this name for every parameter."""
    while "{" in path:
        path = path[: path.index("{")] + name + path[path.index("}") + 1 :]
    return path


def below(role: str, all_roles: bool) -> Sequence[str]:
    """The roles that may not do what asks for a role; the highest of them alone, or all."""
    lower = ROLES[: ROLES.index(role)]
    return lower if all_roles else lower[-1:]


def forbidden(
    document: Mapping[str, Any], *, all_roles: bool
) -> Iterator[tuple[str, str, str, bytes | None]]:
    """(role, method, path, body) of requests that must all be refused with 403."""
    for method, path, schema in routes(document):
        for role in below(needed(method, path), all_roles):
            for name in NAMES if "{" in path else NAMES[:1]:
                yield role, method, named(path, name), None
            for field in fields(schema):
                yield role, method, named(path, "1"), json.dumps({field: "acknowledge"}).encode()


def bodies(schema: Mapping[str, Any], text: str) -> Iterator[Any]:
    """Bodies of a schema in which one text after the other is this one; all else is as short and plain as it may be."""
    plain, places = _filled(schema), list(_texts(schema, ()))
    for place in places:
        yield _with(plain, schema, place, text)


def _filled(schema: Mapping[str, Any]) -> Any:
    """Something small that fits a schema."""
    if "default" in schema:
        return schema["default"]
    if "anyOf" in schema:
        return _filled(schema["anyOf"][0])
    if "enum" in schema or "const" in schema:
        return schema.get("const", schema.get("enum", [None])[0])
    kind = schema.get("type")
    if kind == "object" or "properties" in schema:
        wanted = schema.get("required", [])
        return {
            name: _filled(each)
            for name, each in schema.get("properties", {}).items()
            if name in wanted
        }
    if kind == "array":
        return [_filled(schema.get("items", {}))] * schema.get("minItems", 0)
    return {"integer": 1, "number": 1.0, "boolean": False}.get(str(kind), "gate-drive")


def _texts(schema: Mapping[str, Any], place: tuple[str, ...]) -> Iterator[tuple[str, ...]]:
    """Where in a body there may be a text."""
    for each in schema.get("anyOf", []):
        yield from _texts(each, place)
    if schema.get("type") == "string" and "enum" not in schema and "const" not in schema:
        yield place
    for name, each in schema.get("properties", {}).items():
        yield from _texts(each, (*place, name))
    if isinstance(more := schema.get("additionalProperties"), Mapping):
        yield from _texts(more, (*place, "u"))
    if "items" in schema:
        yield from _texts(schema["items"], (*place, "0"))


def _with(plain: Any, schema: Mapping[str, Any], place: tuple[str, ...], text: str) -> Any:
    if not place:
        return text
    for each in schema.get("anyOf", []):
        if place in set(_texts(each, ())):
            return _with(plain, each, place, text)
    name, rest = place[0], place[1:]
    if "items" in schema:
        first = plain[0] if isinstance(plain, list) and plain else _filled(schema["items"])
        return [_with(first, schema["items"], rest, text)]
    inner = schema.get("properties", {}).get(name, schema.get("additionalProperties", {}))
    held = dict(plain) if isinstance(plain, Mapping) else _filled(schema)
    held = dict(held) if isinstance(held, Mapping) else {}
    return held | {name: _with(held.get(name, _filled(inner)), inner, rest, text)}


MACHINE = {
    "diagnoser": "bearing",
    "window": {"cut": "sliding", "length": 1, "step": 1},
    "sources": [{"kind": "modbus", "host": "127.0.0.1", "port": 1, "map": "process_plant.yaml"}],
}
"""A machine that may be added: its texts are sent as paths, too."""


def path_bodies(document: Mapping[str, Any], file: str) -> Iterator[tuple[str, str, bytes]]:
    """(method, path, body) of requests with the path of a file for every text of every body."""
    for method, path, schema in routes(document):
        if path.endswith("/machine") and method == "PUT":
            for more in (
                {"model": file, "diagnoser": "model-based"},
                {"second": {"model": file}},
                {"second": {"baseline": file}},
            ):
                yield method, named(path, "a-machine"), json.dumps(MACHINE | more).encode()
            source = MACHINE["sources"][0] | {"map": file}  # type: ignore[index, operator]
            yield (
                method,
                named(path, "a-machine"),
                json.dumps(MACHINE | {"sources": [source]}).encode(),
            )
        for body in bodies(schema, file):
            yield method, named(path, "1"), json.dumps(body).encode()


def campaign() -> dict[str, Any]:
    """Walk a service in a process of its own; what passed that may not, and the answers by status."""
    with tempfile.TemporaryDirectory() as folder:
        keys = {role: new_key() for role in ROLES}
        file = Path(folder) / "keys"
        file.write_text("\n".join(f"{role} {role} {digest}" for role, (_, digest) in keys.items()))
        document = create_app(load_settings(data=Path(folder) / "document", workers=1)).openapi()
        port = free_port()
        service = get_context("spawn").Process(target=_serve, args=(folder, port))
        service.start()
        try:
            _wait(port)
            statuses, passed = Counter[int](), []
            connection = HTTPConnection("127.0.0.1", port, timeout=60)
            for role, method, path, body in forbidden(document, all_roles=True):
                connection.request(
                    method,
                    path,
                    body,
                    {
                        "X-API-Key": keys[role][0],
                        "Content-Type": "application/json",
                        "Host": "plant.example",
                    },
                )
                answer = connection.getresponse()
                answer.read()
                statuses[answer.status] += 1
                passed += (
                    []
                    if answer.status == 403
                    else [f"{role} {method} {path} {body!r:.60}: {answer.status}"]
                )
            return {"asked": sum(statuses.values()), "answers": dict(statuses), "passed": passed}
        finally:
            service.kill()
            service.join()


def _serve(folder: str, port: int) -> None:
    os.environ |= {
        "RESIDUUM_HOST": "0.0.0.0",
        "RESIDUUM_API_KEYS": f"{folder}/keys",
        "RESIDUUM_RATE_LIMIT": "1e6",
    }
    serve(f"{folder}/data", "", port)


def main() -> None:
    found = campaign()
    for what, figure in found.items():
        print(f"{what:<10}{figure}")
    if found["passed"]:
        sys.exit(1)


if __name__ == "__main__":
    main()
