"""SourceKind: all that the service, its commands and its page know of a kind of source."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, Protocol

from residuum.service.broker import BrokerAddress, broker_address, try_connection
from residuum.service.fieldbus.can.frame_layout import BadBusDescription
from residuum.service.fieldbus.source import Sink, Source, StreamFormat


class Address(Protocol):
    """How a source is reached: `SourceSettings`, which takes its kinds from `SOURCES`."""

    @property
    def channel(self) -> str:
        """Address of the bus."""

    @property
    def host(self) -> str:
        """Address of the device."""

    @property
    def port(self) -> int:
        """Port of the device."""

    @property
    def map(self) -> str:
        """What its map is called."""

    @property
    def map_file(self) -> Path:
        """What says which channels there are."""


class Wrong(Exception):
    """A look found something wrong; the message is one line that says what."""


Told = str | tuple[str, str]
"""What a look tells, with or without a remark."""


@dataclass(frozen=True)
class BusText:
    """A kind of text that describes what a source reads.

    Parameters
    ----------
    called : str
        In a sentence: `a DBC file`.
    read : callable
        From a file: its streams, and what is to be said of it.
    ending : str
        Of such a file.
    made : callable or None
        Of a text from which a map is made: text, sample time [s], name, unit → that map's text.
    """

    called: str
    read: Callable[[Path], tuple[Sequence[StreamFormat], Sequence[str]]]
    ending: str = ".yaml"
    made: Callable[[str, float, str, int], str] | None = None


@dataclass(frozen=True)
class SourceKind:
    """One kind of source; called with settings and a sink, it opens one.

    Parameters
    ----------
    called : str
        How people call it.
    open : callable
        Raises BadBusDescription where its map, its address or its library will not do.
    map_called : str
        Its map, with whose it is: `node map (OPC UA)`.
    asked : str
        What is asked for where a settings file is begun.
    example : str
        An address.
    texts : mapping of name to BusText
        What may be sent as its description.
    check : callable
        ValueError, with an example, for settings that are no address of this kind.
    look : callable or None
        What `residuum doctor` tries within so many seconds; raises Wrong or OSError. None: what its
        map says is told alone.
    by_host : bool
        Whether a host and a port are its address, not a channel.
    reached : callable
        The settings of an address as it is written on a command line; ValueError for none.
    sent : callable
        The channel of a machine that somebody adds over HTTP, given the folder of growing files;
        raises BadBusDescription where that would reach what may not be reached so.
    template : (str, str)
        Its line in a settings file to fill in, and what is said beside it.
    """

    called: str
    open: Callable[[Address, Sink], Source]
    map_called: str
    asked: str
    example: str
    texts: Mapping[str, BusText]
    check: Callable[[Address], None] = lambda _address: None
    look: Callable[[Address, float], Told] | None = None
    by_host: bool = False
    reached: Callable[[str], Mapping[str, Any]] = lambda where: {"channel": where}
    sent: Callable[[str, Path | None], str] = lambda channel, _folder: channel
    template: tuple[str, str] = ("", "")

    def __call__(self, settings: Address, sink: Sink) -> Source:
        """Open a source of this kind."""
        return self.open(settings, sink)


def of_extra(module: str, called: str, extra: str) -> Any:
    """The module of a source whose library is an extra, imported when one is opened;
    BadBusDescription where it is not installed.
    """
    try:
        return import_module(module)
    except ModuleNotFoundError:
        raise BadBusDescription(
            f"{called} needs the extra `{extra}`: pip install 'residuum[{extra}]'"
        ) from None


def text_of_map(called: str, read: Callable[[Path], Any]) -> BusText:
    """The text of a map in YAML with `streams`."""
    return BusText(called, lambda file: streams_of_map(read(file).streams))


def streams_of_map(streams: Mapping[str, Any]) -> tuple[list[StreamFormat], list[str]]:
    """The streams of a map, and what is to be said of them."""
    slow = [name for name, stream in streams.items() if getattr(stream, "poll", None)]
    polled = [f"stream {name} is polled: a read that comes late leaves a hole" for name in slow]
    formats = [stream.format(name) for name, stream in streams.items()]
    bare = [name for format in formats for name, unit in format.units.items() if not unit]
    says = (
        f"no unit is said for {', '.join(bare)}: a model takes a signal with a unit only where it"
        " is said"
    )
    return formats, [*polled, *([says] if bare else [])]


def streams_alone(kind: SourceKind, source: Address) -> Told:
    """What is told of a kind without a look of its own: what its map says, without a connection."""
    streams = kind(source, lambda _block: True).streams
    names = ", ".join(stream.name for stream in streams)
    return f"{source.map} streams {names}", "whether it answers was not tried"


def broker_look(source: Address, entered: Callable[[str], BrokerAddress], says: str) -> str:
    """Whether a source's broker lets us in."""
    broker = entered(source.channel)
    where = f"{broker.host}:{broker.port}"
    try:
        try_connection(broker)
    except OSError as error:
        raise Wrong(f"{where}: {error}") from None
    return f"{where} lets us in; {source.map} has {says}"


def check_broker(source: Address) -> None:
    """ValueError for a channel that is no broker's address."""
    broker_address(source.channel)
