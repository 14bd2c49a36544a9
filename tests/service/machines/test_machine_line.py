"""The windows of a machine are begun ahead, ended in their order, and none of them ends the line."""

import threading
import time

import numpy as np
import pytest

from residuum.diagnosis.finding import Finding
from residuum.identification.record import Record
from residuum.service.fieldbus.settings import MachineSettings, SourceSettings, WindowSettings
from residuum.service.machines.machine_line import MachineLine

SETTINGS = MachineSettings(
    asset="plant",
    diagnoser="robust-residual",
    window=WindowSettings(cut="sliding"),
    sources=[SourceSettings(kind="modbus", port=1, map="process_plant.yaml")],
)


class Handling:
    """Notes what is begun and ended; windows of some numbers fail, and an end waits until it is let go."""

    def __init__(self, fails_to_begin=(), fails_to_end=()):
        self.begun, self.ended, self.go = [], [], threading.Event()
        self._fails_to_begin, self._fails_to_end = fails_to_begin, fails_to_end

    def __call__(self, _machine, window, _baseline, _stopped):
        number = int(window.t0)
        self.begun.append(number)
        if number in self._fails_to_begin:
            raise RuntimeError("no worker")

        def end():
            assert self.go.wait(60)
            if number in self._fails_to_end:
                raise RuntimeError("no room")
            self.ended.append(number)
            return Finding.not_assessable("robust-residual", "a test")

        return end


@pytest.fixture
def make_line():
    lines = []

    def make(handling, windows):
        line = MachineLine(SETTINGS, handling, lambda _: None)
        for number in range(windows):
            line._add_window(Record({"u": np.zeros(4)}, {"u": ""}, 0.1, t0=float(number)))
        line.use_baseline("")
        line.start()
        lines.append((line, handling))
        return line

    yield make
    for line, handling in lines:
        handling.go.set()
        line.stop()


def wait_for(condition):
    end = time.monotonic() + 60
    while not condition() and time.monotonic() < end:
        time.sleep(0.01)
    assert condition()


def test_the_next_window_is_begun_while_one_is_being_kept_and_no_more(make_line):
    handling = Handling()
    line = make_line(handling, 6)
    wait_for(lambda: handling.begun == [0, 1])
    time.sleep(0.1)
    assert handling.begun == [0, 1] and handling.ended == []
    assert line.status()["windows_waiting"] == 5  # the first is being kept
    handling.go.set()
    wait_for(lambda: line.status()["windows_judged"] == 6)
    assert handling.begun == handling.ended == list(range(6))
    assert line.status()["windows_waiting"] == 0


def test_a_window_that_fails_is_counted_and_the_others_are_kept(make_line):
    handling = Handling(fails_to_begin={1}, fails_to_end={3})
    handling.go.set()
    line = make_line(handling, 6)
    wait_for(lambda: line.status()["windows_judged"] == 4)
    assert handling.ended == [0, 2, 4, 5] and line.status()["scoring_errors"] == 2


def test_what_was_begun_is_kept_when_the_line_is_stopped(make_line):
    handling = Handling()
    line = make_line(handling, 6)
    wait_for(lambda: handling.begun == [0, 1])
    stopping = threading.Thread(target=line.stop)
    stopping.start()
    time.sleep(0.1)
    handling.go.set()
    stopping.join(60)
    assert handling.ended == [0, 1]
