"""NodeSession: messages of one Sparkplug edge node put in order; every gap is noticed, and nothing after one is believed.

A node numbers its messages 0 … 255, 0, … and begins with a birth (NBIRTH) that names its metrics. After a gap the metrics'
aliases may mean something else, so nothing is taken until the node is born again.

* Messages wait for `settle` seconds and go on by their time of sending, so that a birth stands before its data.
* One ahead of its turn waits for those before it, `patience` seconds long; then there is a gap.
* One that was taken before is a repetition. One older than those that are remembered is late; if nothing else comes for
  `patience` seconds, the node's clock was set back: a gap, too.
* A birth that came before is a repetition, and an older one late, unless it is so much older that the clock must have been set.
* A death (NDEATH) carries the number of its birth (bdSeq): one of an earlier session says nothing of this one.

The numbers alone do not show 256 messages lost in a row, nor a birth that is lost while they happen to go on (1 in 256): the
first show in the stamps of values, the second in an alias that nobody gave.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

from residuum.service.fieldbus.health import SourceHealth
from residuum.service.fieldbus.sparkplug.sparkplug_payload import Payload

_TURN = 256
_HALF = _TURN // 2
_LATEST_BIRTH = 10_000
"""[ms] By which a birth may come late; an older one was stamped by a clock that was set back."""
_REMEMBERED = 1000


@dataclass(frozen=True)
class NodeMessage:
    """One message: its kind (`NBIRTH`, `DDATA`, …), its device (empty: the node itself), what it says."""

    kind: str
    device: str
    payload: Payload

    @property
    def birth_number(self) -> object:
        """Its bdSeq; None where it has none."""
        return next((metric.value for metric in self.payload.metrics if metric.name == "bdSeq"), None)


@dataclass
class _Session:
    """What is known of the node since its birth: the number that comes next, and number → time of sending of the last 128."""

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
        """Whether a message was sent before all that are remembered, or before the latest and has a number that is over."""
        return stamp < next(iter(self.taken.values())) or (self.is_behind(seq) and stamp <= self.latest)


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
        until = max((sent for sent, came, _ in self._arrived if now - came >= self._settle), default=None)
        if until is None:
            return []
        due = sorted((each for each in self._arrived if each[0] <= until), key=lambda each: each[0])
        self._arrived = [each for each in self._arrived if each[0] > until]
        return [taken for _, _, message in due for taken in self._take(message, now)]

    def gap(self, now: float) -> bool:
        """Whether there is a gap by now that there was not before."""
        waiting = [came for came, _ in self._held[:1]] + ([self._doubt] if self._doubt is not None else [])
        if self._session is None or not waiting:
            return False
        if now - min(waiting) < self._patience and len(self._held) < _HALF:
            return False
        self._health.count("sequence_gaps", 1, f"message {self._session.expected} never came; the node is asked to be born again")
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
        stamp, seq, birth = message.payload.stamp, message.payload.seq or 0, (message.payload.stamp, message.birth_number)
        if birth in self._births or self._newest_birth - _LATEST_BIRTH < stamp <= self._newest_birth:
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
        if session.taken.get(seq) == stamp or any(held.payload == message.payload for _, held in self._held):
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
        found: list[NodeMessage] = []
        while following := [each for _, each in self._held if each.payload.seq == session.expected]:
            first = min(following, key=lambda each: each.payload.stamp)
            session.accept(session.expected, first.payload.stamp)
            found.append(first)
            self._held = [(came, each) for came, each in self._held if each is not first]
        before = len(self._held)
        self._held = [(came, each) for came, each in self._held if not session.is_behind(each.payload.seq or 0)]
        self._health.count("duplicated", before - len(self._held))
        return found

    def _let_go(self) -> None:
        self._health.count("unborn", len(self._held))
        self._held, self._doubt = [], None
