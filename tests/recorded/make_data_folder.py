"""Makes `data-folder-0.1.0.tar.gz`: what a service of version 0.1.0 left on disk, and what it answered about it.

Run once with the code of that version (commit f63ac5c) and committed:

    git worktree add /tmp/0.1.0 f63ac5c
    PYTHONPATH=/tmp/0.1.0 python tests/recorded/make_data_folder.py
"""

import io
import json
import subprocess
import sys
import tarfile
import tempfile
from pathlib import Path

import httpx
import numpy as np

import residuum as rs

HERE = Path(__file__).parent
COMMAND = [
    sys.executable,
    "-c",
    "from residuum.service.cli import main; main()",
    "serve",
    "--port",
    "0",
    "--data",
]
ASKED = (
    "assets?limit=100", "assets/press", "assets/press/findings", "assets/press/indicators",
    "assets/press/limits", "assets/press/windows", "assets/press/windows/1", "assets/plant/method",
    "alarms?active=false", "alarms/1",
    "audit", "records", "records/1", "models", "models/axis/versions", "assets/plant/machine",
)  # fmt: skip


def fill(client):
    """Windows of a healthy and of a shaken press, an alarm with a note, a record, a model in two versions, a watched plant."""
    client.put("assets/press", json={"title": "Press 4", "diagnoser": "bearing"}).raise_for_status()
    rng = np.random.default_rng(4)
    for number, knocks in enumerate((0.0, 0.0, 40.0)):
        at = np.arange(4096) / 4096
        vibration = rng.normal(size=at.size) + knocks * (rng.random(at.size) < 0.005)
        columns = "".join(
            f"{time:.6f},{value:.4f},1500\n" for time, value in zip(at, vibration, strict=True)
        )
        answer = client.post(
            "assets/press/windows?diagnoser=bearing",
            content=f"time [s],vibration [m/s^2],speed [rpm]\n{columns}".encode(),
            headers={"Content-Type": "text/csv", "Idempotency-Key": f"window-{number}"},
        )
        answer.raise_for_status()
    client.post("alarms/1/acknowledge", json={"comment": "seen by night shift"}).raise_for_status()
    client.put("assets/press/limits", json={"limits": {"clearance": 0.4}}).raise_for_status()
    record = b"time [s],voltage [V]\n0,1\n0.1,\n0.2,3\n"
    client.post("records?filename=a.csv", content=record).raise_for_status()
    for note in ("first", "second"):
        client.post(
            f"models?name=axis&note={note}", content=rs.model("gate-drive").text.encode()
        ).raise_for_status()
    machine = {
        "diagnoser": "robust-residual",
        "window": {"cut": "sliding"},
        "sources": [
            {"kind": "modbus", "host": "127.0.0.1", "port": 9, "map": "process_plant.yaml"}
        ],
    }
    client.put("assets/plant/machine", json=machine).raise_for_status()
    client.put("assets/plant/method", json={"method": "source"}).raise_for_status()


def main():
    with tempfile.TemporaryDirectory() as folder:
        with subprocess.Popen([*COMMAND, folder], stdout=subprocess.PIPE, text=True) as service:
            try:
                url = service.stdout.readline().split()[-1]
                with httpx.Client(base_url=f"{url}api/v1/", timeout=60) as client:
                    fill(client)
                    told = {path: client.get(path).raise_for_status().json() for path in ASKED}
                    signal = client.get("assets/press/windows/3/record").raise_for_status().content
            finally:
                service.terminate()
        with tarfile.open(HERE / "data-folder-0.1.0.tar.gz", "w:gz") as archive:
            archive.add(folder, "data")
            for name, content in (
                ("answers.json", json.dumps(told, indent=1).encode()),
                ("window-3.npz", signal),
            ):
                member = tarfile.TarInfo(name)
                member.size = len(content)
                archive.addfile(member, io.BytesIO(content))


if __name__ == "__main__":
    main()
