"""A growing file: rotation, truncation, rows that are not whole yet, headers that change, what a row lacks."""

import os
import time

import numpy as np
import pytest

from residuum.identification.errors import BadInput
from residuum.service.fieldbus import SOURCES
from residuum.service.fieldbus.growing_file import channel_below
from residuum.service.fieldbus.sequence import BREAK
from residuum.service.fieldbus.settings import SourceSettings

MAP = """\
delimiter: ";"
decimal: ","
missing: ["999"]
streams:
  signals:
    sample_time: 1
    time: {column: [day, clock], form: day first}
    channels:
      speed: {column: "speed [rpm]", unit: rpm}
      force: {column: force, unit: N, scale: 1000}
"""
HEAD = "day;clock;speed [rpm];force\n"


def row(k, speed=None, force="0,5"):
    clock = f"{k // 3600:02}:{k // 60 % 60:02}:{k % 60:02}"
    speed = f"{k},25" if speed is None else speed
    return f"28.11.2026;{clock};{speed};{force}\n"


class Bench:
    """A log file and the source that reads it."""

    def __init__(self, folder, content=HEAD, text=MAP):
        self.file, self.blocks = folder / "log.csv", []
        (folder / "columns.yaml").write_text(text)
        self.settings = SourceSettings(
            kind="file", channel=f"file:{self.file}", map=str(folder / "columns.yaml")
        )
        if content is not None:
            self.file.write_bytes(content.encode())
        self.open()

    def open(self):
        self.source = SOURCES["file"](self.settings, lambda b: self.blocks.append(b) or True)
        self.source.start()
        # what stands there at the begin is passed over: only then what is added is new
        assert self.wait(self.source.ready.is_set)

    def stop(self):
        self.source.stop()
        self.source.join()

    def add(self, text):
        with self.file.open("ab") as file:
            file.write(text.encode())

    def wait(self, condition):
        end = time.monotonic() + 60
        while not (holds := condition()) and time.monotonic() < end:
            time.sleep(0.01)
        return holds

    def counted(self):
        counters = self.source.health.snapshot()["counters"]
        return {name: times for name, times in counters.items() if times}

    def speeds(self):
        return [v for block in self.blocks for v in block.channels["speed"].tolist()]

    def numbers(self):
        return np.concatenate([block.number for block in self.blocks])

    def trouble(self):
        return self.source.health.snapshot()["last_trouble"]


@pytest.fixture
def make_bench(tmp_path):
    made = []

    def make(*given, **named):
        made.append(Bench(tmp_path, *given, **named))
        return made[-1]

    yield make
    for bench in made:
        bench.stop()


def test_rows_that_stood_there_are_no_samples_and_each_new_one_is_one(make_bench):
    bench = make_bench(HEAD + row(1) + row(2))
    bench.add(row(3) + row(4, force="999"))
    assert bench.wait(lambda: len(bench.speeds()) == 2)
    assert bench.speeds() == [3.25, 4.25]
    assert bench.blocks[0].channels["force"][0] == 500
    assert np.isnan(bench.blocks[-1].channels["force"][-1])
    assert bench.counted() == {"no_value": 1}


def test_a_row_is_waited_for_until_it_is_whole(make_bench):
    bench = make_bench(HEAD + row(1) + row(2)[:14])
    bench.add(row(2)[14:] + row(3)[:-4])
    assert bench.wait(lambda: bench.speeds() == [2.25])
    bench.add(row(3)[-4:])
    assert bench.wait(lambda: bench.speeds() == [2.25, 3.25])
    assert bench.counted() == {}


def test_a_file_that_is_rotated_is_read_to_its_end_and_then_the_next_from_its_begin(make_bench):
    bench = make_bench()
    for turn in range(4):
        bench.add("".join(map(row, range(10 * turn, 10 * turn + 8))))
        os.link(bench.file, f"{bench.file}.{turn}")
        new = bench.file.with_suffix(".new")
        new.write_text(HEAD + row(10 * turn + 8) + row(10 * turn + 9))
        os.rename(new, bench.file)
        assert bench.wait(lambda turn=turn: len(bench.speeds()) == 10 * turn + 10)
    assert bench.speeds() == [k + 0.25 for k in range(40)]
    assert np.array_equal(np.diff(bench.numbers()), np.ones(39))
    assert bench.counted() == {"reconnects": 4}


@pytest.mark.parametrize("grown_past", [False, True])
def test_a_file_that_is_cut_off_is_read_from_its_begin(make_bench, grown_past):
    bench = make_bench()
    bench.add(row(0) + row(1) + row(2))
    assert bench.wait(lambda: len(bench.speeds()) == 3)
    last = 12 if grown_past else 5
    with bench.file.open("r+b") as file:  # as `copytruncate` does: the same file
        file.truncate()
        file.write((HEAD + "".join(map(row, range(3, last)))).encode())
        file.truncate()
    assert bench.wait(lambda: len(bench.speeds()) == last)
    assert bench.speeds() == [k + 0.25 for k in range(last)]
    assert bench.counted() == {"reconnects": 1}


def test_a_row_that_its_file_ended_in_is_never_a_sample(make_bench):
    bench = make_bench()
    bench.add(row(0) + "28.11.2026;00:00:01;1")  # of 15
    assert bench.wait(lambda: len(bench.speeds()) == 1)
    new = bench.file.with_suffix(".new")
    new.write_text(HEAD + row(2))
    os.rename(new, bench.file)
    assert bench.wait(lambda: len(bench.speeds()) == 2)
    assert bench.speeds() == [0.25, 2.25] and bench.counted()["undecodable"] == 1


def test_columns_that_moved_are_found_and_a_header_without_one_is_refused(make_bench):
    bench = make_bench()
    bench.add(row(0))
    moved = "force;speed [rpm];new;clock;day\n0,5;1,25;7;00:00:01;28.11.2026\n"
    foreign = "day;clock;speed [1/s];force\n28.11.2026;00:00:02;7;7\n28.11.2026;00:00:03;7;7\n"
    for content in (moved, foreign, HEAD + row(4)):
        assert bench.wait(lambda: bench.speeds() or bench.trouble())
        seen, refused = len(bench.speeds()), bench.counted().get("undecodable", 0)
        new = bench.file.with_suffix(".new")
        new.write_text(content)
        os.rename(new, bench.file)
        if content == foreign:
            assert bench.wait(lambda n=refused: bench.counted().get("undecodable", 0) == n + 3)
            assert bench.trouble().startswith("row 1: the header has no column 'speed [rpm]';")
            assert "\n" not in bench.trouble()
        else:
            assert bench.wait(lambda n=seen: len(bench.speeds()) == n + 1)
    assert bench.speeds() == [0.25, 1.25, 4.25]


def test_a_header_among_the_rows_that_names_columns_anew_is_heeded(make_bench):
    bench = make_bench()
    bench.add(row(0) + HEAD + row(1) + "day;clock;torque;force\n" + row(2) + HEAD + row(3))
    assert bench.wait(lambda: len(bench.speeds()) == 3)
    assert bench.speeds() == [0.25, 1.25, 3.25]
    assert bench.counted()["undecodable"] == 2 and bench.counted()["lost"] == 1


def test_many_rows_at_once_are_no_clock_that_was_set(make_bench):
    bench = make_bench()
    for first in (0, 600, 1200):
        bench.add("".join(map(row, range(first, first + 600))))
        assert bench.wait(lambda n=first: len(bench.speeds()) == n + 600)
    assert bench.counted() == {} and np.array_equal(np.diff(bench.numbers()), np.ones(1799))


def test_a_clock_that_goes_back_begins_another_stretch_and_keeps_what_came_before(make_bench):
    bench = make_bench()
    bench.add("".join(map(row, [100, 101, 102, 50, 51, 52])))
    assert bench.wait(lambda: len(bench.speeds()) >= 5)
    assert bench.speeds() == [100.25, 101.25, 102.25, 51.25, 52.25]
    assert bench.numbers()[3] - bench.numbers()[2] > BREAK // 2
    assert bench.counted()["counter_jumps"] == 1


def test_another_source_goes_on_with_new_rows_alone(make_bench):
    bench = make_bench()
    bench.add(row(0) + row(1))
    assert bench.wait(lambda: len(bench.speeds()) == 2)
    bench.stop()
    bench.add(row(2))
    bench.open()
    bench.add(row(3))
    assert bench.wait(lambda: len(bench.speeds()) == 3)
    assert bench.speeds() == [0.25, 1.25, 3.25]


def test_times_of_day_go_on_after_midnight(make_bench):
    text = MAP.replace("{column: [day, clock], form: day first}", "{column: clock, form: clock}")
    bench = make_bench(text=text)
    bench.add("".join(row(k % 86_400, speed=k) for k in range(86_397, 86_403)))
    assert bench.wait(lambda: len(bench.speeds()) == 6)
    assert bench.counted() == {}


def test_what_is_no_file_is_not_opened(tmp_path, make_bench):
    os.mkfifo(tmp_path / "log.csv")
    bench = make_bench(content=None)
    assert bench.wait(lambda: "bus_errors" in bench.counted())
    assert "is no file" in bench.trouble()


@pytest.mark.parametrize("name", ["/etc/passwd", "../secret", "in/../../secret", "link/secret", ""])
def test_no_file_outside_of_the_folder_is_reached(tmp_path, name):
    folder = tmp_path / "logs"
    folder.mkdir()
    (tmp_path / "secret").write_text("1")
    (folder / "link").symlink_to(tmp_path)
    with pytest.raises(BadInput, match=r"growing_files names|needs a channel"):
        channel_below(f"file:{name}", folder)
    with pytest.raises(BadInput, match=r"names no folder|needs a channel"):
        channel_below(f"file:{name}", None)
    assert channel_below("file:press/log.csv", folder) == f"file:{folder}/press/log.csv"
