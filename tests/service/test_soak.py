"""What the soak counts: processes with all below them, faults found and missed, windows that are faulty for no reason."""

import os
import subprocess
import sys

from benchmarks import soak


class FakeService:
    """Judges one window at each look; `shows` says which faults are found."""

    def __init__(self, shows):
        self.shows, self.on, self.findings, self.orders = shows, None, [], []

    def ask(self, path, body=None):
        if body is not None:
            self.on = None if body["fault"] == "none" else body["fault"]
            self.orders.append(body["fault"])
            return {}
        if path == "status":
            return {"machines": {"gate-actuator": {"windows_waiting": 0}}}
        if "windows" in path:
            number = len(self.findings)
            return {
                "items": [{"t0": 20.0 * number, "n": 1000, "sample_time": 0.01}] if number else []
            }
        return {"items": self.findings[::-1][:200]}

    def judge(self):
        verdict = "faulty" if self.on in self.shows else "healthy"
        self.findings.append({"id": len(self.findings) + 1, "verdict": verdict})


def test_faults_in_turn_are_found_or_missed_and_a_day_is_that_of_the_samples():
    machine, service = soak.Machine("gate-actuator", ["notch", "tooth"]), FakeService({"notch"})
    for _ in range(40):
        service.judge()
        machine.look(service)
    assert service.orders[:4] == ["notch", "none", "tooth", "none"]
    assert machine.found >= 2 and set(machine.missed) == {"tooth"} and machine.false == 0
    assert machine.windows == 40 and machine.seconds == 20.0 * 39


def test_windows_judged_before_a_fault_was_switched_do_not_count_as_after_it():
    machine, service = soak.Machine("gate-actuator", ["notch"]), FakeService({"notch"})
    for _ in range(30):
        service.judge()
    machine.look(service)
    assert machine.windows == 30 and machine.on == "notch" and not machine.missed
    service.judge()
    machine.look(service)
    assert machine.found == 1 and machine.on is None


def test_windows_that_end_while_an_order_is_under_way_do_not_count_as_after_it():
    # five windows a second
    machine, service = (
        soak.Machine("gate-actuator", ["notch"], speed=100.0),
        FakeService({"notch"}),
    )
    while machine.on is None:
        service.judge()
        machine.look(service)
    service.shows = set()  # the order has not come through
    for _ in range(5):
        service.judge()
        machine.look(service)
    assert machine.on == "notch" and not machine.missed
    service.shows = {"notch"}
    service.judge()
    machine.look(service)
    assert machine.found == 1 and not machine.missed


def test_memory_and_files_are_those_of_all_processes_below():
    code = "import subprocess, sys; a = open('/dev/null'); p = subprocess.Popen([sys.executable, '-c', %r]); p.wait()"
    inner = "held = b'x' * 50_000_000; print('ready', flush=True); import sys; sys.stdin.read()"
    command = [sys.executable, "-c", code % inner]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        assert process.stdout.readline() == b"ready\n"
        memory, files = soak.usage(process.pid)
        assert memory > 60 and files >= 7
        process.stdin.close()
    assert soak.usage(os.getpid())[0] > 10
