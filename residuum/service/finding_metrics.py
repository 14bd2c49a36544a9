"""FindingMetrics: the latest finding and alarm of every machine as metrics of a Sparkplug B edge
node of our own.

A machine `press-1` is the device `press-1` with the metrics `verdict`, `class`, `reason`,
`indicator/NAME` and, once it has had one, `alarm`. Nothing is written back: the only command that
is answered asks for the births.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from datetime import datetime
from typing import Any

from residuum.service.broker import BrokerAddress
from residuum.service.fieldbus.sparkplug.edge_node import EdgeNode


class FindingMetrics:
    """Publishes while the broker is there; what it missed, the births of the next connection say.

    Parameters
    ----------
    address : BrokerAddress
    node : str
        `GROUP/NODE`.
    """

    def __init__(self, address: BrokerAddress, node: str) -> None:
        self._node = EdgeNode(address, node)

    def start(self) -> None:
        """Connect, now or when the broker is there."""
        self._node.start()

    def stop(self) -> None:
        """Tell the node's death and leave."""
        self._node.stop()

    def tell(self, kind: str, payload: Mapping[str, Any]) -> None:
        """A finding or an alarm that has been stored; anything else is left."""
        if kind == "alarm":
            self._node.write(str(payload["asset"]), {"alarm": str(payload["state"])}, time.time())
        elif kind == "finding":
            texts = {name: str(payload.get(name) or "") for name in ("verdict", "class", "reason")}
            numbers = {
                f"indicator/{name}": float(value)
                for name, value in (payload.get("indicators") or {}).items()
                if isinstance(value, int | float)
            }
            at = payload["at"]
            self._node.write(
                str(payload["asset"]),
                texts | numbers,
                at.timestamp() if isinstance(at, datetime) else time.time(),
            )
