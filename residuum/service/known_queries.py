"""A query key that a route does not know is refused: passed over, it would leave an answer to
another question than was asked.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from functools import cached_property, lru_cache
from typing import Any
from urllib.parse import parse_qsl

from starlette.routing import compile_path
from starlette.types import ASGIApp, Receive, Scope, Send

from residuum.nearest_names import known_names
from residuum.service.problems import problem

# Bytes of a query up to which it is remembered that it is good: clients ask with the same one again
# and again.
_REMEMBERED = 1000


class KnownQueries:
    """Refuses keys that the interface's own document does not name for a route; pages and what is
    undocumented pass.

    Parameters
    ----------
    app : ASGI app
        What answers the requests that pass.
    document : callable
        Gives the OpenAPI document, whose parameters are the known keys.
    """

    def __init__(self, app: ASGIApp, document: Callable[[], Mapping[str, Any]]) -> None:
        self.app = app
        self.document = document
        self._good = lru_cache(maxsize=256)(self._refusal)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request, or refuse it."""
        query = scope.get("query_string")
        if scope["type"] == "http" and query:
            # long queries are seldom asked twice, and would fill the memory of those that are
            look = self._good if len(query) <= _REMEMBERED else self._refusal
            refusal = look(scope["method"], scope["path"], query)
            if refusal is not None:
                return await problem(400, refusal, "unknown-query")(scope, receive, send)
        await self.app(scope, receive, send)

    def _refusal(self, method: str, path: str, query: bytes) -> str | None:
        # None: pages, and routes that the document does not have, which refuse by themselves
        known = self._known(method, path)
        if known is None:
            return None
        keys = [key for key, _ in parse_qsl(query.decode("latin-1"), keep_blank_values=True)]
        unknown = next((key for key in keys if key not in known), None)
        return None if unknown is None else _says(unknown, known)

    def _known(self, method: str, path: str) -> list[str] | None:
        """The keys of the route that answers, in the order of the document; None for a route that
        it does not have.
        """
        asked = "GET" if method == "HEAD" else method
        return next(
            (
                keys[asked]
                for pattern, keys in self._routes
                if asked in keys and pattern.match(path)
            ),
            None,
        )

    @cached_property
    def _routes(self) -> list[tuple[re.Pattern[str], dict[str, list[str]]]]:
        return [
            (compile_path(path)[0], _keys(methods))
            for path, methods in self.document()["paths"].items()
        ]


def _keys(methods: Mapping[str, Any]) -> dict[str, list[str]]:
    return {
        method.upper(): [
            parameter["name"]
            for parameter in operation.get("parameters", [])
            if parameter["in"] == "query"
        ]
        for method, operation in methods.items()
    }


def _says(key: str, known: list[str]) -> str:
    if not known:
        return f"query {key[:60]!r}: this route takes no query"
    return f"query {key[:60]!r}: is not known here; {known_names(key, known)}"
