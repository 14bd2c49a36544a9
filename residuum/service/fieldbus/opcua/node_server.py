"""NodeServer: an OPC UA server of values as nodes, with their own time stamps and status: a
simulated machine's, or findings.
"""

from __future__ import annotations

import logging
import platform
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from asyncua import Server, ua
from asyncua.crypto.cert_gen import setup_self_signed_certificate
from asyncua.crypto.permission_rules import User, UserRole
from cryptography.x509.oid import ExtendedKeyUsageOID

logging.getLogger("asyncua").setLevel(logging.CRITICAL)
NAMESPACE = "urn:residuum:machines"
_APPLICATION = "urn:residuum:findings"
# Priority → severity of an event, 1 … 1000; of an alarm without one that of `medium`.
_SEVERITY = {"high": 800, "medium": 500, "low": 200}
_ASIDE = ("shelved", "suppressed", "out-of-service")
_SECURED = (
    "Basic256Sha256_SignAndEncrypt",
    "Aes128Sha256RsaOaep_SignAndEncrypt",
    "Aes256Sha256RsaPss_SignAndEncrypt",
)


@dataclass(frozen=True)
class Entrance:
    """Who may read: users, over channels that are signed and encrypted.

    Parameters
    ----------
    folder : Path
        Has `server.der`, the server's certificate, and its key; made where they are missing or have
        ended.
    lets_in : callable
        Whether a name and password are those of a user.
    """

    folder: Path
    lets_in: Callable[[str, str], bool]

    def get_user(
        self,
        _server: Any,
        username: str | None = None,
        password: str | None = None,
        certificate: Any = None,
    ) -> Any:
        """A user who reads, or None (asyncua asks for this)."""
        known = username is not None and password is not None and self.lets_in(username, password)
        return User(role=UserRole.User, name=username) if known else None

    async def files(self) -> tuple[Path, Path]:
        """Certificate and key."""
        self.folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        certificate, key = self.folder / "server.der", self.folder / "server.pem"
        names, use = {"organizationName": "Residuum"}, [ExtendedKeyUsageOID.SERVER_AUTH]
        await setup_self_signed_certificate(
            key, certificate, _APPLICATION, platform.node(), use, names
        )
        key.chmod(0o600)
        return certificate, key


class _Anybody:
    """Reads, and nothing else: asyncua itself would let whoever says `admin` write."""

    def get_user(self, *_asked: Any, **_named: Any) -> Any:
        """A user who reads."""
        return User(role=UserRole.User)


class NodeServer:
    """Nodes `ns=2;s=FOLDER.NAME` below a folder each; made when they are first written.

    Parameters
    ----------
    url : str
        `opc.tcp://127.0.0.1:4840/residuum/`.
    entrance : Entrance, optional
        Without one anybody may read, over channels without security.
    """

    def __init__(self, url: str, entrance: Entrance | None = None) -> None:
        self._url, self._entrance = url, entrance
        self._server = Server(user_manager=entrance or _Anybody())
        self._nodes: dict[tuple[str, str], Any] = {}
        self._folders: dict[str, Any] = {}
        self._space = 2
        self._alarms: Any = None

    async def start(self, declared: Mapping[str, Iterable[str]] | None = None) -> None:
        """Begin to serve; `declared` are numbers (folder → names) that clients find at once, not
        good before they are written.
        """
        await self._server.init()
        self._server.set_endpoint(self._url)
        self._server.set_server_name("Residuum")
        if self._entrance is None:
            self._server.set_security_policy([ua.SecurityPolicyType.NoSecurity])
        else:
            await self._secure(self._entrance)
        self._space = await self._server.register_namespace(NAMESPACE)
        for folder, names in (declared or {}).items():
            for name in names:
                await self.write(
                    folder, name, 0.0, time.time(), ua.StatusCodes.BadWaitingForInitialData
                )
        await self._server.start()

    async def _secure(self, entrance: Entrance) -> None:
        certificate, key = await entrance.files()
        await self._server.set_application_uri(_APPLICATION)
        await self._server.load_certificate(certificate)
        await self._server.load_private_key(key)
        self._server.set_security_policy(
            [getattr(ua.SecurityPolicyType, name) for name in _SECURED]
        )
        self._server.set_identity_tokens([ua.UserNameIdentityToken])

    async def stop(self) -> None:
        """End all sessions."""
        await self._server.stop()

    async def write(
        self, folder: str, name: str, value: Any, stamp: float, status: int = ua.StatusCodes.Good
    ) -> None:
        """A value of a node at a time [s since 1970]."""
        node = await self._node(folder, name, value)
        at = datetime.fromtimestamp(stamp, UTC)
        datum = ua.DataValue(
            _variant(value),
            StatusCode=ua.StatusCode(status),
            SourceTimestamp=at,
            ServerTimestamp=at,
        )
        await node.write_value(datum)

    async def tell_alarm(self, alarm: Mapping[str, Any], at: datetime) -> None:
        """A change of an alarm as an event of the type AlarmConditionType (OPC 10000-9), at the
        object Server, its source the machine's folder.

        Clients see states and comments; nothing is acknowledged or shelved over OPC UA, and what
        stood before a client came is in the nodes alone: asyncua has no methods of conditions.
        """
        if self._alarms is None:
            kind = ua.ObjectIds.AlarmConditionType
            self._alarms = await self._server.get_event_generator(kind)
        event, asset, kind = self._alarms.event, str(alarm["asset"]), str(alarm["kind"])
        event.SourceNode = (await self._folder(asset)).nodeid
        event.SourceName, event.ConditionName = asset, kind
        event.NodeId = ua.NodeId(f"{asset}.alarm.{kind}", self._space)
        event.Severity = ua.Variant(
            _SEVERITY.get(alarm.get("priority") or "medium"), ua.VariantType.UInt16
        )
        event.Retain = alarm["state"] != "normal"
        event.SuppressedOrShelved = alarm["state"] in _ASIDE
        event.Comment = ua.LocalizedText(str(alarm.get("comment") or ""))
        event.ClientUserId = str(alarm.get("acknowledged_by") or "")
        _set_state(event, "EnabledState", True, "Enabled", "Disabled")
        _set_state(event, "ActiveState", bool(alarm["condition"]), "Active", "Inactive")
        acknowledged = alarm.get("acknowledged_at") is not None
        _set_state(event, "AckedState", acknowledged, "Acknowledged", "Unacknowledged")
        hidden = alarm["state"] == "suppressed"
        _set_state(event, "SuppressedState", hidden, "Suppressed", "Unsuppressed")
        await self._alarms.trigger(at, str(alarm["message"]))

    async def _folder(self, folder: str) -> Any:
        if folder not in self._folders:
            place = ua.NodeId(folder, self._space)
            self._folders[folder] = await self._server.nodes.objects.add_folder(
                place, f"{self._space}:{folder}"
            )
        return self._folders[folder]

    async def _node(self, folder: str, name: str, value: Any) -> Any:
        if (folder, name) not in self._nodes:
            identifier = ua.NodeId(f"{folder}.{name}", self._space)
            self._nodes[folder, name] = await (await self._folder(folder)).add_variable(
                identifier, f"{self._space}:{name}", _variant(value)
            )
        return self._nodes[folder, name]


def _set_state(event: Any, name: str, holds: bool, yes: str, no: str) -> None:
    """A state of two values: its text, and which of both it is."""
    setattr(event, name, ua.LocalizedText(yes if holds else no))
    setattr(event, f"{name}/Id", holds)


def _variant(value: Any) -> ua.Variant:
    if isinstance(value, bool):
        return ua.Variant(value, ua.VariantType.Boolean)
    if isinstance(value, str):
        return ua.Variant(value, ua.VariantType.String)
    return ua.Variant(float(value), ua.VariantType.Double)
