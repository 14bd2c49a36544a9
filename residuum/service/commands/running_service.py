"""Asking a running service over HTTP, from a command."""

from __future__ import annotations

import json
import os
import urllib.error
import urllib.request
from typing import Annotated, Any

import typer

from residuum.identification.errors import BadInput

# Seconds in which the service must answer. Longer than a list waits for room in memory (20 s), so
# that its 503 is told and no timeout.
_TIMEOUT = 30.0
# From the environment: an option would show the key to everybody who lists processes.
_KEY = "RESIDUUM_API_KEY"

_URL_HELP = "Address of the running service; RESIDUUM_URL in the environment says it, too."
ServiceUrl = Annotated[
    str, typer.Option("--url", envvar="RESIDUUM_URL", show_envvar=False, help=_URL_HELP)
]
HERE = "http://127.0.0.1:8000"


def ask(
    url: str, address: str, body: dict[str, Any] | None = None, method: str | None = None
) -> dict[str, Any]:
    """The answer of the service at `url` to a request under /api/v1; its refusal becomes BadInput
    with its one line.

    A key, where the service asks for one, is taken from the environment variable RESIDUUM_API_KEY.
    """
    content = answered(url, address, None if body is None else json.dumps(body).encode(), method)
    answer: dict[str, Any] = json.loads(content or b"{}")
    return answer


def answered(url: str, address: str, body: bytes | None = None, method: str | None = None) -> bytes:
    """The bytes that the service answers."""
    if not url.startswith(("http://", "https://")):
        raise BadInput(f"--url {url!r}: must begin with http:// or https://")
    whole = f"{url.rstrip('/')}/api/v1{address}"
    headers = {"Content-Type": "application/json"}
    if key := os.environ.get(_KEY):
        headers["X-API-Key"] = key
    request = urllib.request.Request(whole, data=body, headers=headers, method=method)
    try:
        with urllib.request.urlopen(request, timeout=_TIMEOUT) as answer:
            content: bytes = answer.read()
            return content
    except urllib.error.HTTPError as error:
        raise BadInput(_problem(error)) from None
    except (OSError, ValueError) as error:
        raise BadInput(
            f"--url: no running service answers at {url}: {getattr(error, 'reason', error)}"
        ) from None


def _problem(error: urllib.error.HTTPError) -> str:
    try:
        # A problem document (RFC 9457) says in `detail` what a person reads.
        return str(json.load(error).get("detail") or error.reason)
    except ValueError:
        return f"the service answered {error.code} {error.reason}"
