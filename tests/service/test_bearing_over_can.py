"""Real bearing recordings, replayed over CAN FD: held-out healthy parts stay healthy, damaged bearings come out faulty."""

import json
import time
from pathlib import Path

import pytest

from residuum.diagnosis.diagnosers.bearing import Bearing
from residuum.identification.record_formats import ReadOptions, read_record, write_record
from residuum.service.cli import run as run_command
from residuum.service.fieldbus.settings import MachineSettings, SourceSettings, WindowSettings

RIG = Path(__file__).resolve().parents[3] / "shared" / "data" / "cwru"
ORDERS = {"bpfi": 5.4152, "bpfo": 3.5848, "bsf": 2.357, "ftf": 0.398}
TS = 1 / 12000


def accelerometer(number):
    file = next(RIG.glob(f"{number}_*.mat"))
    name = f"X{number:03d}_DE_time"
    record = read_record(file, ReadOptions(sample_time=TS, units={name: "g"}))
    return record.select([name]).rename({name: "acceleration"})


@pytest.mark.skipif(not RIG.is_dir(), reason="skipped: no real recordings here")
@pytest.mark.parametrize(
    ("number", "expected"), [(97, None), (105, "inner-race"), (130, "outer-race")]
)
def test_a_recording_of_a_bearing_rig_is_judged_over_can_fd(
    number, expected, run_service, free_channel, tmp_path, capsys
):
    healthy = accelerometer(97)
    half = healthy.n // 2
    Bearing(orders=ORDERS, speed_rpm=1797.0).fit([healthy.window(0, half)]).save(
        tmp_path / "baseline.zip"
    )
    channel = free_channel()
    watched = MachineSettings(
        asset="rig",
        diagnoser="bearing",
        window=WindowSettings(cut="sliding", length=1.0, step=1.0),
        sources=[SourceSettings(kind="can", channel=channel, map="vibration_logger.dbc")],
    )
    service = run_service(machines=[watched.model_dump()])
    service.services.store.add_model_version(
        "rig", "baseline", (tmp_path / "baseline.zip").read_bytes()
    )
    record = healthy.window(half, healthy.n) if number == 97 else accelerometer(number)
    end = time.monotonic() + 120
    while service.services.pipeline.status()["machines"]["rig"]["state"] != "waiting":
        assert time.monotonic() < end, "the baseline was not taken up"
        time.sleep(0.1)
    write_record(record, tmp_path / "part.npz")
    replay = [
        "replay",
        str(tmp_path / "part.npz"),
        "--to",
        f"can:{channel}",
        "--bus-map",
        "vibration_logger.dbc",
        "--speed",
        "5",
    ]
    assert run_command([*replay, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["sent"] == record.n // 31
    found = findings_of(service, at_least=int(record.duration) - 1)
    assert {finding.verdict.value for finding in found} == {
        "healthy" if expected is None else "faulty"
    }
    classes = [finding.fault_class for finding in found]
    assert max(set(classes), key=classes.count) == expected
    (source,) = service.services.pipeline.status()["sources"].values()
    assert source["counters"]["lost"] == 0 and source["samples"] == record.n // 31 * 31


def findings_of(service, at_least):
    """The findings, once no more come."""
    end, count = time.monotonic() + 120, -1
    while time.monotonic() < end:
        items = service.services.store.findings("rig", limit=200).items
        if len(items) >= at_least and len(items) == count:
            break
        count = len(items)
        time.sleep(2.0)
    assert len(items) >= at_least
    return [item.finding for item in items]
