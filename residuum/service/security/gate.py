"""The gate every request passes: id, size of head and body, host, origin, rate, key and role,
security headers, log, metrics.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
import re
import time
from collections import OrderedDict
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any
from urllib.parse import parse_qs, urlsplit

import structlog
from starlette.exceptions import HTTPException
from starlette.responses import Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from residuum.service.logs import begin_request
from residuum.service.problems import problem
from residuum.service.security.access import ANYBODY, ApiKeys, Caller, Role
from residuum.service.security.bearer_tokens import BearerTokens
from residuum.service.security.forwarded import TrustedProxies, origin_of
from residuum.service.security.http_connections import KNOWN
from residuum.service.security.refusals import Refusals
from residuum.service.settings import Settings, is_loopback

# Token buckets: how many requests a client may make, in the long run and at once.

# Buckets kept; beyond, the client that was silent for longest is forgotten, which fills its bucket.
_MOST_CLIENTS = 10_000


@dataclass
class _Bucket:
    tokens: float
    at: float


class RateLimit:
    """One bucket a client: it holds `burst` tokens, `rate` come in a second, a request takes one.

    Parameters
    ----------
    rate : float
        Requests a second [1/s] in the long run.
    burst : float
        Requests at once.
    clock : callable
        Seconds, never running backwards.

    Examples
    --------
    >>> limit = RateLimit(rate=2.0, burst=1.0, clock=iter([0.0, 0.0, 0.5]).__next__)
    >>> limit.wait("a"), limit.wait("a"), limit.wait("a")
    (0.0, 0.5, 0.0)
    """

    def __init__(self, rate: float, burst: float, clock: Callable[[], float]) -> None:
        self._rate = rate
        self._burst = burst
        self._clock = clock
        self._buckets: OrderedDict[str, _Bucket] = OrderedDict()

    def wait(self, client: str) -> float:
        """Seconds until the client's next request would be taken: 0 when this one is, and then it
        is counted.
        """
        now = self._clock()
        # put in anew: the buckets stand in the order in which clients were last heard
        bucket = self._buckets.pop(client, None) or _Bucket(self._burst, now)
        self._buckets[client] = bucket
        if len(self._buckets) > _MOST_CLIENTS:
            self._buckets.popitem(last=False)
        bucket.tokens = min(self._burst, bucket.tokens + (now - bucket.at) * self._rate)
        bucket.at = now
        if bucket.tokens >= 1.0:
            bucket.tokens -= 1.0
            return 0.0
        return (1.0 - bucket.tokens) / self._rate


def retry_after(seconds: float) -> dict[str, str]:
    """The header that says when to come again: whole seconds, rounded up."""
    return {"Retry-After": str(max(1, math.ceil(seconds)))}


log = structlog.get_logger()

Measure = Callable[[str, str, int, float], None]
"""Told of every answer: (method, route, status, seconds)."""

# Bytes of an answer that are handed on at once.
_PART = 2**16
# Times the longest body that is taken: so much is read and thrown away before it is refused.
_DRAINED = 4
# Seconds of silence after which no more of a body that is thrown away is waited for.
_PATIENCE = 5.0
# Of a declared length: what is longer is no number of bytes that a disk has.
_MOST_DIGITS = 18
_CLOSE = {"Connection": "close"}  # the rest of the body is not waited for
# Seconds for which a wrong key's refusal is held back at most.
_SLOWEST = 2.0
# Seconds of the allowed rate that a client may ask for at once.
_BURST = 2.0
_HEALTH = frozenset(
    f"{root}/health/{state}" for root in ("", "/api/v1") for state in ("live", "ready")
)
_SAFE = ("GET", "HEAD", "OPTIONS")
_METRICS = ("/metrics", "/api/v1/metrics")
# Paths of what an operator does with an alarm or tells of a finding: the whole path, for an asset
# may be called `acknowledge`, too.
_OPERATORS = re.compile(
    r"/api/v1/(alarms/[^/]+/(acknowledge|reset|shelve|unshelve)"
    r"|assets/[^/]+/findings/[^/]+/confirmations)/?"
)
# The hash is that of an empty style element, which Plotly fills rule by rule through the style
# sheet interface.
_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'"
    " 'sha256-47DEQpj8HBSa+/TImW+5JCeuQeRkm5NMpJWZG3hSuFU='; img-src 'self' data: blob:; font-src"
    " 'self'; connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
_EVERY_ANSWER = [
    (b"x-content-type-options", b"nosniff"),
    (b"cross-origin-resource-policy", b"same-origin"),
]
# A browser that was here by HTTPS comes by nothing else for a year, whatever a link or somebody in
# between says.
_BY_TLS = [(b"strict-transport-security", b"max-age=31536000")]
_DATA = [
    *_EVERY_ANSWER,
    (b"content-security-policy", b"default-src 'none'; frame-ancestors 'none'"),
]
_PAGES = [
    *_EVERY_ANSWER,
    (b"content-security-policy", _POLICY.encode()),
    (b"x-frame-options", b"DENY"),
    (b"referrer-policy", b"no-referrer"),
    (b"cross-origin-opener-policy", b"same-origin"),
    (b"permissions-policy", b"camera=(), microphone=(), geolocation=()"),
]


class Gate:
    """ASGI middleware around the whole app.

    A body over the limit is refused by its declared length, or as soon as what came exceeds the
    limit; of one that is not far over it the rest is taken and thrown away, for its sender looks
    for an answer only then. When the service listens on this machine alone, a request must name it
    as this machine does (a foreign name pointed at 127.0.0.1 is the usual way into a local
    service), and a page of another origin may not write.
    """

    def __init__(
        self,
        app: ASGIApp,
        settings: Settings,
        keys: ApiKeys,
        measure: Measure,
        tokens: BearerTokens | None = None,
        refusals: Refusals | None = None,
    ) -> None:
        self.app = app
        self.settings = settings
        self.keys = keys
        self.tokens = tokens
        self.measure = measure
        self.local = is_loopback(settings.host)
        self.proxies = TrustedProxies(settings.trusted_proxies)
        self.origin = None if settings.public_url is None else origin_of(str(settings.public_url))
        self.name = None if self.origin is None else urlsplit(self.origin).hostname
        self.refusals = refusals or Refusals()
        rate = settings.requests_per_second
        # far fewer wrong keys than requests: whoever has a key shows it right
        self.wrong_keys = (
            None if rate is None else RateLimit(rate / 200.0, max(1.0, rate / 10.0), time.monotonic)
        )
        self.rate_limit = (
            None if rate is None else RateLimit(rate, max(1.0, _BURST * rate), time.monotonic)
        )

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Refuse the request, or hand it on."""
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        begun = time.perf_counter()
        headers = dict(scope["headers"])
        # before anything that asks for the client's address or scheme
        self._look_behind_the_proxy(scope, headers)
        answer = _Answer(send, [begin_request(headers), *_security_headers(scope)])
        # what the request itself shows costs nothing; keys, tokens and rates come after it
        refusal, by = self._refusal(scope, headers), None
        if refusal is None:
            refusal, by = await self._refusal_of_key(scope, headers)
        self._note_refusal(scope, refusal, by)
        try:
            if refusal is not None:
                await refusal(scope, receive, answer.send)
            else:
                await self.app(scope, self._limited(receive, headers), answer.send)
        finally:
            self._tell(scope, answer.status, time.perf_counter() - begun)

    def _note_refusal(self, scope: Scope, refusal: Any, by: str | None) -> None:
        """Log and count what was refused to somebody; a malformed request is nobody's attempt."""
        status = getattr(refusal, "status_code", 0)
        if status in (401, 403):
            reason = "key" if status == 401 else "not allowed"
            self.refusals.note(_address(scope), by, scope["method"], scope["path"], status, reason)

    def _tell(self, scope: Scope, status: int, seconds: float) -> None:
        """Measure an answer, and log it where it is our fault or everything is logged."""
        # set by the router: paths that no route has are one, so that no client makes new series
        route = getattr(scope.get("route"), "path", "other")
        self.measure(scope["method"], route, status, seconds)
        if status >= 500 or self.settings.log_level == "debug":
            note = log.error if status >= 500 else log.debug
            note(
                "request",
                method=scope["method"],
                path=scope["path"],
                status=status,
                seconds=round(seconds, 4),
            )

    def _refusal(self, scope: Scope, headers: dict[bytes, bytes]) -> Any:
        """The answer to a request that may not pass, None for one that may."""
        host = headers.get(b"host", b"").decode("latin-1")
        return (
            self._head_refusal(scope)
            or self._body_refusal(headers)
            or self._host_refusal(host)
            or self._origin_refusal(scope, headers, host)
        )

    def _head_refusal(self, scope: Scope) -> Any:
        size = sum(len(name) + len(value) for name, value in scope["headers"]) + len(scope["path"])
        limit = self.settings.header_limit
        if size <= limit:
            return None
        return problem(431, f"request head: larger than {limit} bytes", "too-large")

    def _body_refusal(self, headers: dict[bytes, bytes]) -> Any:
        """Refuses a body that is too long by its declared length, or not sent as it is."""
        length = headers.get(b"content-length", b"0")
        if not length.isdigit():
            return problem(400, "Content-Length: is not a number", "bad-request")
        # a number of thousands of digits is not even turned into one
        if len(length) > _MOST_DIGITS or int(length) > self.settings.body_limit:
            return self._too_large_a_body(length, asks_first=b"expect" in headers)
        wrapped = _wrapped(headers)
        if wrapped is None:
            return None
        return problem(415, wrapped, "unsupported-body", {"Accept-Encoding": "identity"})

    def _too_large_a_body(self, length: bytes, *, asks_first: bool) -> Any:
        says = f"body: {length.decode()[:20]} bytes; at most {self.settings.body_limit} are taken"
        refusal = problem(413, says, "too-large", _CLOSE)
        most = _DRAINED * self.settings.body_limit
        if asks_first or len(length) > _MOST_DIGITS or int(length) > most:
            return refusal
        return _after_the_body(refusal, most)

    def _host_refusal(self, host: str) -> Any:
        """Refuses a foreign name that was pointed at this machine (DNS rebinding)."""
        name = _host_name(host)
        if not self.local or is_loopback(name) or name.lower() == self.name:
            return None
        says = (
            f"Host {host[:100]!r}: this service answers to its own machine's names only; a"
            " proxy's is set by public_url"
        )
        return problem(421, says, "wrong-host")

    def _origin_refusal(self, scope: Scope, headers: dict[bytes, bytes], host: str) -> Any:
        """Refuses what a page of another site would write; only browsers send an origin."""
        origin = headers.get(b"origin", b"").decode("latin-1")
        if not origin or scope["method"] in _SAFE or self._is_own(origin, scope["scheme"], host):
            return None
        says = f"Origin {origin[:100]!r}: another site's page may not write here"
        return problem(403, says, "wrong-origin")

    async def _refusal_of_key(
        self, scope: Scope, headers: dict[bytes, bytes]
    ) -> tuple[Any, str | None]:
        """The answer to a request whose key may not do this, None where it may; and whose key it
        is, or was.
        """
        key = headers.get(b"x-api-key", b"").decode("latin-1") or _bearer(headers)
        caller = self.keys.caller(key)
        if caller is None and self.tokens is not None:
            caller = await self._owner_of_token(self.tokens, key)
        if caller is not None:
            scope.get(KNOWN, _nothing)()
        by = self.keys.ended(key) if caller is None else caller.name
        refusal = self._refusal_of_caller(scope, key, caller)
        if key and caller is None and refusal is not None:
            refusal = await self._slowed_down(scope, refusal)
        return refusal, by

    def _is_own(self, origin: str, scheme: str, host: str) -> bool:
        """Whether a page of this origin is ours; without a public name the scheme is a proxy's
        matter, and not compared.
        """
        if self.origin is None:
            return urlsplit(origin).netloc == host
        return origin.lower() in (self.origin, f"{scheme}://{host}".lower())

    def _look_behind_the_proxy(self, scope: Scope, headers: dict[bytes, bytes]) -> None:
        """Let the rest of the service see the client of a trusted proxy, and the scheme by which it
        came.
        """
        peer, port = scope.get("client") or ("unknown", 0)
        client = self.proxies.client(
            peer,
            scope["scheme"],
            headers.get(b"x-forwarded-for", b""),
            headers.get(b"x-forwarded-proto", b""),
        )
        scope["client"], scope["scheme"] = (
            (client.address, port if client.address == peer else 0),
            client.scheme,
        )

    async def _owner_of_token(self, tokens: BearerTokens, token: str | None) -> Caller | None:
        """Who has this token of the issuer."""
        if token is None or not tokens.looks_like_one(token):
            return None
        return tokens.known(token) or await asyncio.to_thread(tokens.caller, token)

    async def _slowed_down(self, scope: Scope, refusal: Any) -> Any:
        """The refusal of a key that nobody has; who has shown many such keys of late waits for it,
        and is refused as too many.
        """
        wait = 0.0 if self.wrong_keys is None else self.wrong_keys.wait(_address(scope))
        if not wait:
            return refusal
        await asyncio.sleep(min(wait, _SLOWEST))
        self.refusals.note(
            _address(scope), None, scope["method"], scope["path"], 429, "wrong keys again and again"
        )
        says = (
            f"API key: too many wrong ones from {_address(scope)}; show the right one, or ask for a"
            " new one"
        )
        return problem(429, says, "too-many-wrong-keys", retry_after(wait) | _CLOSE)

    def _refusal_of_caller(self, scope: Scope, key: str | None, caller: Caller | None) -> Any:
        guarded = scope["path"].startswith("/api/") or scope["path"] in _METRICS
        return self._too_often(scope, caller) or (
            self._without_role(scope, key, caller) if guarded else None
        )

    def _too_often(self, scope: Scope, caller: Caller | None) -> Any:
        """A client is the key it shows, or without a known one its address. Health is always
        told.
        """
        if self.rate_limit is None or scope["path"] in _HEALTH:
            return None
        client = _address(scope) if caller is None or caller is ANYBODY else f"key {caller.name}"
        wait = self.rate_limit.wait(client)
        if not wait:
            return None
        rate = self.settings.requests_per_second
        return problem(
            429,
            f"requests: more than {rate:g} a second from {client}",
            "too-many-requests",
            retry_after(wait) | _CLOSE,
        )

    def _without_role(self, scope: Scope, key: str | None, caller: Caller | None) -> Any:
        if caller is None:
            reason = self._why_nobody(key)
            return problem(401, f"API key: {reason}", "no-key", {"WWW-Authenticate": "Bearer"})
        needed = _role_for(scope["method"], scope["path"])
        if caller.role < needed:
            has, needs = caller.role.name.lower(), needed.name.lower()
            return problem(
                403,
                f"API key of {caller.name!r}: role {has} may not do this; it needs the role"
                f" {needs}",
                "role",
            )
        if caller.sites is not None and not _of_sites(scope, caller):
            sites = ", ".join(sorted(caller.sites))
            return problem(
                403, f"API key of {caller.name!r}: is limited to machines of {sites}", "site"
            )
        scope.setdefault("state", {})["caller"] = caller
        return None

    def _why_nobody(self, key: str | None) -> str:
        """What is wrong with a key that is nobody's."""
        ended = self.keys.ended(key)
        if ended:
            return f"of {ended!r} has ended"
        if key:
            return "is not known"
        return "is needed: send it as 'Authorization: Bearer …' or 'X-API-Key: …'"

    def _limited(self, receive: Receive, headers: dict[bytes, bytes]) -> Receive:
        """`receive` that ends the request when more comes than may (a declared length has been
        checked already).
        """
        # without a declared length, bytes are counted as they come
        if b"transfer-encoding" not in headers:
            return receive
        taken = 0

        async def limited() -> Message:
            nonlocal taken
            message = await receive()
            taken += len(message.get("body", b""))
            if taken > self.settings.body_limit:
                if message.get("more_body"):
                    await _throw_away(receive, _DRAINED * self.settings.body_limit - taken)
                raise HTTPException(
                    413,
                    f"body: more than {self.settings.body_limit} bytes came; no more are taken",
                    _CLOSE,
                )
            return message

        return limited


class _Answer:
    """What goes out to one request: with these headers, where it has none of its own of that name,
    and in parts. Its `status` is 500 until it begins: an app that raises before has not answered.
    """

    def __init__(self, send: Send, headers: list[tuple[bytes, bytes]]) -> None:
        self._send, self._headers = send, headers
        self.status = 500

    async def send(self, message: Message) -> None:
        """Hand a message of the app on."""
        if message["type"] == "http.response.start":
            self.status = message["status"]
            own = {name.lower() for name, _ in message["headers"]}
            more = (header for header in self._headers if header[0] not in own)
            message["headers"] = [*message["headers"], *more]
        for part in _in_parts(message):
            await self._send(part)
            if part.get("more_body"):
                # others have their turn, and a connection that was lost is noticed
                await asyncio.sleep(0)


def _security_headers(scope: Scope) -> list[tuple[bytes, bytes]]:
    headers = _DATA if scope["path"].startswith("/api/") else _PAGES
    return [*headers, *_BY_TLS] if scope["scheme"] == "https" else headers


def _nothing() -> None:
    """What is done where nobody counts connections."""


def _in_parts(message: Message) -> Iterator[Message]:
    """A long body in parts, of which the next is made when the client has taken the one before:
    else it waits in memory whole.
    """
    body = memoryview(message.get("body", b""))  # what is left of bytes would be copied each time
    while len(body) > _PART:
        yield {"type": message["type"], "body": bytes(body[:_PART]), "more_body": True}
        body = body[_PART:]
    yield {**message, "body": bytes(body)} if "body" in message else message


def _after_the_body(refusal: Response, most: int) -> ASGIApp:
    """A refusal that is sent when all of the body has come, and was thrown away.

    Most clients send everything before they look for an answer; a connection that is closed in the
    middle resets theirs, and the answer is lost. One that asks first (`Expect: 100-continue`), or
    announces far too much, is answered at once.
    """

    async def answer(scope: Scope, receive: Receive, send: Send) -> None:
        await _throw_away(receive, most)
        await refusal(scope, receive, send)

    return answer


async def _throw_away(receive: Receive, most: int) -> None:
    """Take what is left of a body, at most so many bytes, and as long as it keeps coming."""
    with contextlib.suppress(TimeoutError):
        more = True
        while more and most > 0:
            message = await asyncio.wait_for(receive(), _PATIENCE)
            most -= len(message.get("body", b""))
            more = message.get("more_body", False)


def _wrapped(headers: dict[bytes, bytes]) -> str | None:
    """Why a body that is compressed or part of a message cannot be read; None for one that is sent
    as it is.
    """
    encoding = headers.get(b"content-encoding", b"").decode("latin-1").strip()
    if encoding.lower() not in ("", "identity"):
        return (
            f"Content-Encoding {encoding[:60]!r}: bodies are read as they are; send it"
            " uncompressed, without this header"
        )
    kind = headers.get(b"content-type", b"").decode("latin-1").strip().lower()
    if kind.startswith("multipart/"):
        shown = kind.split(";")[0][:60]
        return (
            f"Content-Type {shown!r}: send the file's bytes themselves as the body (curl"
            " --data-binary @FILE), not as a form"
        )
    return None


def _address(scope: Scope) -> str:
    """The client's address, behind trusted proxies too."""
    return str((scope.get("client") or ("unknown", 0))[0])


def _host_name(host: str) -> str:
    """The name in a Host header, without port and brackets."""
    return (
        host[1:].split("]", maxsplit=1)[0]
        if host.startswith("[")
        else host.split(":", maxsplit=1)[0]
    )


def _bearer(headers: dict[bytes, bytes]) -> str | None:
    scheme, _, key = headers.get(b"authorization", b"").decode("latin-1").partition(" ")
    return key.strip() if scheme.lower() == "bearer" and key else None


def _role_for(method: str, path: str) -> Role:
    """Metrics and health ask for a monitor, reading for a viewer, handling an alarm or telling
    what was found for an operator, all else for an engineer.
    """
    if method in _SAFE:
        return Role.MONITOR if path in _METRICS or path in _HEALTH else Role.VIEWER
    return Role.OPERATOR if method == "POST" and _OPERATORS.fullmatch(path) else Role.ENGINEER


# First words of the paths that a caller of some sites may use; what they list is cut down to the
# sites by the routes.
_FOR_EVERY_SITE = (
    "score",
    "diagnosers",
    "effects",
    "alarms",
    "confirmations",
    "health",
    "events",
    "status",
    "sources",
)


def _of_sites(scope: Scope, caller: Caller) -> bool:
    """Whether a path is one that a caller of some sites may use: its own assets, their alarms, and
    what is nobody's.
    """
    # after "", "api", "v1"; nothing is left of /metrics, which tells of the whole plant
    words = scope["path"].split("/")[3:]
    query = parse_qs(scope["query_string"].decode("latin-1"))
    if not all(caller.may_see(name) for name in query.get("baseline", [])):
        return False
    if words[:1] == ["assets"]:
        return len(words) == 1 or caller.may_see(words[1])
    return words[:1] != [] and words[0] in _FOR_EVERY_SITE and words != ["alarms", "rates"]
