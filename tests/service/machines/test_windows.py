import itertools

import numpy as np
import pytest

from residuum.identification.errors import BadInput
from residuum.service.fieldbus.sequence import BREAK
from residuum.service.fieldbus.settings import WindowSettings
from residuum.service.fieldbus.source import Block, StreamFormat
from residuum.service.machines.windows import make_cutter

GATE = StreamFormat("drive", 0.001, {"speed": "rad/s", "phase": ""})
PLANT = StreamFormat("process", 0.1, {"u": "", "y": ""})
VIBRATION = StreamFormat("vibration", 1 / 12800, {"acceleration": "m/s²", "sync": ""})
MACHINE = StreamFormat("machine", 1 / 1000, {"indicator": "", "speed": "rpm", "sync": ""})


def gate_signal(n):
    """Phases 0 1 0 2, each 2 s; speed holds the sample's own number."""
    number = np.arange(n)
    return {
        "speed": number.astype(float),
        "phase": np.array([0.0, 1.0, 0.0, 2.0])[number // 2000 % 4],
    }


def blocks(stream, channels, sizes, keep=None, first=0):
    """The samples in pieces, without those that `keep` says are lost."""
    n = len(next(iter(channels.values())))
    keep = np.ones(n, bool) if keep is None else keep
    at = 0
    for size in itertools.cycle(sizes):
        number = np.arange(at, min(at + size, n))[keep[at : at + size]]
        yield Block(
            stream, number + first, {name: values[number] for name, values in channels.items()}
        )
        at += size
        if at >= n:
            return


def cut(cutter, pieces):
    return [window for block in pieces for window in cutter.push(block)]


@pytest.mark.parametrize("sizes", [[1], [7, 113], [2000], [20_000]])
def test_movements_are_cut_at_the_phase_signal_however_the_samples_come(sizes):
    windows = cut(
        make_cutter(WindowSettings(cut="movement"), [GATE], "gate"),
        blocks("drive", gate_signal(9000), sizes),
    )
    assert [(window.n, window.t0, window["phase"][0]) for window in windows] == [
        (2000, 2.0, 1.0),
        (2000, 6.0, 2.0),
    ]
    assert np.array_equal(windows[1]["speed"], np.arange(6000, 8000))


def test_lost_samples_are_missing_in_the_window_and_a_late_one_finds_its_place():
    keep = np.ones(9000, bool)
    keep[2500:2510] = False
    pieces = list(blocks("drive", gate_signal(9000), [100], keep))
    late = Block("drive", np.array([2503]), {"speed": np.array([2503.0]), "phase": np.array([1.0])})
    pieces.insert(26, late)
    window = cut(make_cutter(WindowSettings(cut="movement"), [GATE], "gate"), pieces)[0]
    missing = np.flatnonzero(window.missing("speed")) + 2000
    assert missing.tolist() == [n for n in range(2500, 2510) if n != 2503]
    assert window["speed"][503] == 2503.0


def test_a_lost_phase_edge_does_not_lose_the_movement():
    keep = np.ones(9000, bool)
    keep[1990:2020] = False
    windows = cut(
        make_cutter(WindowSettings(cut="movement"), [GATE], "gate"),
        blocks("drive", gate_signal(9000), [50], keep),
    )
    assert [(window.t0, window.n) for window in windows] == [(2.02, 1980), (6.0, 2000)]


def test_no_window_reaches_across_a_restart_of_the_sender():
    before = list(blocks("drive", gate_signal(3000), [100]))
    after = list(
        blocks(
            "drive",
            {name: values[3000:] for name, values in gate_signal(9000).items()},
            [100],
            first=BREAK,
        )
    )
    windows = cut(make_cutter(WindowSettings(cut="movement"), [GATE], "gate"), before + after)
    assert [window.n for window in windows] == [2000]
    assert windows[0]["speed"][0] == 6000.0


def test_sliding_windows_overlap_and_keep_their_holes():
    n = 800
    channels = {"u": np.arange(n, dtype=float), "y": np.zeros(n)}
    keep = np.ones(n, bool)
    keep[350] = False
    pieces = blocks("process", channels, [13], keep, first=7)
    windows = cut(
        make_cutter(WindowSettings(cut="sliding", length=30, step=10), [PLANT], "plant"), pieces
    )
    assert [round(window.t0, 6) for window in windows] == [10.0, 20.0, 30.0, 40.0, 50.0]
    assert all(window.n == 300 for window in windows)
    assert [int(window.missing("u").sum()) for window in windows] == [1, 1, 1, 0, 0]


def pliers(seconds, offset, drift):
    """Two streams of one machine whose clock reads `offset` more and runs `drift` faster. The acceleration holds true time."""
    t = np.arange(round(seconds * 12800)) / 12800
    vibration = {"acceleration": t, "sync": (t % 1.0 < 0.02).astype(float)}
    true = np.arange(round(seconds * 1000)) / 1000 / (1 + drift)
    quarter = true / 0.5
    long = np.where(np.floor(quarter) % 4 == 0, 0.16, 0.08)
    machine = {
        "indicator": (quarter % 1.0 < long).astype(float),
        "speed": true,
        "sync": (true % 1.0 < 0.02).astype(float),
    }
    return vibration, machine, round(offset * 1000)


def interleaved(vibration, machine, first, lag=0):
    """Both streams in pieces of 50 ms, the machine's `lag` pieces later."""
    one = list(blocks("vibration", vibration, [640]))
    other = list(blocks("machine", machine, [50], first=first))
    for k in range(max(len(one), len(other) + lag)):
        yield from one[k : k + 1]
        if k >= lag:
            yield from other[k - lag : k - lag + 1]


@pytest.mark.parametrize(("offset", "drift"), [(0.0, 0.0), (137.3, 50e-6), (0.2, -50e-6)])
def test_rounds_are_cut_on_the_vibrations_clock_whatever_the_machines_clock_reads(offset, drift):
    cutter = make_cutter(WindowSettings(cut="round"), [VIBRATION, MACHINE], "pliers")
    windows = cut(cutter, interleaved(*pliers(60.0, offset, drift), lag=2))
    assert len(windows) >= 26
    for window in windows[3:]:
        begin, end = window["acceleration"][0], window["acceleration"][-1]
        assert abs(begin / 2.0 - round(begin / 2.0)) * 2.0 < 2e-3
        assert end - begin == pytest.approx(2.0, abs=2e-3)
        assert window["indicator"][0] == 1.0 and window["indicator"][-1] == 0.0
        assert np.abs(window["speed"] - window["acceleration"]).max() < 2.5e-3
        assert "sync" not in window.names


def test_lost_samples_of_either_stream_are_missing_in_their_round_only():
    vibration, machine, first = pliers(30.0, 3.0, 20e-6)
    pieces = list(interleaved(vibration, machine, first))
    pieces = [
        piece
        for piece in pieces
        if not (piece.stream == "vibration" and 9.3 < piece.number[0] / 12800 < 9.36)
    ]
    pieces = [
        piece
        for piece in pieces
        if not (piece.stream == "machine" and 17.3 < (piece.number[0] - first) / 1000 < 17.36)
    ]
    windows = cut(make_cutter(WindowSettings(cut="round"), [VIBRATION, MACHINE], "pliers"), pieces)
    damaged = {
        round(float(np.nanmin(w["acceleration"])) / 2) * 2: w
        for w in windows
        if any(w.missing(name).any() for name in w.names)
    }
    assert set(damaged) == {8, 16}
    assert damaged[8].missing("acceleration").sum() == 640 and not damaged[8].missing("speed").any()
    assert damaged[16].missing("speed").any() and not damaged[16].missing("acceleration").any()


def test_a_dead_indicator_still_gives_windows_to_judge():
    vibration, machine, first = pliers(40.0, 0.0, 0.0)
    machine["indicator"][12_300:] = 0.0
    windows = cut(
        make_cutter(WindowSettings(cut="round"), [VIBRATION, MACHINE], "pliers"),
        interleaved(vibration, machine, first),
    )
    assert [round(window.duration) for window in windows][-2:] == [10, 10]


def test_streams_without_the_needed_channels_are_refused():
    with pytest.raises(BadInput, match="no channel 'phase'"):
        make_cutter(WindowSettings(cut="movement"), [PLANT], "x")
    with pytest.raises(BadInput, match="sync and indicator"):
        make_cutter(WindowSettings(cut="round"), [VIBRATION, GATE], "x")
    with pytest.raises(BadInput, match="a source of one stream"):
        make_cutter(WindowSettings(cut="sliding"), [PLANT, GATE], "x")
