"""Webhooks: each change of an alarm as JSON, signed where a secret is shared."""

from __future__ import annotations

import base64
import binascii
import hashlib
import hmac
import time
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any, Literal

import orjson
from pydantic import Field, SecretStr, model_validator

from residuum.identification.errors import BadInput
from residuum.service.receivers.http_receiver import HttpReceiver, csrf_token
from residuum.service.receivers.receiver_settings import Send
from residuum.service.receivers.work_orders import (
    OrderTemplate,
    Scalar,
    is_order,
    order_body,
    order_number,
    read_template,
)
from residuum.service.secret_texts import first_line, secret_of

# What a secret of Standard Webhooks begins with; the rest is Base64.
_PREFIX = "whsec_"


class Webhook(HttpReceiver):
    """An address to which every change of an alarm is posted as JSON.

    With `signing_secret` each is signed as Standard Webhooks has it (standardwebhooks.com): headers
    `webhook-id`, `webhook-timestamp` and `webhook-signature`, which is `v1,` and the Base64 of
    HMAC-SHA256 over id, timestamp and body, joined by dots. A notice that is sent again has its id
    of before.
    """

    kind: Literal["webhook"]
    user: str | None = Field(None, description="User of basic authentication; with a password.")
    password: SecretStr | None = Field(None, description="The user's password.")
    password_file: Path | None = Field(
        None, description="File whose first line is the user's password."
    )
    headers: dict[str, SecretStr] = Field(
        {}, max_length=20, description="More headers, as apikey or Authorization; shown nowhere."
    )
    header_files: dict[str, Path] = Field(
        {}, max_length=20, description="More headers, each from the first line of a file."
    )
    template: str | None = Field(
        None,
        description=(
            "Makes a work order of each new fault instead: sap-pm, maximo, or a file of a template."
        ),
    )
    fields: dict[str, Scalar] = Field(
        {},
        max_length=100,
        description="template: constants of its body, as plant, site and type of notification.",
    )
    objects: dict[str, str] = Field(
        {},
        max_length=10_000,
        description="template: machine → its equipment or asset number there; else its own name.",
    )
    signing_secret: SecretStr | None = Field(
        None, description="Shared secret of signatures, whsec_ and Base64, or any text."
    )
    signing_secret_file: Path | None = Field(
        None, description="File whose first line is the shared secret of signatures."
    )

    @model_validator(mode="after")
    def _who_enters(self) -> Webhook:
        if (self.user is None) != (self.password is None and self.password_file is None):
            raise ValueError("user and password, or password_file: one of them is not enough")
        if self.template is None and (self.fields or self.objects):
            raise ValueError("fields and objects: are of a template; write template: sap-pm")
        for name in (*self.headers, *self.header_files):
            if not name.replace("-", "").isalnum() or not name.isascii():
                raise ValueError("headers: a name has letters, digits and - alone")
        return self

    def address(self) -> str:
        """The URL alone, as that of an address in `webhooks`: what waits for it is told on."""
        return self._url()

    def opened(self, public_url: str | None) -> Send:
        """Posts the payload, or the work order of a template, signed."""
        head, key = self._head(), self._key()
        post = self._post(self._password(), *head.values())
        template = None if self.template is None else read_template(self.template)

        def posted(payload: Mapping[str, Any], body: Any, more: Mapping[str, str]) -> bytes:
            text = orjson.dumps(body, option=orjson.OPT_SERIALIZE_NUMPY)
            signature = {} if key is None else signed(key, payload.get("notice"), text)
            return post(text, {**head, **more, **signature})

        def send(kind: str, payload: Mapping[str, Any]) -> None:
            posted(payload, self.body(kind, payload, public_url), {})

        def order(template: OrderTemplate, kind: str, payload: Mapping[str, Any]) -> str | None:
            if not is_order(kind, payload):
                return None
            body = order_body(
                template, payload, public_url=public_url, fields=self.fields, objects=self.objects
            )
            token = csrf_token(post, head) if template.csrf else {}
            more = {"Accept": "application/json", **template.headers, **token}
            return order_number(template, posted(payload, body, more))

        return send if template is None else partial(order, template)

    def body(self, kind: str, payload: Mapping[str, Any], public_url: str | None) -> Any:
        """The payload, with the kind of event."""
        return {"event": kind, **payload}

    def _head(self) -> dict[str, str]:
        """The headers that let us in."""
        head = {name: value.get_secret_value() for name, value in self.headers.items()}
        for name, file in self.header_files.items():
            head[name] = first_line(file, f"receivers, header_files, {name}")
        if self.user is not None:
            pair = base64.b64encode(f"{self.user}:{self._password()}".encode()).decode()
            head["Authorization"] = f"Basic {pair}"
        if any(not value.isascii() or "\n" in value or "\r" in value for value in head.values()):
            raise BadInput("setting receivers, headers: a value is a line of ASCII")
        return head

    def _password(self) -> str | None:
        return secret_of(self.password, self.password_file, "receivers, password_file")

    def _key(self) -> bytes | None:
        secret = secret_of(
            self.signing_secret, self.signing_secret_file, "receivers, signing_secret_file"
        )
        if secret is None:
            return None
        if not secret.startswith(_PREFIX):
            return secret.encode()
        try:
            return base64.b64decode(secret.removeprefix(_PREFIX), validate=True)
        except binascii.Error:
            raise BadInput(
                f"setting receivers, signing_secret: what follows {_PREFIX} is no Base64"
            ) from None


def signed(key: bytes, notice: Any, body: bytes) -> dict[str, str]:
    """The headers of Standard Webhooks for a body; the id is the same each time that a notice is
    sent.
    """
    # with the content: numbers begin anew with another database
    number = f"{notice}-{hashlib.sha256(body).hexdigest()[:16]}"
    now = str(int(time.time()))
    content = b".".join((number.encode(), now.encode(), body))
    signature = base64.b64encode(hmac.digest(key, content, "sha256")).decode()
    return {
        "webhook-id": number,
        "webhook-timestamp": now,
        "webhook-signature": f"v1,{signature}",
    }
