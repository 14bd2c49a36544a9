"""NodeMap: which nodes of an OPC UA server carry which channels, from a YAML file that browsing
writes.

```yaml
streams:
  process:
    sample_time: 0.1       # s; a value belongs to the sample nearest to its source time stamp
    channels:
      u: {node: "ns=2;s=process-plant.process.u", unit: V}
      y: {node: "ns=2;s=process-plant.process.y", unit: m, scale: 0.001}
      # held: reported when it changes
      setpoint: {node: "ns=2;s=process-plant.process.r", unit: m, held: true}
security:
  policy: Basic256Sha256
  mode: SignAndEncrypt
  certificate: own.der
  key: own.pem
  trusted: server.der
user: {name: residuum, password_file: password.txt}
```
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Literal

import yaml
from pydantic import Field

from residuum.service.fieldbus.can.frame_layout import BadBusDescription
from residuum.service.fieldbus.map_text import read_map
from residuum.service.fieldbus.source import StreamFormat
from residuum.service.fieldbus.strict_model import StrictModel


class ChannelNode(StrictModel):
    """The node of a channel, and how its value becomes one in this unit: value · scale + offset."""

    node: str = Field(pattern=r"^(ns=\d+;)?[isgb]=.+$")
    unit: str = ""
    scale: float = 1.0
    offset: float = 0.0
    held: bool | None = Field(
        default=None,
        description=(
            "Whether the last value holds until the next report; not said: where the channel"
            " reports by change only."
        ),
    )


class StreamNodes(StrictModel):
    """One stream: its clock and its channels."""

    sample_time: float = Field(gt=0, le=3600)
    channels: dict[str, ChannelNode] = Field(min_length=1, max_length=500)

    def format(self, name: str) -> StreamFormat:
        """What the stream carries."""
        return StreamFormat(
            name, self.sample_time, {channel: spec.unit for channel, spec in self.channels.items()}
        )


class Security(StrictModel):
    """How a session is secured: our certificate and key, and the server's certificate, which we
    trust and no other.
    """

    policy: Literal["Basic256Sha256", "Aes128Sha256RsaOaep", "Aes256Sha256RsaPss"] = (
        "Basic256Sha256"
    )
    mode: Literal["Sign", "SignAndEncrypt"] = "SignAndEncrypt"
    certificate: Path
    key: Path
    trusted: Path


class User(StrictModel):
    """Whose rights the session has."""

    name: str
    password_file: Path

    @property
    def password(self) -> str:
        """The first line of the file."""
        return self.password_file.read_text(encoding="utf-8").splitlines()[0]


class NodeMap(StrictModel):
    """Streams by name, and how the server is entered."""

    streams: dict[str, StreamNodes] = Field(min_length=1)
    security: Security | None = None
    user: User | None = None


def read_node_map(path: Path) -> NodeMap:
    """The node map of a file; BadBusDescription names file and field."""
    trust = "; `residuum opcua trust URL --out FILE` writes the server's certificate"
    # a session is opened again and again: files that are not there are told now, not each time
    nodes = read_map(path, NodeMap, lambda field: trust if field.endswith("trusted") else "")
    for file in _files(nodes):
        if not file.is_file():
            hint = (
                "; `residuum opcua trust URL --out FILE` writes a server's"
                if nodes.security and file == nodes.security.trusted
                else ""
            )
            raise BadBusDescription(f"{path}: file {str(file)!r} is not there{hint}")
    return nodes


def _files(nodes: NodeMap) -> list[Path]:
    secured = (
        [nodes.security.certificate, nodes.security.key, nodes.security.trusted]
        if nodes.security
        else []
    )
    return [*secured, *([nodes.user.password_file] if nodes.user else [])]


def node_map_text(streams: Mapping[str, tuple[float, Mapping[str, ChannelNode]]]) -> str:
    """The file of streams: name → (sample time [s], channels)."""
    plain = {
        name: {
            "sample_time": every,
            "channels": {
                c: {"unit": "", **spec.model_dump(exclude_unset=True)}
                for c, spec in channels.items()
            },
        }
        for name, (every, channels) in streams.items()
    }
    return yaml.safe_dump({"streams": plain}, allow_unicode=True, sort_keys=False)
