"""SparkplugSource: streams of samples from the metrics of a Sparkplug B edge node, read from an
MQTT broker after a metric map.

What a message says is believed while the node's sequence is whole (see `node_session`). After a
gap, a lost connection, a death, or messages that came faster than they were read the node is asked
to be born again, and nothing is taken before. Values that births and stores of the node repeat are
no samples.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

from residuum.nearest_names import nearest_names
from residuum.service.broker import BrokerAddress
from residuum.service.fieldbus.broker_source import CONNECTED, LOST, Arrived, BrokerSource
from residuum.service.fieldbus.health import SourceHealth
from residuum.service.fieldbus.source import Backoff, Sink, StreamFormat
from residuum.service.fieldbus.sparkplug.metric_map import MetricMap
from residuum.service.fieldbus.sparkplug.sparkplug_payload import (
    BOOLEAN,
    BadPayload,
    Metric,
    Payload,
    number_of,
    pack,
    unpack,
)
from residuum.service.fieldbus.stamped_samples import ReportedChanges, StampedSamples

# NodeSession: messages of one Sparkplug edge node put in order; every gap is noticed, and nothing
# after one is believed.
# A node numbers its messages 0 … 255, 0, … and begins with a birth (NBIRTH) that names its
# metrics. After a gap the metrics' aliases may mean something else, so nothing is taken until the
# node is born again.
# * Messages wait for `settle` seconds and go on by their time of sending, so that a birth stands
#   before its data.
# * One ahead of its turn waits for those before it, `patience` seconds long; then there is a gap.
# * One that was taken before is a repetition. One older than those that are remembered is late; if
#   nothing else comes for `patience` seconds, the node's clock was set back: a gap, too.
# * A birth that came before is a repetition, and an older one late, unless it is so much older that
#   the clock must have been set.
# * A death (NDEATH) carries the number of its birth (bdSeq): one of an earlier session says nothing
#   of this one.
# The numbers alone do not show 256 messages lost in a row, nor a birth that is lost while they
# happen to go on (1 in 256): the first show in the stamps of values, the second in an alias that
# nobody gave.

_TURN = 256
_HALF = _TURN // 2
# [ms] By which a birth may come late; an older one was stamped by a clock that was set back.
_LATEST_BIRTH = 10_000
# Births that are known again when a broker repeats them.
_REMEMBERED = 1000


@dataclass(frozen=True)
class NodeMessage:
    """One message: its kind (`NBIRTH`, `DDATA`, …), its device (empty: the node itself), what it
    says.
    """

    kind: str
    device: str
    payload: Payload

    @property
    def birth_number(self) -> object:
        """Its bdSeq; None where it has none."""
        return next(
            (metric.value for metric in self.payload.metrics if metric.name == "bdSeq"), None
        )


@dataclass
class _Session:
    """What is known of the node since its birth: the number that comes next, and number → time of
    sending of the last 128.
    """

    birth_number: object
    expected: int
    latest: int
    taken: dict[int, int] = field(default_factory=dict)

    def accept(self, seq: int, stamp: int) -> None:
        """Note a message in its turn."""
        self.expected, self.latest = (seq + 1) % _TURN, max(self.latest, stamp)
        self.taken.pop(seq, None)
        self.taken[seq] = stamp
        if len(self.taken) > _HALF:
            del self.taken[next(iter(self.taken))]

    def is_behind(self, seq: int) -> bool:
        """Whether the number is one of the 128 before the one that comes next."""
        return (seq - self.expected) % _TURN >= _HALF

    def is_late(self, seq: int, stamp: int) -> bool:
        """Whether a message was sent before all that are remembered, or before the latest and has a
        number that is over.
        """
        return stamp < next(iter(self.taken.values())) or (
            self.is_behind(seq) and stamp <= self.latest
        )


class NodeSession:
    """One edge node.

    Parameters
    ----------
    health : SourceHealth
        Counts repetitions, messages put in order, gaps, and what came while the node was not born.
    patience, settle : float
        See the module [s].
    """

    def __init__(self, health: SourceHealth, patience: float = 1.0, settle: float = 0.2) -> None:
        self._health, self._patience, self._settle = health, patience, settle
        self._session: _Session | None = None
        self._births: dict[tuple[int, object], None] = {}
        self._newest_birth = -math.inf
        self._arrived: list[tuple[int, float, NodeMessage]] = []
        self._held: list[tuple[float, NodeMessage]] = []
        self._doubt: float | None = None

    @property
    def in_step(self) -> bool:
        """Whether the node is born and no message is missing, as far as is known."""
        return self._session is not None

    def break_off(self) -> None:
        """Believe nothing until the next birth: the connection was lost, or there is a gap."""
        self._session = None
        self._let_go()

    def arrived(self, message: NodeMessage, now: float) -> None:
        """A message came; `now` is our monotonic clock [s].

        A death was written when the node connected: it stands where it came.
        """
        stamp = message.payload.stamp
        if message.kind == "NDEATH":
            stamp = max((sent for sent, _, _ in self._arrived), default=stamp)
        self._arrived.append((stamp, now, message))

    def ready(self, now: float) -> Sequence[NodeMessage]:
        """The messages that can be believed now, in order."""
        until = max(
            (sent for sent, since, _ in self._arrived if now - since >= self._settle), default=None
        )
        if until is None:
            return []
        due = sorted(
            (entry for entry in self._arrived if entry[0] <= until), key=lambda entry: entry[0]
        )
        self._arrived = [entry for entry in self._arrived if entry[0] > until]
        return [taken for _, _, message in due for taken in self._take(message, now)]

    def gap(self, now: float) -> bool:
        """Whether there is a gap by now that there was not before."""
        # since when the first message ahead of its turn, and a late one, stand without those
        # between
        waiting = [since for since, _ in self._held[:1]]
        if self._doubt is not None:
            waiting.append(self._doubt)
        if self._session is None or not waiting:
            return False
        # more than half a turn ahead, numbers no longer tell ahead from behind
        if now - min(waiting) < self._patience and len(self._held) < _HALF:
            return False
        self._health.count(
            "sequence_gaps",
            1,
            f"message {self._session.expected} never came; the node is asked to be born again",
        )
        self.break_off()
        return True

    def _take(self, message: NodeMessage, now: float) -> Sequence[NodeMessage]:
        if message.kind == "NDEATH":
            return self._death(message)
        if message.kind == "NBIRTH":
            return self._birth(message)
        return self._data(message, now)

    def _death(self, message: NodeMessage) -> Sequence[NodeMessage]:
        if self._session is None or message.birth_number != self._session.birth_number:
            self._health.count("duplicated", 1)
            return []
        self.break_off()
        return [message]

    def _birth(self, message: NodeMessage) -> Sequence[NodeMessage]:
        stamp, seq = message.payload.stamp, message.payload.seq or 0
        birth = (stamp, message.birth_number)
        is_late = self._newest_birth - _LATEST_BIRTH < stamp <= self._newest_birth
        if birth in self._births or is_late:
            self._health.count("duplicated", 1)
            return []
        self._births[birth], self._newest_birth = None, stamp
        if len(self._births) > _REMEMBERED:
            del self._births[next(iter(self._births))]
        self._let_go()
        self._session = _Session(message.birth_number, (seq + 1) % _TURN, stamp, {seq: stamp})
        return [message]

    def _data(self, message: NodeMessage, now: float) -> Sequence[NodeMessage]:
        session, seq, stamp = self._session, message.payload.seq, message.payload.stamp
        if session is None or seq is None:
            self._health.count("unborn", 1)
            return []
        if session.taken.get(seq) == stamp or any(
            held.payload == message.payload for _, held in self._held
        ):
            self._health.count("duplicated", 1)
            return []
        if session.is_late(seq, stamp):
            self._health.count("duplicated", 1)
            self._doubt = now if self._doubt is None else self._doubt
            return []
        if seq != session.expected:
            self._held.append((now, message))
            return []
        self._doubt = None
        session.accept(seq, stamp)
        following = self._those_in_turn(session)
        self._health.count("reordered", int(bool(following)))
        return [message, *following]

    def _those_in_turn(self, session: _Session) -> list[NodeMessage]:
        """Held messages whose turn has come; those whose turn is over go."""
        in_turn: list[NodeMessage] = []
        while following := [held for _, held in self._held if held.payload.seq == session.expected]:
            first = min(following, key=lambda held: held.payload.stamp)
            session.accept(session.expected, first.payload.stamp)
            in_turn.append(first)
            self._held = [(since, held) for since, held in self._held if held is not first]
        before = len(self._held)
        self._held = [
            (since, held)
            for since, held in self._held
            if not session.is_behind(held.payload.seq or 0)
        ]
        self._health.count("duplicated", before - len(self._held))
        return in_turn

    def _let_go(self) -> None:
        self._health.count("unborn", len(self._held))
        self._held, self._doubt = [], None


NAMESPACE = "spBv1.0"
REBIRTH = "Node Control/Rebirth"
_OF_A_NODE = ("NBIRTH", "NDEATH", "NDATA", "DBIRTH", "DDEATH", "DDATA")


class SparkplugSource(BrokerSource):
    """Streams that a metric map describes, of one edge node.

    Parameters
    ----------
    address : BrokerAddress
        Its prefix is not used: Sparkplug has topics of its own.
    metrics : MetricMap
    sink : callable
    patience : float
        How long a message waits for those before it [s].
    """

    def __init__(
        self, address: BrokerAddress, metrics: MetricMap, sink: Sink, patience: float = 1.0
    ) -> None:
        super().__init__(
            f"sparkplug:{address.host}:{address.port}/{metrics.node}",
            address,
            [f"{NAMESPACE}/{metrics.group}/+/{metrics.edge_node}/#"],
            f"node {metrics.node}",
            sink,
        )
        self._map = metrics
        self._samples = {
            name: StampedSamples(spec.format(name), self.health)
            for name, spec in metrics.streams.items()
        }
        self._changes = {
            name: ReportedChanges(list(spec.channels), spec.sample_time)
            for name, spec in metrics.streams.items()
            if spec.reports == "changes"
        }
        self._session = NodeSession(self.health, patience)
        self._known: dict[str, dict[str | int, tuple[str, int]]] = {}
        """Device → name or alias → (name, data type), from its birth."""
        self._backoff, self._ask_at = Backoff(first=1.0, longest=30.0), math.inf

    @property
    def streams(self) -> Sequence[StreamFormat]:
        """The streams of the metric map."""
        return [samples.format for samples in self._samples.values()]

    def _turn(self, client: Any, now: float) -> None:
        for message in self._session.ready(now):
            self._believe(message, now)
        if self._session.gap(now):
            self._forget()
        self._ask_for_birth(client, now)
        self._hand_on(now)

    def _broken_off(self) -> None:
        """The node has to be born again."""
        self._session.break_off()
        self._forget()
        if not self._connected.is_set():
            self._ask_at = math.inf
        elif self._ask_at == math.inf:
            self._ask_at = time.monotonic()

    def _take(self, message: Arrived) -> None:
        topic, content, now, _ = message
        if topic in (CONNECTED, LOST):
            self._session.break_off()
            self._forget()
            self._ask_at = now if topic == CONNECTED else math.inf
            return
        kind, device = kind_and_device(topic)
        if kind not in _OF_A_NODE:
            return
        try:
            self._session.arrived(NodeMessage(kind, device, unpack(content)), now)
        except BadPayload as error:
            self.health.count("undecodable", 1, f"{topic}: {error}")

    def _believe(self, message: NodeMessage, now: float) -> None:
        # a birth may follow a restart with another clock, and gives aliases anew
        if message.kind == "NBIRTH":
            self._forget()
            for samples in self._samples.values():
                samples.reopened()
        if message.kind in ("NBIRTH", "DBIRTH"):
            self._born(message)
        elif message.kind == "NDEATH":
            self.health.count("bus_errors", 1, f"node {self._map.node} has gone")
            self._forget()
        elif message.kind == "DDEATH":
            self._forget(message.device)
        else:
            self._values(message, now)

    def _born(self, message: NodeMessage) -> None:
        known: dict[str | int, tuple[str, int]] = {}
        for metric in message.payload.metrics:
            known[metric.name] = metric.name, metric.datatype
            if metric.alias is not None:
                known[metric.alias] = known[metric.name]
        self._known[message.device] = known
        names = [metric.name for metric in message.payload.metrics]
        for stream, spec in self._map.streams.items():
            if spec.device != message.device:
                continue
            for channel, wanted in spec.channels.items():
                if wanted.metric not in known:
                    near = ", ".join(nearest_names(wanted.metric, names, 3, like=0.0)) or "none"
                    lacks = (
                        f"channel {channel!r}: the birth has no metric {wanted.metric!r}; the"
                        f" nearest are {near}"
                    )
                    self.health.count("undecodable", 1, lacks)
            if stream in self._changes:
                self._changes[stream].stated(self._reports(stream, message))

    def _values(self, message: NodeMessage, now: float) -> None:
        known = self._known.get(message.device, {})
        unnamed = [
            m.alias
            for m in message.payload.metrics
            if not m.name and m.alias is not None and m.alias not in known
        ]
        if unnamed:
            self.health.count(
                "sequence_gaps",
                1,
                f"device {message.device!r}: no birth that came gave the alias {unnamed[0]}",
            )
            self._session.break_off()
            self._forget()
            return
        for stream, spec in self._map.streams.items():
            if spec.device != message.device:
                continue
            reports: Iterable[tuple[float, str, float]] = self._reports(stream, message)
            if stream in self._changes:
                reports = self._changes[stream].samples(reports)
            for stamp, channel, value in reports:
                self._samples[stream].add(channel, stamp, value, now)

    def _reports(self, stream: str, message: NodeMessage) -> list[tuple[float, str, float]]:
        """(stamp [s], channel, value) of what a message says of a stream, in the order of the
        stamps.
        """
        known = self._known.get(message.device, {})
        channels = {
            wanted.metric: (name, wanted)
            for name, wanted in self._map.streams[stream].channels.items()
        }
        reports = []
        for metric in message.payload.metrics:
            name, datatype = known.get(_identifier(metric), ("", 0))
            if not name:
                self.health.count(
                    "unborn", 1, f"device {message.device!r}: a metric that its birth does not name"
                )
            if name not in channels:
                continue
            # kept while the node was not connected: its samples were handed on without it
            if metric.historical:
                self.health.count("late_values", 1)
                continue
            channel, wanted = channels[name]
            number = self._number(metric, datatype, channel)
            stamp = metric.stamp if metric.stamp is not None else message.payload.stamp
            reports.append((stamp / 1e3, channel, number * wanted.scale + wanted.offset))
        return sorted(reports, key=lambda report: report[0])

    def _number(self, metric: Metric, datatype: int, channel: str) -> float:
        """A metric's value, NaN and counted where it is none or not good."""
        number = number_of(metric, datatype) if metric.good else math.nan
        if math.isnan(number):
            self.health.count("bad_status", 1, f"channel {channel!r}: not good, or no number")
        return number

    def _forget(self, device: str | None = None) -> None:
        """What was said is not known any more: of a device, or of the node and all of them."""
        for name in [name for name in self._known if device in (None, name)]:
            del self._known[name]
        for stream, changes in self._changes.items():
            if device is None or self._map.streams[stream].device == device:
                changes.forget()

    def _ask_for_birth(self, client: Any, now: float) -> None:
        # while all is well: the moment at which a gap would be found, so that it is asked at once
        if self._session.in_step:
            self._ask_at = now
        if self._session.in_step or now < self._ask_at:
            return
        asked = Payload([Metric(REBIRTH, True, BOOLEAN)], int(time.time() * 1e3))
        client.publish(f"{NAMESPACE}/{self._map.group}/NCMD/{self._map.edge_node}", pack(asked))
        self.health.count("rebirths_asked")
        self._ask_at = now + self._backoff.next()

    def _hand_on(self, now: float) -> None:
        for samples in self._samples.values():
            block = samples.take(now)
            if block is not None:
                self._backoff.reset()
                self._deliver(block, 1)


def _identifier(metric: Metric) -> str | int:
    """By what a metric is named: its name, else its alias."""
    return metric.alias if not metric.name and metric.alias is not None else metric.name


def kind_and_device(topic: str) -> tuple[str, str]:
    """Kind and device of a topic `spBv1.0/GROUP/KIND/NODE[/DEVICE]`."""
    parts = topic.split("/")
    return (parts[2] if len(parts) > 2 else ""), (parts[4] if len(parts) > 4 else "")
