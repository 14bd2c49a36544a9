"""E-mail: a message a change of an alarm, by an SMTP server."""

from __future__ import annotations

import hashlib
import ipaddress
import re
import smtplib
import socket
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from email.message import EmailMessage
from email.utils import formatdate
from pathlib import Path
from typing import Annotated, Any, Literal

import orjson
from pydantic import AfterValidator, Field, SecretStr, model_validator

from residuum.service.broker import BrokerTls
from residuum.service.receivers.alarm_text import alarm_text
from residuum.service.receivers.receiver_settings import (
    PATIENCE,
    ReceiverSettings,
    Refused,
    Send,
)
from residuum.service.secret_texts import secret_of, without

# The ports registered for submission by STARTTLS and by TLS, and for SMTP.
_PORTS = {"starttls": 587, "tls": 465, "none": 25}
# [s] For all commands of one message: less than a receiver is held by the process that tells it.
_LONGEST = 15.0
# Replies of 500 and above refuse for good, those below for now (RFC 5321, 4.2.1).
_FOR_GOOD = 500

# Of an address without a name: nothing that ends a line or begins another address.
_ADDRESS = re.compile(r"[A-Za-z0-9.!#$%&'*+/=?^_`{|}~-]+@[A-Za-z0-9.\[\]:-]+")


def _address(value: str) -> str:
    if not _ADDRESS.fullmatch(value):
        raise ValueError("must be an address, as maintenance@plant.example")
    return value


MailAddress = Annotated[str, Field(max_length=254), AfterValidator(_address)]


class Email(ReceiverSettings):
    """People who are told by e-mail, through an SMTP server."""

    kind: Literal["email"]
    host: str = Field(
        min_length=1, max_length=253, pattern=r"^[!-~]+$", description="Name of the SMTP server."
    )
    port: int | None = Field(
        None,
        ge=1,
        le=65535,
        description="Its port; empty: 587 with starttls, 465 with tls, 25 with none.",
    )
    security: Literal["starttls", "tls", "none"] = Field(
        "starttls",
        description=(
            "How it is entered: starttls, tls from the first byte, none. A server that offers no"
            " STARTTLS is told nothing with starttls."
        ),
    )
    ca: Path | None = Field(
        None,
        description=("PEM file of the authority that signed its certificate; empty: the system's."),
    )
    user: str | None = Field(None, description="Who logs in; empty: nobody does.")
    password: SecretStr | None = Field(None, description="The user's password.")
    password_file: Path | None = Field(
        None, description="File whose first line is the user's password."
    )
    sender: MailAddress = Field(alias="from", description="Address that the message is from.")
    to: list[MailAddress] = Field(
        min_length=1, max_length=100, description="Addresses that are told."
    )

    @model_validator(mode="after")
    def _who_enters(self) -> Email:
        if (self.user is None) != (self.password is None and self.password_file is None):
            raise ValueError("user and password, or password_file: one of them is not enough")
        if self.user is not None and self.security == "none" and not _is_here(self.host):
            raise ValueError("security none: a password would be sent readable; write starttls")
        return self

    @property
    def place(self) -> str:
        """The server."""
        return self.host

    def address(self) -> str:
        """Server, sender and who is told; not by whom the server is entered."""
        return f"email {self.host}:{self._port} {self.sender} {' '.join(sorted(self.to))}"

    def opened(self, public_url: str | None) -> Send:
        """Sends a message a notice."""
        password = self._password()
        # of the notice that is under way: who has it already gets it no second time
        left: dict[str, Sequence[str]] = {}

        def send(kind: str, payload: Mapping[str, Any]) -> None:
            message = self.message(kind, payload, public_url)
            number = str(message["Message-ID"])
            to = left.get(number, self.to)
            left.clear()
            later, refused = self._sent(message, to, password)
            if later:
                left[number] = list(later)
                raise ConnectionError(_told(later))
            if refused:
                raise Refused(_told(refused))

        return send

    def message(
        self, kind: str, payload: Mapping[str, Any], public_url: str | None
    ) -> EmailMessage:
        """The message of a notice; one that is sent again has the same Message-ID."""
        text = alarm_text(kind, payload, public_url)
        digest = hashlib.sha256(orjson.dumps([kind, payload], default=str)).hexdigest()[:24]
        message = EmailMessage()
        message["Subject"] = " ".join(text.title.split())
        message["From"], message["To"] = self.sender, ", ".join(self.to)
        message["Date"] = formatdate()
        message["Message-ID"] = f"<{digest}@residuum>"
        message["Auto-Submitted"] = "auto-generated"  # RFC 3834: nobody's absence answers it
        # lines of ASCII, also for servers without 8BITMIME
        message.set_content(text.plain, cte="quoted-printable")
        return message

    def try_connection(self) -> str:
        """Whether it lets us in; no message is sent."""
        who = "anybody" if self.user is None else self.user
        try:
            with self._session(self._password()):
                return f"{self.host}:{self._port} lets {who} in ({self.security}); nothing was sent"
        except Refused as error:
            raise ConnectionError(str(error)) from None

    @property
    def _port(self) -> int:
        return self.port or _PORTS[self.security]

    def _password(self) -> str | None:
        return secret_of(self.password, self.password_file, "receivers, password_file")

    def _sent(
        self, message: EmailMessage, to: Sequence[str], password: str | None
    ) -> tuple[dict[str, str], dict[str, str]]:
        """Who is to be told later, and who never can be, each with the server's words."""
        with self._session(password) as server:
            try:
                answers = server.send_message(message, self.sender, list(to))
            except smtplib.SMTPRecipientsRefused as error:
                answers = error.recipients
        told = {who: (code, _words(code, says, password)) for who, (code, says) in answers.items()}
        later = {who: says for who, (code, says) in told.items() if code < _FOR_GOOD}
        return later, {who: says for who, (_, says) in told.items() if who not in later}

    @contextmanager
    def _session(self, password: str | None) -> Iterator[smtplib.SMTP]:
        """A session that is secured and logged in; Refused where the server says never, OSError
        where it says not now.
        """
        # our name as it is: to look a full one up may take seconds
        options: dict[str, Any] = {"local_hostname": socket.gethostname(), "timeout": PATIENCE}
        context = None if self.security == "none" else BrokerTls(ca=self.ca).context()
        try:
            with ExitStack() as ends:
                server: smtplib.SMTP
                if self.security == "tls":
                    server = _TlsSession(self.host, self._port, context=context, **options)
                else:
                    server = _Session(self.host, self._port, **options)
                ends.callback(server.close)
                if self.security == "starttls":
                    server.starttls(context=context)
                if self.user is not None and password is not None:
                    server.login(self.user, password)
                yield server
                # whatever is said to it: the message is the server's already
                with suppress(OSError):
                    server.quit()
        except smtplib.SMTPResponseException as error:
            words = _words(error.smtp_code, error.smtp_error, password)
            if error.smtp_code >= _FOR_GOOD:
                raise Refused(words) from None
            raise ConnectionError(words) from None


class _Session(smtplib.SMTP):
    """A session whose replies are waited for together no longer than one message may take."""

    _until = 0.0

    def getreply(self) -> tuple[int, bytes]:
        """The next reply."""
        if self.sock is not None:
            self._until = self._until or time.monotonic() + _LONGEST
            left = self._until - time.monotonic()
            if left <= 0:
                raise TimeoutError(f"the server took more than {_LONGEST:g} s")
            self.sock.settimeout(min(PATIENCE, left))
        return super().getreply()


class _TlsSession(_Session, smtplib.SMTP_SSL):
    """The same by TLS from the first byte."""


def _words(code: int, says: Any, password: str | None) -> str:
    text = says.decode("utf-8", "replace") if isinstance(says, bytes) else str(says)
    return f"{code} {without(text, password)[:200]}"


def _told(answers: Mapping[str, str]) -> str:
    return "; ".join(f"{who}: {says}" for who, says in answers.items())


def _is_here(host: str) -> bool:
    try:
        return host == "localhost" or ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False
