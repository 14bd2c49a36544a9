"""Findings offered as nodes, and a simulated machine that offers itself over OPC UA."""

import asyncio
import contextlib
import gc
import socket
import threading
import time
from datetime import UTC, datetime

import numpy as np
import pytest

pytest.importorskip("asyncua")
from asyncua import Client
from asyncua.ua import UaError

from residuum.service.fieldbus.opcua.node_map import NodeMap
from residuum.service.fieldbus.opcua.opcua_source import OpcuaSource
from residuum.service.finding_nodes import FindingNodes
from residuum.service.simulated.device import Device
from residuum.service.simulated.wiring import wiring_of
from residuum.simulation import MACHINES


@pytest.fixture(autouse=True)
def nothing_left():
    """What a loop leaves is collected here, not in the middle of another test."""
    yield
    gc.collect()


def address():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"opc.tcp://127.0.0.1:{probe.getsockname()[1]}/"


async def values(url, *nodes):
    async with Client(url) as client:
        return [await client.get_node(f"ns=2;s={node}").read_data_value() for node in nodes]


def test_the_latest_finding_is_offered():
    url, at = address(), datetime(2026, 11, 25, 1, 2, 3, tzinfo=UTC)
    nodes = FindingNodes(url)
    nodes.start()
    finding = {"asset": "press-1", "at": at, "verdict": "faulty", "class": "wear", "reason": "why", "indicators": {"glr": 14.5}}
    nodes.tell("finding", finding | {"verdict": "healthy"})
    nodes.tell("finding", finding)
    nodes.tell("alarm", {"asset": "press-1", "state": "active", "raised_at": at})
    nodes.tell("model", {})
    end, found = time.monotonic() + 60, []
    while [each.Value.Value for each in found[2:]] != ["active"] and time.monotonic() < end:
        with contextlib.suppress(UaError):  # a node is made with its first value
            found = asyncio.run(values(url, "press-1.verdict", "press-1.indicator.glr", "press-1.alarm"))
    verdict, glr, alarm = found
    assert (verdict.Value.Value, glr.Value.Value, alarm.Value.Value) == ("faulty", 14.5, "active")
    assert verdict.SourceTimestamp.replace(tzinfo=UTC) == at
    with pytest.raises(OSError, match="OPC UA server at"):
        FindingNodes(url).start()
    nodes.stop()


def test_a_simulated_machine_is_read_over_opc_ua():
    url = address()
    device = Device(MACHINES["process"](seed=1, exemplar=0), wiring_of("process-plant"), None, None, 1.0, print, url)
    loop, stopped = asyncio.new_event_loop(), asyncio.Event()
    thread = threading.Thread(target=lambda: loop.run_until_complete(device.run(stopped, lambda port: None)), daemon=True)
    thread.start()
    channels = {n: {"node": f"ns=2;s=process.signals.{n}"} for n in ("u", "y")}
    blocks, nodes = [], NodeMap.model_validate({"streams": {"s": {"sample_time": 0.1, "channels": channels}}})
    source = OpcuaSource(url, nodes, lambda b: blocks.append(b) or True)
    source.start()
    end = time.monotonic() + 60
    while sum(b.n for b in blocks) < 20 and time.monotonic() < end:
        time.sleep(0.05)
    source.stop()
    source.join()
    loop.call_soon_threadsafe(stopped.set)
    thread.join(20)
    loop.close()
    y = np.concatenate([b.channels["y"] for b in blocks])
    assert len(y) >= 20 and np.isfinite(y).mean() > 0.8
