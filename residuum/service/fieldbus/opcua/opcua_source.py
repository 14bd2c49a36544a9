"""OpcuaSource: streams of samples from the nodes of an OPC UA server, after a node map.

Nodes are subscribed to with every change of value, status or source time stamp. A value whose
status is not good is missing. A lost session or subscription is opened again, and what did not come
in the meantime is counted from the stamps.
"""

from __future__ import annotations

import asyncio
import logging
import math
import re
import time
from collections.abc import AsyncIterator, Iterable, Mapping, Sequence
from datetime import UTC
from pathlib import Path
from typing import Any, NamedTuple

from asyncua import Client, Node, ua
from asyncua.common.ua_utils import get_base_data_type
from cryptography import x509
from cryptography.hazmat.primitives import serialization

from residuum.identification.errors import in_one_line
from residuum.nearest_names import nearest_names
from residuum.service.broker import with_hidden_password
from residuum.service.fieldbus.can.frame_layout import BadBusDescription
from residuum.service.fieldbus.opcua.node_map import ChannelNode, NodeMap
from residuum.service.fieldbus.source import Backoff, Sink, Source, StreamFormat
from residuum.service.fieldbus.stamped_samples import StampedSamples

logging.getLogger("asyncua").setLevel(logging.CRITICAL)  # the counters say it

# [s] Between two looks at what came: how long a sample waits at most once it is whole.
_TICK = 0.05
# Milliseconds between two messages of a subscription.
_PUBLISH = 100.0
# [s] Between two questions to the server whether the connection stands.
_CHECK = 1.0
# Seconds without a value after which the session is asked whether it lives.
_SILENT = 3.0
# Values of a node that a server keeps between two messages.
_QUEUE = 1000
_NUMERIC = {
    getattr(ua.VariantType, name)
    for name in (
        "Boolean",
        "SByte",
        "Byte",
        "Int16",
        "UInt16",
        "Int32",
        "UInt32",
        "Int64",
        "UInt64",
        "Float",
        "Double",
    )
}
# A double tells whole numbers apart up to here.
_WHOLE_UNTIL = 2**53
_PLAIN = "number"
# Messages that wait in the client: its own bound would drop them without a word.
_WAITING = 100_000
# References looked at: some servers have hundreds of thousands, and browsing has to end.
_MOST_BROWSED = 5000


class _Refused(Exception):
    """The server cannot be read as the map says; the message says why."""


class OpcuaSource(Source):
    """Streams that a node map describes, read from one server.

    Parameters
    ----------
    url : str
        `opc.tcp://host:4840/path`.
    nodes : NodeMap
    sink : callable
    timeout : float
        For each request [s].
    """

    def __init__(self, url: str, nodes: NodeMap, sink: Sink, timeout: float = 2.0) -> None:
        super().__init__(f"opcua:{with_hidden_password(url)}", sink)
        self._url, self._map, self._timeout = url, nodes, timeout
        self._samples = {
            name: StampedSamples(
                stream.format(name),
                self.health,
                held={channel: spec.held for channel, spec in stream.channels.items()},
            )
            for name, stream in nodes.streams.items()
        }
        self._backoff = Backoff(first=0.1, longest=1.5)
        self._heard = 0.0
        self._broken = ""
        self._asked: Any = None
        self._places: dict[int, tuple[str, str, ChannelNode]] = {}

    @property
    def streams(self) -> Sequence[StreamFormat]:
        """The streams of the node map."""
        return [samples.format for samples in self._samples.values()]

    def _run(self) -> None:
        asyncio.run(self._keep_reading())

    async def _keep_reading(self) -> None:
        opened_before = False
        while not self._stopped.is_set():
            client = make_client(self._url, self._map, self._timeout)
            try:
                # several requests make a session: each has its own time, and all of them a bound
                await asyncio.wait_for(
                    enter(client, self._url, self._map, self._timeout), 4 * self._timeout
                )
                if opened_before:
                    self.health.count("reconnects")
                    for samples in self._samples.values():
                        samples.reopened()
                opened_before = True
                await self._read_while_it_works(client)
            except Exception as error:  # whatever a server does must not end the source
                self.health.count("bus_errors", 1, what_went_wrong(error))
            await self._close(client)
            # what is whole leaves now: the clock of the next connection may have been set
            self._hand_on()
            await self._pause(self._backoff.next())

    async def _close(self, client: Client) -> None:
        try:
            await asyncio.wait_for(client.disconnect(), self._timeout)
        except Exception:  # it may be gone already
            client.disconnect_socket()

    async def _read_while_it_works(self, client: Client) -> None:
        self._broken, self._asked, self._heard = "", None, time.monotonic()
        wanted = ua.CreateSubscriptionParameters(_PUBLISH, 600, 20, 0, True, 0)
        subscription = await client.create_subscription(wanted, self, queue_maxsize=_WAITING)
        await self._watch_nodes(client, subscription)
        check = time.monotonic() + _CHECK
        while not self._stopped.is_set():
            await asyncio.sleep(_TICK)
            self._hand_on()
            if self._broken:
                raise _Refused(self._broken)
            if time.monotonic() < check:
                continue
            check = time.monotonic() + _CHECK
            await client.check_connection()
            if time.monotonic() - self._heard > _SILENT:
                await self._revive(client)

    async def _revive(self, client: Client) -> None:
        """No value for long: a server that answers, and whose values change, has let the
        subscription go.
        """
        values = [client.get_node(spec.node) for _, _, spec, _ in self._channels()]
        readings = await asyncio.wait_for(
            asyncio.gather(*(n.read_data_value(False) for n in values)), self._timeout
        )
        newest = max((v.SourceTimestamp for v in readings if v.SourceTimestamp), default=None)
        # asked twice: a value that has not changed since is as silent as a subscription that is
        # gone
        before, self._asked = self._asked, newest
        if before is not None and newest is not None and newest != before:
            raise _Refused("values change and the subscription is silent")

    async def _watch_nodes(self, client: Client, subscription: Any) -> None:
        self._places = {}
        await self._refuse_other_kinds(client)
        requests = []
        for handle, (stream, name, spec, every) in enumerate(self._channels(), start=1):
            self._places[handle] = (stream, name, spec)
            requests.append(_request(client.get_node(spec.node).nodeid, handle, 1e3 * every))
        results = await subscription.create_monitored_items(requests)
        for result, (_, name, spec) in zip(results, self._places.values(), strict=True):
            if isinstance(result, ua.StatusCode):
                raise _Refused(await self._lacking(client, name, spec, result))

    async def _refuse_other_kinds(self, client: Client) -> None:
        """What no number can be made of is refused before it is missing for ever; whole numbers
        beyond 2^53 are told.
        """
        channels = [(name, spec) for _, name, spec, _ in self._channels()]
        values = [client.get_node(spec.node).read_data_value(False) for _, spec in channels]
        readings = await asyncio.wait_for(asyncio.gather(*values), self._timeout)
        unfit, large = [], []
        for (name, spec), datum in zip(channels, readings, strict=True):
            if datum.Value is None or datum.Value.Value is None:
                continue  # there is no value yet, or no such node
            if kind := _unfit_kind(datum.Value):
                unfit.append(f"channel {name!r}, node {spec.node!r}: {kind}, no number")
            elif _is_rounded(datum.Value.Value):
                large.append(
                    f"channel {name!r}: whole numbers beyond 2^53 are rounded; neighbours look"
                    " alike"
                )
        self.health.remarks = large
        if unfit:
            raise _Refused(
                f"{'; '.join(unfit)}; take {'them' if len(unfit) > 1 else 'it'} out of the map"
            )

    def _channels(self) -> Iterable[tuple[str, str, ChannelNode, float]]:
        for stream, nodes in self._map.streams.items():
            for name, spec in nodes.channels.items():
                yield stream, name, spec, nodes.sample_time

    async def _lacking(
        self, client: Client, name: str, spec: ChannelNode, status: ua.StatusCode
    ) -> str:
        if status.value != ua.StatusCodes.BadNodeIdUnknown:
            return f"channel {name!r}, node {spec.node!r}: {status.name}"
        node_ids = [node async for node, _ in variables(client, _MOST_BROWSED)]
        near = nearest_names(spec.node, node_ids, 3, like=0.0)
        return (
            f"channel {name!r}: the server has no node {spec.node!r}; the nearest are"
            f" {', '.join(near) or 'none'}"
        )

    def datachange_notification(self, node: Any, value: Any, data: Any) -> None:
        """Take a value (called by the client)."""
        item = data.monitored_item
        place = self._places.get(item.ClientHandle)
        if place is None:
            return
        now, datum = time.monotonic(), item.Value
        self._heard = now
        stream, name, spec = place
        if datum.SourceTimestamp is None:
            self.health.count(
                "unstamped", 1, f"channel {name!r}: a value without a source time stamp"
            )
            return
        number = math.nan
        if datum.StatusCode.is_good() and datum.Value is not None:
            number = _number(datum.Value.Value)
        # a missing value is taken all the same: it ends one that was held
        if math.isnan(number):
            self.health.count(
                "bad_status",
                1,
                f"channel {name!r}: status {datum.StatusCode.name}, missing until it is good",
            )
        self._samples[stream].add(
            name, _seconds(datum.SourceTimestamp), number * spec.scale + spec.offset, now
        )

    def status_change_notification(self, status: Any) -> None:
        """The server lets the subscription go."""
        self._broken = f"the subscription ended: {status}"

    def _hand_on(self) -> None:
        for samples in self._samples.values():
            block = samples.take(time.monotonic())
            if block is not None:
                self._backoff.reset()
                self._deliver(block, 1)

    async def _pause(self, seconds: float) -> None:
        end = time.monotonic() + seconds
        while not self._stopped.is_set() and (left := end - time.monotonic()) > 0:
            await asyncio.sleep(min(left, 0.1))


def _unfit_kind(value: ua.Variant) -> str:
    """The type of a value that is no number, with `[]` behind an array's; empty for a number."""
    is_array = isinstance(value.Value, list)
    if value.VariantType in _NUMERIC and not is_array:
        return ""
    return f"{value.VariantType.name}{'[]' * is_array}"


def _is_rounded(value: Any) -> bool:
    return isinstance(value, int) and abs(value) >= _WHOLE_UNTIL


def _request(node: ua.NodeId, handle: int, every: float) -> ua.MonitoredItemCreateRequest:
    """To be told every change of a node's value, status or source time stamp, looked at every so
    many milliseconds.
    """
    changes = ua.DataChangeFilter(Trigger=ua.DataChangeTrigger.StatusValueTimestamp)
    return ua.MonitoredItemCreateRequest(
        ItemToMonitor=ua.ReadValueId(NodeId=node, AttributeId=ua.AttributeIds.Value),
        MonitoringMode=ua.MonitoringMode.Reporting,
        RequestedParameters=ua.MonitoringParameters(
            ClientHandle=handle,
            SamplingInterval=every,
            Filter=changes,
            QueueSize=_QUEUE,
            DiscardOldest=True,
        ),
    )


def make_client(url: str, nodes: NodeMap | None, timeout: float) -> Client:
    """A client of a server, entered as the map says."""
    client = Client(url, timeout=timeout)
    if nodes is not None and nodes.user is not None:
        client.set_user(nodes.user.name)
        client.set_password(nodes.user.password)
    if nodes is not None and nodes.security is not None:
        client.application_uri = _application_uri(nodes.security.certificate)
    return client


async def enter(client: Client, url: str, nodes: NodeMap | None, timeout: float) -> None:
    """Open a session; a server that shows another certificate than the trusted one is not entered:
    it would not even answer.
    """
    s = None if nodes is None else nodes.security
    if s is not None:
        shown, trusted = await server_certificate(url, timeout), s.trusted
        # compared as DER: the file may be PEM of the same certificate
        if _plain(shown) != _plain(trusted.read_bytes()):
            raise _Refused(
                f"the certificate that the server shows is not the trusted one ({trusted}); if the"
                f" server has a new one, `residuum opcua trust {with_hidden_password(url)} --out"
                f" {trusted}` saves it: compare the fingerprint at the server first"
            )
        await client.set_security_string(f"{s.policy},{s.mode},{s.certificate},{s.key},{s.trusted}")
    await client.connect()


def _plain(certificate: bytes) -> bytes:
    """A certificate in DER."""
    if b"-----BEGIN" not in certificate:
        return certificate
    return x509.load_pem_x509_certificate(certificate).public_bytes(serialization.Encoding.DER)


def _application_uri(certificate: Path) -> str:
    """The name of an application in its certificate, by which a server knows it."""
    content = certificate.read_bytes()
    try:
        read = (
            x509.load_pem_x509_certificate
            if b"-----BEGIN" in content
            else x509.load_der_x509_certificate
        )
        names = read(content).extensions.get_extension_for_class(x509.SubjectAlternativeName).value
        return str(names.get_values_for_type(x509.UniformResourceIdentifier)[0])
    except (ValueError, IndexError, x509.ExtensionNotFound):
        raise BadBusDescription(
            f"{certificate}: is no certificate with the application's URI in it, as OPC UA needs"
        ) from None


def _after(first: Any, then: Any) -> Any:
    async def both() -> None:
        await first
        await then()

    return both


def what_went_wrong(error: Exception) -> str:
    """What went wrong, with the remedy where a certificate is not trusted."""
    if isinstance(error, _Refused):
        return str(error)
    text = in_one_line(error)
    if "Certificate" in text or "SecurityChecks" in text:
        return (
            f"{text}; have our certificate put among the server's trusted ones, and its own at"
            " `security: trusted` of the map"
        )
    return text if str(error) else f"{type(error).__name__}: nobody answers at this address"


async def variables(client: Client, most: int) -> AsyncIterator[tuple[str, Any]]:
    """(node id, node) of the variables below the server's objects, at most so many references
    looked at.
    """
    waiting, looked_at, known = [client.nodes.objects], 0, set()
    while waiting and looked_at < most:
        # namespace 0 is the standard's own: the server's state and types, no machine's values
        for reference in await waiting.pop().get_references(
            ua.ObjectIds.HierarchicalReferences, ua.BrowseDirection.Forward
        ):
            looked_at += 1
            if reference.NodeId.NamespaceIndex == 0 or reference.NodeId in known:
                continue
            known.add(reference.NodeId)
            child = client.get_node(reference.NodeId)
            if reference.NodeClass == ua.NodeClass.Variable:
                yield reference.NodeId.to_string(), child
            waiting.append(child)


class Variable(NamedTuple):
    """A variable that holds a number: its node's id, its unit, and what it is: a number, a boolean,
    an enumeration with names.
    """

    node: str
    unit: str
    kind: str
    names: tuple[str, ...] = ()

    @property
    def held(self) -> bool:
        """Whether its value is one of few, which servers report when it changes, and which holds
        until then.
        """
        return self.kind != _PLAIN


async def numeric_variables(
    url: str, nodes: NodeMap | None, under: str, timeout: float
) -> dict[str, Variable]:
    """Channel → variable of a server's variables that hold numbers and whose id begins with
    `under`.
    """
    client = make_client(url, nodes, timeout)
    by_channel: dict[str, Variable] = {}
    await enter(client, url, nodes, timeout)
    try:
        async for node_id, node in variables(client, _MOST_BROWSED):
            if node_id.startswith(under) and await _is_numeric(node):
                by_channel[_channel_name(node_id, by_channel)] = Variable(
                    node_id, await _unit(node), *await _kind(node)
                )
    finally:
        await client.disconnect()
    return by_channel


async def _is_numeric(node: Any) -> bool:
    kind = await node.read_data_type_as_variant_type()
    return kind in _NUMERIC and (await node.read_value_rank()) in (-1, ua.ValueRank.Scalar)


async def _kind(node: Any) -> tuple[str, tuple[str, ...]]:
    """What a variable of numbers is, and the names of an enumeration's values (Part 3, 5.8.3;
    MultiStateDiscrete of Part 8).
    """
    kind = Node(node.session, await node.read_data_type())
    base = (await get_base_data_type(kind)).nodeid.Identifier
    if base == ua.ObjectIds.Boolean:
        return "boolean", ()
    names = await _names(node) or (await _names(kind) if base == ua.ObjectIds.Enumeration else ())
    return ("enumeration" if names or base == ua.ObjectIds.Enumeration else _PLAIN), names


async def _names(node: Any) -> tuple[str, ...]:
    """Number and name of each value, where a variable or a data type has a table of them."""
    for table in ("0:EnumStrings", "0:EnumValues"):
        try:
            rows = await (await node.get_child(table)).read_value()
            return tuple(
                f"{getattr(row, 'Value', k)} {getattr(row, 'DisplayName', row).Text}"
                for k, row in enumerate(rows)
            )
        except (ua.UaError, AttributeError, TypeError):
            continue
    return ()


async def _unit(node: Any) -> str:
    """The display name of the node's engineering units, where it has them."""
    try:
        units = await (await node.get_child("0:EngineeringUnits")).read_value()
        return str(units.DisplayName.Text or "")
    except (ua.UaError, AttributeError):
        return ""


def _channel_name(node_id: str, taken: Mapping[str, object]) -> str:
    """The last part of an id; with those before it where it is taken."""
    parts = re.split(r"[.=;/]", node_id)
    for count in range(1, len(parts) + 1):
        name = ".".join(parts[-count:])
        if name not in taken:
            return name
    return node_id


async def server_certificate(url: str, timeout: float) -> bytes:
    """The certificate that a server shows in its endpoints; empty when it has none."""
    endpoints = await Client(url, timeout=timeout).connect_and_get_server_endpoints()
    return next((bytes(e.ServerCertificate) for e in endpoints if e.ServerCertificate), b"")


def _seconds(stamp: Any) -> float:
    return float((stamp if stamp.tzinfo else stamp.replace(tzinfo=UTC)).timestamp())


def _number(value: Any) -> float:
    """A value as a number; nan for anything else, even for a text that reads like one."""
    return float(value) if isinstance(value, int | float) else math.nan
