"""Receivers that are told by HTTP: how a body is posted, and what an answer means."""

from __future__ import annotations

import http.client
import socket
import urllib.request
from abc import abstractmethod
from collections.abc import Callable, Mapping
from email.message import Message
from pathlib import Path
from typing import Annotated, Any
from urllib.error import HTTPError
from urllib.parse import SplitResult, urlsplit

import orjson
from pydantic import AfterValidator, Field, SecretStr, model_validator

from residuum.identification.errors import BadInput
from residuum.service.broker import BrokerTls
from residuum.service.receivers.receiver_settings import (
    PATIENCE,
    ReceiverSettings,
    Refused,
    Send,
)
from residuum.service.secret_texts import secret_of, without

LATER = (408, 425, 429)
"""Statuses of 400 to 499 that ask for patience, and refuse nothing: timeout, too early, too many."""
PROBLEM = "application/problem+json"
"""Content type of a refusal by RFC 9457."""
# Characters of an answer that a refusal tells, and bytes of one that are read.
_TOLD, _READ = 200, 2**20


class NoReceipt(ConnectionError):
    """An answer that is no receipt now, and may be one later; `status` is its own, None where there
    was no answer.
    """

    def __init__(self, reason: str, status: int | None = None) -> None:
        super().__init__(reason)
        self.status = status


class _NoDetour(urllib.request.HTTPRedirectHandler):
    """Follows nobody elsewhere: a notification would be asked for there, without its body, and the
    answer taken for a receipt.
    """

    def redirect_request(self, *_asked: Any, **_named: Any) -> None:
        """Nowhere: the answer becomes an HTTPError, as every other that is no receipt."""


def _web_address(value: SecretStr) -> SecretStr:
    _parts(value.get_secret_value())
    return value


def _parts(url: str) -> SplitResult:
    """The parts of a receiver's address; ValueError, without the address, where it is none."""
    try:
        parts = urlsplit(url)
        known = parts.scheme in ("http", "https") and parts.hostname and parts.port != 0
    except ValueError:
        known = False
    # a user would be a secret in the log of a proxy, and urllib does not send it
    if not known or parts.username or not url.isascii() or any(sign <= " " for sign in url):
        raise ValueError("must be https://host[:port]/path, without a user, or http://")
    return parts


SecretUrl = Annotated[SecretStr, AfterValidator(_web_address)]
"""An address whose path is its secret."""


class HttpReceiver(ReceiverSettings):
    """A receiver at an address, which is its secret in many cases."""

    url: SecretUrl | None = Field(None, description="Its address; is shown nowhere.")
    url_file: Path | None = Field(
        None, description="File whose first line is its address, instead of `url`."
    )
    ca: Path | None = Field(
        None,
        description=("PEM file of the authority that signed its certificate; empty: the system's."),
    )

    @model_validator(mode="after")
    def _one_address(self) -> HttpReceiver:
        if (self.url is None) == (self.url_file is None):
            raise ValueError("has one address; write url: or url_file:")
        return self

    @property
    def place(self) -> str:
        """Scheme and host: the path of many is their secret."""
        try:
            parts = _parts(self._url())
        except (BadInput, ValueError):  # told when it is opened
            return str(self.url_file)
        return f"{parts.scheme}://{parts.hostname}"

    def address(self) -> str:
        """Kind and URL."""
        return f"{self.kind} {self._url()}"

    def try_connection(self) -> str:
        """Whether host and certificate are right; nothing is posted."""
        parts = _parts(self._url())
        port = parts.port or (443 if parts.scheme == "https" else 80)
        with socket.create_connection((str(parts.hostname), port), PATIENCE) as plain:
            if parts.scheme == "https":
                context = BrokerTls(ca=self.ca).context()
                context.wrap_socket(plain, server_hostname=parts.hostname).close()
        return f"{parts.hostname}:{port} accepts connections; nothing was posted"

    def opened(self, public_url: str | None) -> Send:
        """Posts what the kind makes of a notice."""
        post = self._post()

        def send(kind: str, payload: Mapping[str, Any]) -> None:
            post(self.body(kind, payload, public_url), {})

        return send

    @abstractmethod
    def body(self, kind: str, payload: Mapping[str, Any], public_url: str | None) -> Any:
        """The JSON that this kind of receiver takes."""

    def _url(self) -> str:
        url = secret_of(self.url, self.url_file, "receivers, url_file") or ""
        try:
            _parts(url)
        except ValueError as error:
            raise BadInput(f"setting receivers, url_file: {self.url_file}: {error}") from None
        return url

    def _post(self, *told: str | None) -> Poster:
        """What posts bodies to the address; `told` are secrets of its own that an answer may repeat."""
        url = self._url()
        parts = urlsplit(url)
        # what an answer may repeat of the address
        secrets = (url, parts.path if len(parts.path) > 1 else None, parts.query, *told)
        return Poster(url, self.ca, secrets)


def _for_good(status: int, _head: Message) -> bool:
    """Whether an answer says that the request itself is wrong."""
    return 400 <= status < 500 and status not in LATER


class Poster:
    """Posts JSON to one address.

    Parameters
    ----------
    url : str
    ca : Path or None
        PEM file of the authority that signed its certificate; None: those of the system.
    secrets : of str or None
        What no reason may tell.
    patience : float
        Seconds for an answer.
    for_good : callable
        Whether an answer's status and head refuse the request for good.
    """

    def __init__(
        self,
        url: str,
        ca: Path | None,
        secrets: tuple[str | None, ...],
        patience: float = PATIENCE,
        for_good: Callable[[int, Message], bool] = _for_good,
    ) -> None:
        self.url = url
        self._secrets, self._patience, self._for_good = secrets, patience, for_good
        handlers: list[Any] = [_NoDetour, urllib.request.HTTPCookieProcessor]
        if url.startswith("https:") and ca is not None:
            handlers.append(urllib.request.HTTPSHandler(context=BrokerTls(ca=ca).context()))
        self._opener = urllib.request.build_opener(*handlers)

    def __call__(self, body: Any, headers: Mapping[str, str]) -> bytes:
        """Post a body, JSON of a value unless it is bytes; any 2xx answer is a receipt.

        Raises Refused for a status that says that the request itself is wrong, NoReceipt for every
        other that is no receipt.
        """
        if not isinstance(body, bytes):
            body = orjson.dumps(body, option=orjson.OPT_SERIALIZE_NUMPY)
        return self.ask(body, {"Content-Type": "application/json", **headers})[0]

    def ask(
        self, body: bytes | None, headers: Mapping[str, str], url: str | None = None
    ) -> tuple[bytes, http.client.HTTPMessage]:
        """Body and head of the answer to a POST, without a body to a GET, at the address or another
        of the same server; raises as a call does.
        """
        told = {"User-Agent": "residuum", **headers}
        try:
            # the scheme was compared when the settings were read
            request = urllib.request.Request(url or self.url, body, told)
            with self._opener.open(request, timeout=self._patience) as answer:
                return answer.read(_READ), answer.headers
        except HTTPError as error:
            with error:
                says = without(_text(error), *self._secrets)[:_TOLD]
            reason = f"status {error.code}" + (f": {says}" if says else "")
            if self._for_good(error.code, error.headers):
                raise Refused(reason) from None  # it will not like it better the next time
            raise NoReceipt(reason, error.code) from None
        except (http.client.HTTPException, OSError) as error:
            reason = str(getattr(error, "reason", error))
            raise NoReceipt(without(reason, *self._secrets)) from None


def csrf_token(post: Poster, head: Mapping[str, str]) -> dict[str, str]:
    """The header without which SAP's OData services refuse a POST, asked of the service's root with
    its cookies; none where the answer has none.
    """
    parts = urlsplit(post.url)
    root = parts._replace(path=parts.path.rpartition("/")[0] + "/").geturl()
    fetch = {"X-CSRF-Token": "Fetch", "Accept": "application/json", **head}
    token = post.ask(None, fetch, root)[1].get("X-CSRF-Token")
    return {} if token is None else {"X-CSRF-Token": token}


def _text(error: HTTPError) -> str:
    """What an answer says: of a problem document (RFC 9457) its one line for people."""
    try:
        if error.headers.get_content_type() == PROBLEM:
            return str(orjson.loads(error.read(_READ))["detail"])
        return error.read(4 * _TOLD).decode("utf-8", "replace")
    except (http.client.HTTPException, OSError, ValueError, LookupError, TypeError):
        return ""
