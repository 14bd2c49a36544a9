"""Recorded bus traffic, replayed onto real buses: the same findings each time, and the same as the REST interface gives."""

import asyncio
import threading
import time
from pathlib import Path

import httpx
import pytest

from residuum.identification.record_formats import write_record
from residuum.service.fieldbus.can.can_bus import open_bus
from residuum.service.fieldbus.can.can_log import read_can_log
from residuum.service.fieldbus.modbus.register_trace import read_trace
from residuum.service.fieldbus.replay import replay_to_can, replay_to_modbus
from residuum.service.fieldbus.settings import MachineSettings, SourceSettings, WindowSettings
from residuum.service.simulated.demo import DIAGNOSER_OF

RECORDED = Path(__file__).parents[1] / "recorded"
CUT = {"gate-actuator": "movement", "gripping-pliers": "round", "process-plant": "sliding"}
CASES = [
    ("gate-actuator", "gate_actuator.blf", 1.0, ["healthy", "faulty"]),
    ("gripping-pliers", "gripping_pliers.blf", 1.0, ["healthy"] * 3 + ["faulty"] * 3),
    ("process-plant", "process_plant.trace", 20.0, ["healthy"] * 3 + ["faulty"] * 7),
]


@pytest.fixture
def watched(free_port, free_channel):
    """Gives settings that watch a replay of a machine as `asset`, on a bus of its own."""

    def settings(machine, asset, dbc):
        if dbc:
            source = SourceSettings(kind="can", channel=free_channel(), map=dbc)
        else:
            source = SourceSettings(kind="modbus", port=free_port(), map="process_plant.yaml")
        window = WindowSettings(cut=CUT[machine], length=30, step=10)
        return MachineSettings(
            asset=asset,
            diagnoser=DIAGNOSER_OF[machine],
            window=window,
            sources=[source],
            baseline=machine,
        )

    return settings


def replay(file, source, speed):
    if source.kind == "can":
        bus = open_bus(source.channel)
        replay_to_can(read_can_log(file).frames, bus, speed)
        bus.close()
    else:
        registers, pages = read_trace(file)
        asyncio.run(
            replay_to_modbus(registers, pages, (source.host, source.port), speed, linger=2.0)
        )


def wait_for(condition, seconds=120.0):
    end = time.monotonic() + seconds
    while not condition() and time.monotonic() < end:
        time.sleep(0.1)
    assert condition()


def plain(finding):
    return {
        key: value
        for key, value in finding.to_json().items()
        if key not in ("id", "asset", "window", "at")
    }


@pytest.mark.parametrize(
    ("machine", "name", "speed", "expected"), CASES, ids=[case[0] for case in CASES]
)
def test_replays_agree_with_each_other_and_with_rest(
    run_service, watched, tmp_path, demo_baseline, machine, name, speed, expected
):
    dbc = f"{Path(name).stem}.dbc" if name.endswith(".blf") else None
    twice = [watched(machine, f"{machine}-{k}", dbc) for k in (1, 2)]
    service = run_service(machines=[settings.model_dump() for settings in twice])
    store, pipeline = service.services.store, service.services.pipeline
    store.add_model_version(machine, "baseline", demo_baseline(machine).read_bytes())
    wait_for(
        lambda: all(state["state"] == "waiting" for state in pipeline.status()["machines"].values())
    )
    threads = [
        threading.Thread(target=replay, args=(RECORDED / name, watch.sources[0], speed))
        for watch in twice
    ]
    for thread in threads:
        thread.start()
        thread.join()
    wait_for(
        lambda: all(
            state["windows_judged"] >= len(expected)
            for state in pipeline.status()["machines"].values()
        )
    )
    findings = [list(reversed(store.findings(watch.asset).items)) for watch in twice]
    assert [plain(finding) for finding in findings[0]] == [
        plain(finding) for finding in findings[1]
    ]
    found = [finding.finding.verdict.value for finding in findings[0]]
    assert found[: expected.count("healthy")] == ["healthy"] * expected.count("healthy")
    assert found[-1] == "faulty"
    for source in pipeline.status()["sources"].values():
        # a replayed device comes late and goes early
        about_the_connection = ("bus_errors", "reconnects", "timeouts")
        assert {
            name: n
            for name, n in source["counters"].items()
            if n and name not in about_the_connection
        } == {}
    for finding in (findings[0][0], findings[0][-1]):
        file = tmp_path / "window.npz"
        write_record(store.window_record(twice[0].asset, finding.window), file)
        address = f"{service.url}/api/v1/score/{twice[0].diagnoser}?baseline={machine}"
        answer = httpx.post(
            address,
            content=file.read_bytes(),
            headers={"Content-Type": "application/zip"},
            timeout=60,
        )
        assert answer.status_code == 200, answer.text
        assert answer.json() == plain(finding)
