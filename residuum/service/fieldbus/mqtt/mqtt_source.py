"""MqttSource: streams of samples from plain JSON messages, read from an MQTT broker after a topic
map.
"""

from __future__ import annotations

import json
import math
from collections.abc import Collection, Sequence
from contextlib import suppress
from typing import Any

from residuum.identification.record_formats.loggers.logger_time import nanoseconds
from residuum.service.broker import BrokerAddress
from residuum.service.fieldbus.broker_source import CONNECTED, LOST, Arrived, BrokerSource
from residuum.service.fieldbus.mqtt.topic_map import (
    NOTHING,
    ChannelMessage,
    MessageTime,
    TopicMap,
    value_at,
)
from residuum.service.fieldbus.source import Sink, StreamFormat
from residuum.service.fieldbus.stamped_samples import StampedSamples

# Seconds of one unit of a time stamp.
_SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
# Bytes of a message that is looked at: one row of a machine's signals is far shorter.
_LONGEST = 1 << 20


def _each_name_once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """JSON itself lets the later of two equal names win, without a word."""
    names = dict(pairs)
    if len(names) < len(pairs):
        raise ValueError("a name stands twice in one place")
    return names


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


class MqttSource(BrokerSource):
    """Streams that a topic map describes.

    Parameters
    ----------
    address : BrokerAddress
        Its prefix is not used: the map has whole topics.
    topics : TopicMap
    sink : callable
    """

    def __init__(self, address: BrokerAddress, topics: TopicMap, sink: Sink) -> None:
        super().__init__(
            f"mqtt:{address.host}:{address.port}", address, topics.topics, "topics", sink
        )
        self._map = topics
        self._samples = {
            name: StampedSamples(stream.format(name), self.health)
            for name, stream in topics.streams.items()
        }
        self._of: dict[str, str] = {}
        """Filter → the one topic of it that is believed."""
        self._unseen = {
            (name, channel)
            for name, stream in topics.streams.items()
            for channel in stream.channels
        }
        self.health.remarks = [
            f"stream {name}: values have the time at which they arrive, so delays on the way are"
            " times of the machine"
            for name, stream in topics.streams.items()
            if not isinstance(stream.time, MessageTime)
        ]

    @property
    def streams(self) -> Sequence[StreamFormat]:
        """The streams of the topic map."""
        return [samples.format for samples in self._samples.values()]

    def _turn(self, client: Any, now: float) -> None:
        for samples in self._samples.values():
            block = samples.take(now)
            if block is not None:
                self._deliver(block, block.n)

    def _take(self, message: Arrived) -> None:
        if message.topic in (CONNECTED, LOST):
            for samples in self._samples.values():
                samples.reopened()
            return
        # what the broker kept states what was, long ago perhaps: it is no sample
        if message.retained:
            return
        filters = [topic for topic in self._topics if _matches(topic, message.topic)]
        believed = {topic for topic in filters if self._is_of(topic, message.topic)}
        content = self._content(message) if believed else NOTHING
        if content is not NOTHING:
            self._take_content(believed, content, message)

    def _take_content(self, believed: Collection[str], content: Any, message: Arrived) -> None:
        for name, stream in self._map.streams.items():
            channels = [c for c in stream.channels if stream.topic_of(c) in believed]
            if channels:
                self._take_stream(name, channels, content, message)

    def _is_of(self, topic: str, name: str) -> bool:
        """Whether messages of this name are those of a filter: the first that came under it.

        Of two devices one channel cannot be.
        """
        known = self._of.setdefault(topic, name)
        if known != name:
            self.health.count(
                "undecodable",
                1,
                f"topic {name[:80]!r}: {topic!r} is taken for {known[:80]!r}; name one in the map",
            )
        return known == name

    def _content(self, message: Arrived) -> Any:
        try:
            if len(message.content) > _LONGEST:
                raise ValueError(f"{len(message.content)} bytes; at most {_LONGEST} are read")
            return json.loads(message.content, object_pairs_hook=_each_name_once)
        # RecursionError: thousands of brackets
        except (ValueError, RecursionError) as error:
            says = f"topic {message.topic[:80]!r}: is no JSON that is read: {str(error)[:80]}"
            self.health.count("undecodable", 1, says)
            return NOTHING

    def _take_stream(
        self, name: str, channels: Sequence[str], content: Any, message: Arrived
    ) -> None:
        stream = self._map.streams[name]
        told = stream.time
        stamp = _stamp(content, told) if isinstance(told, MessageTime) else message.now
        if stamp is None:
            says = f"topic {message.topic[:80]!r}: no time stamp of the form and place of the map"
            self.health.count("unstamped", 1, says)
            return
        for channel in channels:
            value = value_at(content, stream.channels[channel].path)
            if value is not NOTHING:
                self._unseen.discard((name, channel))
                number = self._number(channel, stream.channels[channel], value)
                self._samples[name].add(channel, stamp, number, message.now)
        self.health.doubts[f"{name} {message.topic}"] = [
            f"channel {channel!r}: no message of {stream.topic_of(channel)!r} has"
            f" {stream.channels[channel].path!r}"
            for channel in channels
            if (name, channel) in self._unseen
        ]

    def _number(self, channel: str, spec: ChannelMessage, value: Any) -> float:
        """A value as a number; NaN, and counted, for what is none."""
        if value is None or (isinstance(value, float) and math.isnan(value)):
            self.count_no_value({channel: 1})
            return math.nan
        if isinstance(value, bool) if spec.boolean else _is_number(value):
            with suppress(OverflowError):  # a whole number of hundreds of digits
                return float(value) * spec.scale + spec.offset
        kind = "boolean" if spec.boolean else "number"
        self.health.count("bad_status", 1, f"channel {channel!r}: {_shown(value)} is no {kind}")
        return math.nan


def _shown(value: Any) -> str:
    return repr(value)[:40] if isinstance(value, str | bool) else f"a {type(value).__name__}"


def _stamp(content: Any, time: MessageTime) -> float | None:
    """The time stamp of a message [s since 1970]; None where it has none of this form."""
    value = value_at(content, time.path)
    try:
        if time.form == "iso":
            return nanoseconds(value, "iso", ".") / 1e9 if isinstance(value, str) else None
        stamp = float(value) * _SECONDS[time.form] if _is_number(value) else math.nan
    except (ValueError, OverflowError):
        return None
    return stamp if math.isfinite(stamp) else None


def _matches(topic: str, name: str) -> bool:
    """Whether a topic's name is one of a filter's.

    >>> _matches("a/+/c", "a/b/c"), _matches("a/#", "a"), _matches("a/+", "a/b/c")
    (True, True, False)
    """
    wanted, levels = topic.split("/"), name.split("/")
    if wanted[-1] == "#":
        wanted, levels = wanted[:-1], levels[: len(wanted) - 1]
    return len(wanted) == len(levels) and all(
        want in ("+", level) for want, level in zip(wanted, levels, strict=True)
    )
