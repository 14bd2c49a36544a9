"""A data folder that version 0.1.0 left is one that this version goes on with: all that it answered then, it answers now."""

import json
import math
import tarfile
from pathlib import Path

import httpx
import numpy as np
import pytest

from residuum.service.storage.database import Database, newest_revision

LEFT = Path(__file__).parents[2] / "recorded" / "data-folder-0.1.0.tar.gz"
LIVE = "status"
"""What a machine does at the moment."""


@pytest.fixture(scope="module")
def left(tmp_path_factory):
    """The folder, what 0.1.0 answered about it, and the signal of its third window."""
    folder = tmp_path_factory.mktemp("0.1.0")
    with tarfile.open(LEFT) as archive:
        archive.extractall(folder, filter="data")
    return (
        folder / "data",
        json.loads((folder / "answers.json").read_text()),
        folder / "window-3.npz",
    )


@pytest.fixture(scope="module")
def client(left, run_service):
    # however old the folder is by now
    service = run_service(data=left[0], keep_days=math.inf, keep_row_days=math.inf)
    with httpx.Client(base_url=f"{service.url}/api/v1/", timeout=60) as client:
        yield client


def kept(before, now):
    """What of `now` stands in `before`, too: an answer may have gained keys, and an alarm's text since when it stands."""
    if isinstance(before, dict) and isinstance(now, dict):
        return {
            key: kept(value, now[key])
            for key, value in before.items()
            if key in now and key != LIVE
        }
    if isinstance(before, str) and isinstance(now, str) and now.startswith(f"{before}; since "):
        return before
    if isinstance(before, list) and isinstance(now, list) and len(before) == len(now):
        return [kept(*both) for both in zip(before, now, strict=True)]
    return now


def test_all_that_was_stored_is_told_as_before(client, left):
    for path, before in left[1].items():
        before.pop(LIVE, None)
        now = client.get(path).raise_for_status().json()
        assert kept(before, now) == before, path


def test_signals_and_models_are_read_and_the_folder_takes_new_ones(client, left):
    signal = client.get("assets/press/windows/3/record").raise_for_status()
    (left[0] / "now.npz").write_bytes(signal.content)
    with np.load(left[2]) as before, np.load(left[0] / "now.npz") as now:
        np.testing.assert_array_equal(now["vibration"], before["vibration"])
    assert client.get("models/axis/description").raise_for_status().json()["name"] == "gate-drive"
    body = "time [s],vibration [m/s^2]\n" + "".join(f"{k / 4096},{k % 7}\n" for k in range(4096))
    sent = {"content": body.encode(), "headers": {"Content-Type": "text/csv"}}
    assert client.post("assets/press/windows?diagnoser=bearing", **sent).json()["window"]["id"] == 4
    again = {
        "content": body.encode(),
        "headers": {"Content-Type": "text/csv", "Idempotency-Key": "window-2"},
    }
    assert client.post("assets/press/windows?diagnoser=bearing", **again).status_code == 409, (
        "the key was used"
    )


def test_its_schema_is_the_newest_one_after_the_start(client, left):
    assert client.get("health/ready").status_code == 200
    database = Database(f"sqlite:///{left[0] / 'residuum.db'}")
    assert database.revision() == newest_revision()
    database.close()
