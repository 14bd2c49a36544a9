"""Addresses of brokers, and passwords that no log shows."""

from __future__ import annotations

import importlib
import queue
import re
import ssl
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import SplitResult, urlsplit

from pydantic import BaseModel, ConfigDict, model_validator

from residuum.identification.errors import BadInput

# Where an MQTT broker is, how it is entered, and what topics begin with.

# The ports registered for MQTT, and for MQTT over TLS.
_PORTS = {"mqtt": 1883, "mqtts": 8883}


class BrokerTls(BaseModel):
    """How a broker is known, and we by it: PEM files of its authority (without one: those of the
    system), and of our certificate and key.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    ca: Path | None = None
    certificate: Path | None = None
    key: Path | None = None

    @model_validator(mode="after")
    def _certificate_and_key(self) -> BrokerTls:
        if (self.certificate is None) != (self.key is None):
            raise ValueError("certificate and key of a client: one of them is not enough")
        return self

    def context(self) -> ssl.SSLContext:
        """What connections are made by; the broker's name is compared. BadInput names a file that
        cannot be used.
        """
        try:
            # The default context compares the name and asks for a chain; an authority of ours takes
            # the place of the system's, so that no public one can vouch for a plant's broker.
            tls = ssl.create_default_context(cafile=self.ca)
        except (OSError, ssl.SSLError) as error:
            raise BadInput(f"{self.ca}: holds no certificate of an authority: {error}") from None
        if self.certificate is not None:
            try:
                tls.load_cert_chain(self.certificate, self.key)
            except (OSError, ssl.SSLError) as error:
                raise BadInput(
                    f"{self.certificate}, {self.key}: are no certificate with its key: {error}"
                ) from None
        return tls


class BrokerAddress(NamedTuple):
    """Where an MQTT broker is, how it is entered, and what topics begin with; `tls` is None for one
    that does not speak it.
    """

    host: str
    port: int
    user: str | None
    password: str | None
    prefix: str
    tls: BrokerTls | None = None

    def client(self, **options: Any) -> Any:
        """A paho client that enters this broker, with more of paho's options; not connected yet.

        Raises BadInput without the library, and for a certificate or key that cannot be used.
        """
        try:
            mqtt: Any = importlib.import_module("paho.mqtt.client")  # optional: the extra `mqtt`
        except ImportError:
            raise BadInput(
                "setting mqtt: needs the extra `mqtt`: pip install 'residuum[mqtt]'"
            ) from None
        # version 2 of paho's callbacks tells why a connection was refused
        client = mqtt.Client(mqtt.CallbackAPIVersion.VERSION2, **options)
        if self.user:
            client.username_pw_set(self.user, self.password)
        if self.tls is not None:
            client.tls_set_context(self.tls.context())
        return client


def broker_address(
    url: str, tls: BrokerTls | None = None, password: str | None = None
) -> BrokerAddress:
    """The parts of `mqtt[s]://[user:password@]host[:port][/prefix]`; ValueError when it is none, or
    has files without TLS.

    >>> broker_address("mqtt://broker/plant-7").port, broker_address("mqtt://broker/plant-7").prefix
    (1883, 'plant-7')
    >>> broker_address("mqtts://broker").port
    8883
    """
    parts = urlsplit(url)
    host = _host_of(url, parts)
    if parts.scheme == "mqtt" and tls is not None and tls != BrokerTls():
        raise ValueError("is not entered by TLS, so certificates say nothing; write mqtts://")
    return BrokerAddress(
        host,
        parts.port or _PORTS[parts.scheme],
        parts.username,
        parts.password if password is None else password,
        parts.path.strip("/") or "residuum",
        (tls or BrokerTls()) if parts.scheme == "mqtts" else None,
    )


def _host_of(url: str, parts: SplitResult) -> str:
    """The host of a broker's address; ValueError for any other."""
    # `#` and `+` are wildcards in topics, which begin with the path
    no_topic = bool(set(url) & set("#?")) or "+" in parts.path
    if parts.scheme not in _PORTS or not parts.hostname or no_topic:
        raise ValueError("must be mqtt://[user:password@]host[:port][/prefix], or mqtts:// for TLS")
    return parts.hostname


# [s] For which an answer of a broker is waited for.
_PATIENCE = 5.0


def connected_client(address: BrokerAddress) -> Any:
    """A client that the broker has let in, in a thread of its own; OSError when it does not."""
    client = address.client()
    answered: queue.Queue[Any] = queue.Queue()
    client.on_connect = lambda _client, _data, _flags, reason, _properties: answered.put(reason)
    try:
        client.connect(address.host, address.port)
        client.loop_start()
        reason = answered.get(timeout=_PATIENCE)
        if reason.is_failure:
            raise ConnectionError(f"the broker refuses the connection: {reason}")
    except queue.Empty:
        client.loop_stop()
        raise ConnectionError("the broker did not take the connection") from None
    except (OSError, ValueError):
        client.loop_stop()
        raise
    return client


def try_connection(address: BrokerAddress) -> None:
    """Connect, as whoever the address names, and leave again; OSError when the broker does not let
    us in.
    """
    try:
        client = connected_client(address)
    except ValueError as error:
        raise ConnectionError(str(error)) from error
    client.disconnect()
    client.loop_stop()


# Addresses as they are shown: without the password of their user info.

# Matched by hand and not parsed: an address that is malformed must hide its password as well.
_USER_INFO = re.compile(r"^([^/]*//)([^/?#]*)@")


def with_hidden_password(address: str) -> str:
    """`scheme://user:***@host…` for an address with a password; any other as it is.

    >>> with_hidden_password("mqtt://eva:secret@broker/plant")
    'mqtt://eva:***@broker/plant'
    """
    user_info = _USER_INFO.match(address)
    if user_info is None or ":" not in user_info[2]:
        return address
    return f"{user_info[1]}{user_info[2].partition(':')[0]}:***@{address[user_info.end() :]}"


def is_hidden(address: str) -> bool:
    """Whether the password of an address is the mark that stands for one."""
    user_info = _USER_INFO.match(address)
    return user_info is not None and user_info[2].partition(":")[2] == "***"
