"""The demo's start: its machines are read once they are on their buses."""

import asyncio
import contextlib
import time

import pytest


def test_no_start_of_the_demo_counts_a_device_that_is_not_there_yet(run_service):
    service = run_service(demo=True)
    end = time.monotonic() + 300
    while True:
        sources = service.services.pipeline.status()["sources"]
        # a busy machine polls late
        if all(source["quality"] in ("good", "losing") for source in sources.values()):
            break
        assert time.monotonic() < end, {name: source["quality"] for name, source in sources.items()}
        time.sleep(0.2)
    assert len(sources) == 4
    for source in sources.values():
        assert source["counters"]["bus_errors"] == 0, source


def test_the_process_plant_of_the_demo_is_on_opc_ua_beside_modbus(run_service, free_port):
    opcua = pytest.importorskip(
        "residuum.service.fieldbus.opcua.opcua_source", reason="the extra 'opcua' is not installed"
    )
    url = f"opc.tcp://127.0.0.1:{free_port()}/"
    service = run_service(demo=True, demo_opcua=url)
    end, found = time.monotonic() + 300, {}
    while not found and time.monotonic() < end:
        with contextlib.suppress(OSError, TimeoutError, ConnectionError):
            found = asyncio.run(opcua.numeric_variables(url, None, "ns=2;s=process", 5.0))
        time.sleep(0.2)
    assert {name.rsplit(".")[-1] for name in found} >= {"u", "y"}
    sources = service.services.pipeline.status()["sources"]
    assert any(
        name.startswith("modbus") for name in (source.split(" ", 1)[-1] for source in sources)
    )
