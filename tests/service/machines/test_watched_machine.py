"""A stranger's device, a process of its own: added to the running service, recorded, trained, judged; and kept."""

import subprocess
import sys
import time
from pathlib import Path

import httpx
import pytest

RIG = Path(__file__).parents[3] / "docs" / "tutorials" / "fan_rig"
SPEED = 10.0


@pytest.fixture
def fan_rig(free_port, free_channel):
    """The fan rig of the tutorial; gives the process, its CAN channel and its Modbus port."""
    channel, port = free_channel(), free_port()
    address = channel.removeprefix("udp_multicast:").removesuffix("/0")
    command = [
        sys.executable,
        str(RIG / "fan_rig.py"),
        "--can",
        address,
        "--modbus",
        str(port),
        "--speed",
        str(SPEED),
    ]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as rig:
        assert rig.stdout.readline() == "The fan turns.\n"
        yield rig, channel, port
        rig.stdin.close()
        rig.terminate()


def order(rig, text):
    rig.stdin.write(text + "\n")
    rig.stdin.flush()


def wait_for(condition, seconds=120.0):
    end = time.monotonic() + seconds
    while not (found := condition()):
        assert time.monotonic() < end
        time.sleep(0.2)
    return found


def fan_on(channel, **more):
    return {
        "diagnoser": "model-based",
        "window": {"cut": "sliding", "length": 10, "step": 10},
        "sources": [{"kind": "can", "channel": channel, "map": "fan.dbc"}],
        "channels": {"voltage": "u_mot", "current": "i_mot", "speed": "n_fan"},
        "model": "fan",
        "maps": {"fan.dbc": (RIG / "fan.dbc").read_text(encoding="utf-8")},
    } | more


def done(client, answer):
    assert answer.status_code == 202, answer.text
    address = answer.headers["Location"].removeprefix("/api/v1")
    job = wait_for(
        lambda: (j := client.get(address).json())["state"] not in ("queued", "running") and j, 300
    )
    assert job["state"] == "done", job["error"]
    return job["result"]


def test_a_stranger_s_fan_is_recorded_trained_and_watched(run_service, fan_rig):
    rig, channel, _ = fan_rig
    service = run_service()
    with httpx.Client(base_url=f"{service.url}/api/v1", timeout=60) as client:
        text = (RIG / "fan.yaml").read_bytes()
        assert client.post("/models", params={"name": "fan"}, content=text).status_code == 201
        assert client.put("/assets/fan/machine", json=fan_on(channel)).status_code == 200
        live = wait_for(lambda: client.get("/assets/fan/live").json()["signals"])
        assert (
            live["n_fan"]["unit"] == "rpm"
            and live["n_fan"]["name"] == "speed"
            and 100 < live["n_fan"]["value"] < 4000
        )
        seen = wait_for(
            lambda: (
                (m := client.get("/assets/fan/machine").json())["status"]["state"] == "recording"
                and m
            )
        )
        assert seen["baseline"] is False and "residuum watch train fan" in seen["status"]["doing"]
        wait_for(lambda: len(client.get("/assets/fan/machine").json()["recorded_windows"]) >= 12)
        asset = client.get("/assets/fan").json()
        assert asset["state"] == "no-baseline" and client.get("/alarms").json()["items"] == []
        found = done(client, client.post("/assets/fan/training", json={}))
        assert found["windows"] >= 12 and found["alarms"] == 0
        wait_for(lambda: client.get("/assets/fan").json()["state"] == "healthy")
        order(rig, "offset 200")
        wait_for(
            lambda: (
                (now := client.get("/assets/fan").json())["state"] == "faulty"
                and now["last_finding"]
            )
        )
        # the window in the midst of which it came may look like a disturbance
        wait_for(
            lambda: (client.get("/assets/fan").json()["last_finding"]["class"] or "").startswith(
                "sensor"
            )
        )
        assert client.get("/alarms").json()["items"][0]["kind"] == "machine"


def test_a_machine_that_was_added_is_watched_again_after_a_restart_until_it_is_removed(
    run_service, fan_rig
):
    _, channel, port = fan_rig
    service = run_service()
    table = {
        "kind": "table",
        "name": "fan",
        "text": (RIG / "registers.csv").read_text(),
        "sample_time": 0.05,
    }
    made = httpx.post(f"{service.url}/api/v1/bus-descriptions", json=table, timeout=60).json()
    assert made["streams"][0]["channels"] == {
        "u_mot": "V",
        "i_mot": "A",
        "n_fan": "rpm",
        "t_mot": "degC",
    }
    source = {"kind": "modbus", "host": "127.0.0.1", "port": port, "map": made["name"]}
    asked = fan_on(
        channel, sources=[source], maps={made["name"]: made["text"]}, model=None, channels={}
    )
    address = f"{service.url}/api/v1/assets/fan/machine"
    assert httpx.put(address, json=asked, timeout=60).status_code == 200
    service.stop()
    service.start()
    signals = wait_for(
        lambda: httpx.get(f"{service.url}/api/v1/assets/fan/live", timeout=60).json()["signals"]
    )
    assert 2.5 < signals["u_mot"]["value"] < 12.5 and 15 < signals["t_mot"]["value"] < 90
    assert httpx.delete(address, timeout=60).status_code == 204
    service.stop()
    service.start()
    assert httpx.get(address, timeout=60).status_code == 404
