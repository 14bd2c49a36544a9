"""Short versions of the fault campaigns; the long ones are `python -m benchmarks.modbus` and `python -m benchmarks.can`."""

import json
import subprocess
import sys
from pathlib import Path


def campaign(bus, **settings):
    """What a campaign counts, in a process of its own: nothing that other tests leave behind shares its threads and sockets."""
    code = f"import json; from benchmarks import {bus}; print(json.dumps({bus}.campaign(**{settings!r})))"
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=Path(__file__).parents[3],
        stdout=subprocess.PIPE,
        text=True,
        timeout=300,
        check=True,
    )
    return json.loads(done.stdout.splitlines()[-1])


def test_no_faulty_modbus_reply_gets_a_wrong_value_in_and_the_device_beside_loses_nothing():
    found = campaign("modbus", faults=120, devices=6, seed=3)
    assert found["faults"] >= 120 and found["kinds"] >= 13
    assert (found["wrong values"], found["unaccounted"], found["recoveries over 5 s"]) == (0, 0, 0)
    assert found["sound device: samples"] > 100 and found["sound device: lost, late or wrong"] == 0


def test_can_faults_are_counted_exactly_and_no_window_with_a_hole_is_healthy():
    found = campaign("can", faults=40, seed=1)
    assert set(found["of each kind"]) >= {"drop", "repetition", "disorder", "jump"}
    assert (found["counted wrongly"], found["wrong samples"]) == (0, 0)
    assert (
        found["windows wrong"],
        found["windows across a jump"],
        found["windows with a hole, healthy"],
    ) == (0, 0, 0)
    assert found["windows with a hole"] >= 1 and found["windows whole, healthy"] >= 1
