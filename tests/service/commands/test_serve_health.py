"""A training that fails and a machine that gives nothing are told where somebody looks: health, status, metrics, log."""

import contextlib
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import httpx
import yaml

COMMAND = [
    sys.executable,
    "-c",
    "from residuum.service.cli import main; main()",
    "serve",
    "--demo",
    "--port",
    "0",
]
PATIENCE = 240.0


def wait_for(look):
    """What `look` finds, once it finds something."""
    end = time.monotonic() + PATIENCE
    while True:
        with contextlib.suppress(httpx.HTTPError):
            if found := look():
                return found
        assert time.monotonic() < end, "it did not come"
        time.sleep(0.2)


def test_what_is_not_judged_is_told_by_machine_with_its_reason_and_the_way_on(tmp_path, free_port):
    silent = {"kind": "modbus", "port": free_port(), "map": "process_plant.yaml"}
    machine = {
        "asset": "press",
        "diagnoser": "robust-residual",
        "window": {"cut": "sliding", "length": 1},
        "sources": [silent],
    }
    settings, log = tmp_path / "settings.yaml", tmp_path / "log"
    settings.write_text(yaml.safe_dump({"machines": [machine]}))
    with (
        # processes meet at sockets in it, whose names may have 107 bytes
        tempfile.TemporaryDirectory(dir="/tmp") as folder,
        log.open("w") as written,
        subprocess.Popen(
            [*COMMAND, "--data", str(tmp_path / "data"), "--settings", str(settings)],
            env=os.environ | {"TMPDIR": folder},
            stdout=subprocess.PIPE,
            stderr=written,
            text=True,
        ) as service,
    ):
        try:
            (training,) = wait_for(lambda: list(Path(folder).glob("residuum-training-*")))
            shutil.rmtree(training)  # where the trainings write: each of them fails
            address = service.stdout.readline().split()[-1]
            with httpx.Client(base_url=address, timeout=60) as client:

                def troubled():
                    told = client.get("health/ready").json()
                    return len(told["machines"]) == 4 and told

                told = wait_for(troubled)
                assert (
                    client.get("health/ready").status_code == 200 and told["status"] == "degraded"
                )
                assert told["states"]["failed"] == 3 and told["states"]["running"] == 0
                plant, press = told["machines"]["process-plant"], told["machines"]["press"]
                assert plant["state"] == "failed" and plant["reason"].startswith(
                    "training failed: FileNotFoundError"
                )
                assert "start it again" in plant["way_on"]
                assert (
                    press["state"] == "recording"
                    and f":{silent['port']}" in press["reason"]
                    and "bus" in press["way_on"]
                )
                status = client.get("api/v1/status").json()["machines"]
                assert {name: status[name]["way_on"] for name in told["machines"]} == {
                    name: machine["way_on"] for name, machine in told["machines"].items()
                }
                assert 'residuum_machines{state="failed"} 3.0' in client.get("metrics").text

                def logged():
                    told = [
                        line
                        for line in log.read_text().splitlines()
                        if "a machine is not judged" in line
                    ]
                    return any("[error" in line and "machine=press" in line for line in told)

                wait_for(logged)
        finally:
            service.send_signal(signal.SIGINT)
        assert service.wait(60) in (0, 130)
    lines = log.read_text().splitlines()
    failed = [
        line
        for line in lines
        if "training failed" in line and "[error" in line and "is not judged" not in line
    ]
    (line,) = [line for line in failed if "process-plant" in line and "way_on" in line]
    assert "FileNotFoundError" in line
