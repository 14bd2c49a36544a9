"""MetricMap: which metrics of a Sparkplug edge node carry which channels, from a YAML file that
browsing writes.

```yaml
node: Plant1/Press-7                # group/edge node
streams:
  signals:
    device: Drive                   # left out: metrics of the node itself
    sample_time: 0.1                # s; a value belongs to the sample nearest to its time stamp
    # or `changes`: what a message does not name has not changed since the one before
    reports: samples
    channels:
      speed: {metric: Motor/Speed, unit: rpm}
      force: {metric: Motor/Force, unit: N, scale: 1000}
# for a broker at mqtts://, as far as it needs them
tls: {ca: ca.pem, certificate: own.pem, key: own.key}
```
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Literal

import yaml
from pydantic import Field

from residuum.service.fieldbus.broker_map import BrokerMap
from residuum.service.fieldbus.map_text import read_map
from residuum.service.fieldbus.source import StreamFormat
from residuum.service.fieldbus.strict_model import StrictModel

NAME = r"[^/+#]+"


class ChannelMetric(StrictModel):
    """The metric of a channel, and how its value becomes one in this unit: value · scale +
    offset.
    """

    metric: str = Field(min_length=1)
    unit: str = ""
    scale: float = 1.0
    offset: float = 0.0


class StreamMetrics(StrictModel):
    """One stream: its device, its clock, its channels, and whether a message has every value or
    those that changed.
    """

    device: str = Field("", pattern=rf"^({NAME})?$")
    sample_time: float = Field(gt=0, le=3600)
    reports: Literal["samples", "changes"] = "samples"
    channels: dict[str, ChannelMetric] = Field(min_length=1, max_length=500)

    def format(self, name: str) -> StreamFormat:
        """What the stream carries."""
        return StreamFormat(
            name, self.sample_time, {channel: spec.unit for channel, spec in self.channels.items()}
        )


class MetricMap(BrokerMap):
    """An edge node and the streams of its metrics."""

    node: str = Field(pattern=rf"^{NAME}/{NAME}$")
    streams: dict[str, StreamMetrics] = Field(min_length=1)

    @property
    def group(self) -> str:
        """The node's group."""
        return self.node.split("/")[0]

    @property
    def edge_node(self) -> str:
        """The node's name in its group."""
        return self.node.split("/")[1]


def read_metric_map(path: Path) -> MetricMap:
    """The metric map of a file; BadBusDescription names file and field."""
    return read_map(path, MetricMap)


def metric_map_text(
    node: str, every: float, devices: Mapping[str, Mapping[str, tuple[str, str]]]
) -> str:
    """The file of a node: device → channel → (metric, unit); a stream a device."""
    # `reports` stands in the file although it is the default: whoever edits it sees what to change
    streams = {
        device or "node": {
            **({"device": device} if device else {}),
            "sample_time": every,
            "reports": "samples",
            "channels": {
                name: {"metric": metric, "unit": unit} for name, (metric, unit) in channels.items()
            },
        }
        for device, channels in devices.items()
    }
    return yaml.safe_dump({"node": node, "streams": streams}, allow_unicode=True, sort_keys=False)
