"""The pipeline on real sockets: machines at twice real time, faults switched over the bus, a dead device, a killed worker."""

import asyncio
import contextlib
import os
import signal
import threading
import time
from pathlib import Path

import httpx
import pytest

from residuum.service.cli import run as run_command
from residuum.service.fieldbus.settings import MachineSettings, SourceSettings, WindowSettings
from residuum.service.simulated.demo import DIAGNOSER_OF
from residuum.service.simulated.device import Device
from residuum.service.simulated.wiring import wiring_of
from residuum.service.work.worker_pool import WorkerPool
from residuum.simulation import MACHINES

SPEED = 2.0  # all of it runs in this process: faster, and a busy machine loses pages that the devices do not keep


@contextlib.contextmanager
def living(device, channel=None, port=None):
    """A simulated machine on its buses, in a thread."""
    ready, handles = threading.Event(), []
    wiring = wiring_of(device)
    machine = MACHINES[wiring.machine](seed=5)
    modbus = None if port is None else ("127.0.0.1", port)
    simulated = Device(machine, wiring, channel, modbus, SPEED, pytest.fail)

    async def live():
        stopped = asyncio.Event()
        handles.extend([asyncio.get_running_loop(), stopped])
        await simulated.run(stopped, lambda _: ready.set())

    thread = threading.Thread(target=asyncio.run, args=(live(),), daemon=True)
    thread.start()
    assert ready.wait(120)
    try:
        yield machine
    finally:
        handles[0].call_soon_threadsafe(handles[1].set)
        thread.join(120)


def wait_for(condition, seconds=120.0):
    end = time.monotonic() + seconds
    while not condition() and time.monotonic() < end:
        time.sleep(0.1)
    assert condition()


# seconds; the plant's diagnoser judges no shorter windows
def watch(asset, cut, *sources, length=15):
    window = WindowSettings(cut=cut, length=length, step=5)
    return MachineSettings(
        asset=asset, diagnoser=DIAGNOSER_OF[asset], window=window, sources=list(sources)
    ).model_dump()


def verdicts(service, asset):
    return [
        finding.finding.verdict.value for finding in service.services.store.findings(asset).items
    ]


def test_a_fault_switched_over_the_bus_is_found_and_gone_after_it_is_cleared(
    run_service, free_port, free_channel, capsys, demo_baseline
):
    plant, vibration, signals = free_port(), free_channel(), free_port()
    service = run_service(
        machines=[
            watch(
                "process-plant",
                "sliding",
                SourceSettings(kind="modbus", port=plant, map="process_plant.yaml"),
            ),
            watch(
                "gripping-pliers",
                "round",
                SourceSettings(kind="can", channel=vibration, map="gripping_pliers.dbc"),
                SourceSettings(kind="modbus", port=signals, map="gripping_pliers.yaml"),
            ),
        ]
    )
    for asset in ("process-plant", "gripping-pliers"):
        service.services.store.add_model_version(
            asset, "baseline", demo_baseline(asset).read_bytes()
        )
    with (
        living("process-plant", port=plant) as machine,
        living("gripping-pliers", vibration, signals),
    ):
        wait_for(
            lambda: all(
                len(verdicts(service, asset)) >= 2 for asset in ("process-plant", "gripping-pliers")
            )
        )
        for asset, fault in (
            ("process-plant", "sensor-offset:20"),
            ("gripping-pliers", "plier-bearing"),
        ):
            assert "faulty" not in verdicts(service, asset)
            wait_for(
                lambda asset=asset, fault=fault: (
                    run_command(["fault", asset, fault, "--url", service.url]) == 0
                )
            )
        assert "switched on" in capsys.readouterr().out
        wait_for(lambda: machine.active_faults == {"sensor-offset": 20.0})
        wait_for(
            lambda: all(
                verdicts(service, asset)[0] == "faulty"
                for asset in ("process-plant", "gripping-pliers")
            )
        )
        wait_for(lambda: _on(service, "process-plant") == {"sensor-offset": 20.0})
        for asset in ("process-plant", "gripping-pliers"):
            wait_for(
                lambda asset=asset: (
                    run_command(["fault", asset, "--clear", "--url", service.url]) == 0
                )
            )
        wait_for(
            lambda: all(
                verdicts(service, asset)[0] == "healthy"
                for asset in ("process-plant", "gripping-pliers")
            )
        )


def _on(service, machine):
    answer = httpx.get(f"{service.url}/api/v1/demo/machines/{machine}/fault", timeout=60).json()
    return {fault["id"]: fault["size"] for fault in answer["faults"] if fault["on"]}


def test_a_dead_device_never_stops_the_others_and_comes_back(run_service, free_port, demo_baseline):
    dead, alive = free_port(), free_port()
    source = {"kind": "modbus", "map": "process_plant.yaml"}
    # whatever is found
    machines = [watch("process-plant", "sliding", SourceSettings(port=alive, **source), length=10)]
    machines.append(
        machines[0]
        | {
            "asset": "second-plant",
            "sources": [source | {"port": dead}],
            "baseline": "process-plant",
        }
    )
    service = run_service(machines=machines)
    service.services.store.add_model_version(
        "process-plant", "baseline", demo_baseline("process-plant").read_bytes()
    )
    with living("process-plant", port=alive):
        wait_for(lambda: len(verdicts(service, "process-plant")) >= 2)
        states = service.services.pipeline.status()["sources"]
        assert states[f"second-plant modbus:127.0.0.1:{dead}"]["quality"] == "never-seen"
        assert states[f"second-plant modbus:127.0.0.1:{dead}"]["counters"]["bus_errors"] > 0
        with living("process-plant", port=dead):
            wait_for(lambda: len(verdicts(service, "second-plant")) >= 1)
        wait_for(
            lambda: (
                service.services.pipeline.status()["sources"][
                    f"second-plant modbus:127.0.0.1:{dead}"
                ]["quality"]
                == "stale"
            )
        )
        count = len(verdicts(service, "process-plant"))
        wait_for(lambda: len(verdicts(service, "process-plant")) > count)


def test_bad_orders_are_refused_with_one_line(run_service, free_port, capsys):
    service = run_service(
        machines=[
            watch(
                "process-plant",
                "sliding",
                SourceSettings(kind="modbus", port=1, map="process_plant.yaml"),
            )
        ]
    )
    for words, says in (
        (["nobody", "sensor-offset"], "there is none of this name"),
        (["process-plant", "no-such-fault"], "has no fault"),
        (["process-plant", "sensor-offset:much"], "is not a number"),
        (["process-plant", "sensor-offset"], "cannot switch"),
    ):
        assert run_command(["fault", *words, "--url", service.url]) == 2
        # The service of this process logs beside what the command says.
        told = [line for line in capsys.readouterr().err.splitlines() if "residuum: " in line]
        assert len(told) == 1 and says in told[0]
    assert run_command(["fault", "process-plant", "--url", f"http://127.0.0.1:{free_port()}"]) == 2


def test_a_killed_worker_is_replaced_and_its_work_done_again(tmp_path):
    pool = WorkerPool(1)
    try:
        first = pool.call(os.getpid)
        os.kill(first, signal.SIGKILL)
        assert pool.call(os.getpid) != first
        assert pool.replaced == 1
        marker = tmp_path / "once"
        assert pool.call(_die_once, str(marker)) == "done"
        assert pool.replaced == 2
        assert pool.begin(_die_once, str(tmp_path / "begun once"))() == "done"
        assert pool.replaced == 3
    finally:
        pool.shutdown()


def _die_once(marker):
    if not os.path.exists(marker):
        Path(marker).touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return "done"
