"""TopicMap: which values of which JSON messages of a broker are channels, from a YAML file.

```yaml
streams:
  signals:
    sample_time: 0.1                 # s; a value belongs to the sample nearest to its time stamp
    topic: plant/press/data          # of channels that name none
    # where the time stamp stands in a message and its unit (s, ms, us, ns, iso), or: time: arrival
    time: {path: /time, form: ms}
    channels:
      speed: {path: /motor/speed, unit: rpm}
      force: {topic: plant/+/force, path: /value, unit: N, scale: 1000}
      running: {path: /on, boolean: true}
# for a broker at mqtts://, as far as it needs them
tls: {ca: ca.pem, certificate: own.pem, key: own.key}
```

A path is a JSON pointer (RFC 6901); without one the whole message is the value.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

from pydantic import Field, field_validator, model_validator

from residuum.service.fieldbus.broker_map import BrokerMap
from residuum.service.fieldbus.map_text import read_map
from residuum.service.fieldbus.source import StreamFormat
from residuum.service.fieldbus.strict_model import StrictModel

_ESCAPES = (("~1", "/"), ("~0", "~"))


def _is_filter(topic: str) -> bool:
    """Whether a topic can be subscribed to (MQTT 5, 4.7): wildcards are whole levels, `#` the last
    one.
    """
    levels = topic.split("/")
    return (
        bool(topic)
        and "\0" not in topic
        and all(level in ("+", "#") or not set(level) & set("+#") for level in levels)
        and "#" not in levels[:-1]
    )


def _checked_topic(topic: str) -> str:
    if topic and not _is_filter(topic):
        raise ValueError(
            f"{topic[:60]!r} is no topic: + and # stand for whole levels, # at the end"
        )
    return topic


class MessageTime(StrictModel):
    """Where a message has its time stamp, and in which unit since 1970; `iso` is a text."""

    path: str = Field(min_length=1)
    form: Literal["s", "ms", "us", "ns", "iso"]


class ChannelMessage(StrictModel):
    """The message of a channel and its place in it, and how its number becomes a value in this
    unit: value · scale + offset. `boolean` takes true and false, as 1 and 0, and nothing else.
    """

    topic: str = ""
    path: str = ""
    unit: str = ""
    scale: float = 1.0
    offset: float = 0.0
    boolean: bool = False

    _topic = field_validator("topic")(_checked_topic)


class StreamMessages(StrictModel):
    """One stream: its clock and its channels."""

    sample_time: float = Field(gt=0, le=3600)
    topic: str = ""
    time: MessageTime | Literal["arrival"]
    channels: dict[str, ChannelMessage] = Field(min_length=1, max_length=500)

    _topic = field_validator("topic")(_checked_topic)

    @model_validator(mode="after")
    def _each_has_a_topic(self) -> StreamMessages:
        lacking = [name for name, spec in self.channels.items() if not (spec.topic or self.topic)]
        if lacking:
            raise ValueError(
                f"channel {lacking[0]!r} has no topic; give one to it or to the stream"
            )
        return self

    def topic_of(self, channel: str) -> str:
        """The topic of a channel's messages."""
        return self.channels[channel].topic or self.topic

    def format(self, name: str) -> StreamFormat:
        """What the stream carries."""
        return StreamFormat(
            name, self.sample_time, {channel: spec.unit for channel, spec in self.channels.items()}
        )


class TopicMap(BrokerMap):
    """The streams of a broker's JSON messages."""

    streams: dict[str, StreamMessages] = Field(min_length=1)

    @property
    def topics(self) -> list[str]:
        """What is subscribed to, each once."""
        return list(
            dict.fromkeys(
                stream.topic_of(name)
                for stream in self.streams.values()
                for name in stream.channels
            )
        )


def read_topic_map(path: Path) -> TopicMap:
    """The topic map of a file; BadBusDescription names file and field."""
    return read_map(path, TopicMap)


NOTHING = object()
"""What stands at a path where nothing stands."""


def value_at(content: Any, path: str) -> Any:
    """What stands at a JSON pointer; the whole for an empty one, `NOTHING` where nothing stands.

    >>> value_at({"motor": [{"speed": 2}]}, "/motor/0/speed"), value_at({"a/b": 1}, "a~1b")
    (2, 1)
    """
    for level in path.removeprefix("/").split("/") if path else ():
        name = level
        for escape, sign in _ESCAPES:
            name = name.replace(escape, sign)
        if isinstance(content, list) and name.isdecimal() and int(name[:9]) < len(content):
            content = content[int(name[:9])]
        elif isinstance(content, dict) and name in content:
            content = content[name]
        else:
            return NOTHING
    return content
