"""A machine's state says whether its windows are judged now, and if not, what it waits for and what would help."""

import itertools

import pytest

from residuum.service.fieldbus.health import LOSSES, SourceHealth
from residuum.service.machines.machine_state import STATES, counted, state_of_judging, troubled

CUTS = ("movement", "round", "sliding")


@pytest.mark.parametrize(
    ("cut", "silent", "waiting", "judged", "late"),
    list(
        itertools.product(
            CUTS, ([], ["can0 gave nothing yet"]), (0, 3), (False, True), (False, True)
        )
    ),
)
def test_only_a_machine_whose_windows_are_judged_now_is_running(cut, silent, waiting, judged, late):
    state = state_of_judging(cut, silent, waiting, judged=judged, late=late)
    assert (state.state == "running") == (judged and not late)
    if state.state == "waiting":
        assert state.doing.startswith("waiting ") and all(
            source in state.doing for source in silent
        )
    # a machine that stands still is in order
    rests = not silent and not waiting and cut != "sliding"
    assert bool(state.way_on) == (late and not rests)


def test_machines_are_counted_by_state_and_the_troubled_ones_named():
    machines = {
        "press": {"state": "running", "doing": "judging windows", "way_on": ""},
        "fan": {
            "state": "failed",
            "doing": "training failed: no windows",
            "way_on": "start it again",
        },
    }
    assert counted(machines) == dict.fromkeys(STATES, 0) | {"running": 1, "failed": 1}
    assert troubled(machines) == {
        "fan": {
            "state": "failed",
            "reason": "training failed: no windows",
            "way_on": "start it again",
        }
    }


@pytest.mark.parametrize("loss", sorted(LOSSES))
def test_a_source_that_lost_samples_within_the_last_minute_is_not_good(loss):
    now = [100.0]
    health = SourceHealth(clock=lambda: now[0])
    health.received(1, 10)
    assert health.snapshot()["quality"] == "good"
    health.count(loss, 669)
    told = health.snapshot()
    assert (told["quality"], told["lost_lately"], told["lost_within_seconds"]) == (
        "losing",
        669,
        60.0,
    )
    now[0] += 62.0
    health.received(1, 10)
    told = health.snapshot()
    assert (told["quality"], told["lost_lately"], told["counters"][loss]) == ("good", 0, 669)


def test_a_late_frame_takes_its_loss_back():
    health = SourceHealth(clock=lambda: 100.0)
    health.received(1, 10)
    health.count("lost", 3)
    health.count("lost", -3)
    assert health.snapshot()["quality"] == "good"


def test_a_silent_source_says_what_it_suffers_from():
    now = [100.0]
    health = SourceHealth(clock=lambda: now[0])
    health.count("bus_errors", 1, "no such device")
    assert health.silence() == "gave nothing yet (no such device)"
    health.received(1, 10)
    assert health.silence() == ""
    now[0] += 10.0
    assert health.silence() == "gives nothing any more (no such device)"
