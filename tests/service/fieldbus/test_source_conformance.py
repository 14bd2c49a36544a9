"""What every source of signals keeps to, whatever it is connected to: each kind of `SOURCES` on a real device of its kind.

A device is a rig, see `rigs.py`. A step that a protocol does not have is skipped with the rig's reason.
"""

import json
import threading

import numpy as np
import pytest
from typer.main import get_command

from residuum.service.api.machines import BusText
from residuum.service.commands import watch
from residuum.service.commands.settings_template import settings_template
from residuum.service.fieldbus import SOURCES
from residuum.service.fieldbus.health import COUNTERS
from residuum.service.fieldbus.sequence import BREAK
from residuum.service.fieldbus.settings import SourceSettings
from tests.service.fieldbus.rigs import RIGS, UNITS, sample_of, wait

_OF_KIND = {kind: [rig for rig in RIGS if rig.kind == kind] or [None] for kind in SOURCES}
_OF_THE_CONNECTION = ("bus_errors", "reconnects", "timeouts", "counter_jumps")
_ALL = [
    pytest.param((kind, rig), id=kind if rig is None else rig.__name__.removesuffix("Rig"))
    for kind, rigs in _OF_KIND.items()
    for rig in rigs
]


@pytest.fixture(scope="module")
def lasting():
    """Gives what takes long to make: made once, and closed in the end."""
    made = {}

    def give(make, *given):
        if make not in made:
            made[make] = make(*given)
        return made[make]

    yield give
    for each in made.values():
        each.close()


@pytest.fixture(params=_ALL)
def make_rig(request, tmp_path):
    """Gives a rig that has this step; in the end its source has ended, and has kept to what holds for all."""
    kind, rig_class = request.param
    if rig_class is None:
        pytest.fail(
            f"source {kind!r} has no rig: write a class with kind = {kind!r} in"
            " tests/service/fieldbus/rigs.py and add it to RIGS there",
            pytrace=False,
        )
    made = []

    def make(step=None):
        if step in rig_class.lacks:
            pytest.skip(f"{kind}: {rig_class.lacks[step]}")
        made.append(rig_class(tmp_path, request.getfixturevalue))
        return made[-1]

    yield make
    for rig in made:
        running = rig.ended or is_running(rig)
        rig.end()
        if rig.source is not None:
            assert running, "the thread had ended by itself"
            assert not is_running(rig), "the thread does not end"
            judge(rig)


def is_running(rig):
    name = f"source {rig.source.name}" if rig.source is not None else ""
    return name in {thread.name for thread in threading.enumerate()}


def judge(rig):
    """What holds of every source, whatever happened."""
    health = rig.health()
    json.dumps(health, allow_nan=False)
    assert set(health["counters"]) == set(COUNTERS)
    blocks = [*rig.taken, *rig.refused]
    (stream,) = rig.source.streams
    assert (dict(stream.units), stream.sample_time) == (UNITS, rig.sample_time)
    for block in blocks:
        assert block.stream == stream.name and set(block.channels) == set(UNITS)
        assert block.number.dtype == np.int64
        assert all(values.shape == (block.n,) for values in block.channels.values())
        assert len(set(offsets(rig, block))) <= 1, "a block reaches across a break"
    delivered = sum(block.n for block in blocks)
    assert health["samples"] == delivered
    assert health["counters"]["queue_drops"] == sum(block.n for block in rig.refused)
    if delivered:
        assert len(np.unique(column(blocks))) == delivered, "a number came twice"
    for block in blocks:
        samples = {name: sample_of(name, block.channels[name]) for name in UNITS}
        for name, its in samples.items():
            known = its[~np.isnan(its)]
            assert np.array_equal(known, np.round(known)) and (known >= 0).all()
            assert (known < rig.next).all(), f"{name} has values that nobody sent"
        both = ~np.isnan(samples["u"]) & ~np.isnan(samples["y"])
        assert np.array_equal(samples["u"][both], samples["y"][both]), "values of two samples"


def column(blocks, name=None):
    return np.concatenate(
        [block.number if name is None else block.channels[name] for block in blocks]
    )


def offsets(rig, block):
    """By how much the numbers of a block differ from those of the device; empty where the reader's clock counts."""
    if not rig.clock:
        return []
    u, y = (sample_of(name, block.channels[name]) for name in UNITS)
    samples = np.where(np.isnan(u), y, u)
    return (block.number - samples)[~np.isnan(samples)].tolist()


def stretches(rig):
    """The offsets that the blocks have, one after the other; each begins where the numbers broke off."""
    all_offsets = [offset for block in rig.taken for offset in offsets(rig, block)]
    return [k for i, k in enumerate(all_offsets) if i == 0 or k != all_offsets[i - 1]]


def taken(rig, name="u"):
    """The samples of which the sink took this channel."""
    values = sample_of(name, column(rig.taken, name))
    return values[~np.isnan(values)].astype(int).tolist()


def holes(rig):
    number = np.sort(column(rig.taken))
    return int(number[-1] - number[0] + 1 - len(number))


def wait_counted(rig, step):
    assert wait(lambda: rig.counts[step] <= set(rig.counted())), (rig.counts[step], rig.health())


def test_values_arrive_in_their_places(make_rig):
    rig = make_rig()
    rig.start()
    before = rig.counted()
    sent = rig.send(40)
    if rig.clock:
        assert len(stretches(rig)) == 1
        assert [k for k in taken(rig) if k in sent] == sent
        assert [k for k in taken(rig, "y") if k in sent] == sent
        moved = {name for name, times in rig.counted().items() if times != before.get(name, 0)}
        assert moved <= {"timeouts", "reconnects", "bus_errors"}  # of a busy machine
    else:
        assert set(sent) <= set(taken(rig))
    assert (np.diff(column(rig.taken)) > 0).all()


def test_what_was_not_sent_is_a_hole_and_is_counted(make_rig):
    rig = make_rig("gap")
    rig.start()
    rig.send(10)
    holes_before, lost_before = holes(rig), rig.counted().get("lost", 0)
    sent = rig.send(45, leave_out=range(5))
    wait_counted(rig, "gap")
    assert wait(lambda: rig.counted()["lost"] - lost_before == holes(rig) - holes_before)
    if rig.clock:
        assert holes(rig) - holes_before == 5
        assert not set(range(sent[0] - 5, sent[0])) & set(taken(rig))
        assert len(stretches(rig)) == 1


def test_what_comes_twice_is_delivered_once(make_rig):
    rig = make_rig("repeat")
    rig.start()
    rig.catch_up()
    rig.put([rig.next, rig.next])
    rig.next += 1
    wait_counted(rig, "repeat")
    rig.flow()
    assert not rig.clock or len(set(taken(rig))) == len(taken(rig))


def test_what_comes_late_fills_its_hole(make_rig):
    rig = make_rig("late")
    rig.start()
    sent = list(range(rig.next, rig.next + 10))
    rig.next += 10
    rig.put_late(sent)
    assert wait(lambda: set(sent) <= set(taken(rig)) & set(taken(rig, "y"))), rig.health()
    if "late" in rig.counts:
        wait_counted(rig, "late")
    assert len(stretches(rig)) == 1 and holes(rig) == 0
    assert "lost" not in {name for name, times in rig.counted().items() if times > 0}


@pytest.mark.parametrize("step", ["bad", "wrong type", "no value"])
def test_what_is_no_value_is_never_a_number(make_rig, step):
    rig = make_rig(step)
    rig.start()
    before = rig.counted()
    put = {"bad": rig.put_bad, "wrong type": rig.put_wrong_type, "no value": rig.put_no_value}
    put[step](rig.next)
    rig.next += 1
    rig.flow()
    wait_counted(rig, step)
    assert wait(lambda: all(rig.counted()[name] > before.get(name, 0) for name in rig.counts[step]))


def test_a_device_that_begins_anew_begins_another_stretch(make_rig):
    rig = make_rig("anew")
    rig.start()
    rig.send(10)
    rig.begin_anew()
    rig.flow()
    wait_counted(rig, "anew")
    rig.send(10)
    old, new = stretches(rig)
    assert new - old > BREAK // 2
    assert len(set(taken(rig))) == len(taken(rig))


def test_a_lost_connection_is_made_again(make_rig):
    rig = make_rig("cut")
    rig.start()
    rig.send(10)
    rig.cut()
    wait(lambda: "bus_errors" in rig.counted())
    rig.restore()
    rig.flow()
    wait_counted(rig, "cut")
    rig.send(10)
    apart = np.diff(stretches(rig))
    assert (apart > BREAK // 2).all(), "the clock of the stream went on at another place"
    assert not rig.clock or len(set(taken(rig))) == len(taken(rig))


def test_samples_without_room_are_counted_exactly(make_rig):
    rig = make_rig()
    rig.start()
    rig.room = False
    sent = rig.send(25)
    rig.room = True
    rig.flow()
    assert not rig.clock or set(sent) <= {
        int(k) for b in rig.refused for k in sample_of("u", b.channels["u"]) if not np.isnan(k)
    }
    assert wait(lambda: rig.health()["samples"] == sum(b.n for b in [*rig.taken, *rig.refused]))
    assert rig.counted()["queue_drops"] == sum(block.n for block in rig.refused)


def test_where_nobody_is_the_source_tries_on_and_can_be_ended(make_rig):
    rig = make_rig("nowhere")
    rig.open(rig.nowhere)
    wait_counted(rig, "nowhere")
    assert rig.health()["quality"] == "never-seen" and not rig.taken
    assert rig.source.health.silence()


def test_a_source_that_lost_its_device_can_be_ended(make_rig):
    rig = make_rig("cut")
    rig.start()
    rig.cut()
    assert wait(lambda: set(rig.counted()) & {"bus_errors", "timeouts", "reconnects"})


def test_an_end_is_counted_as_nothing(make_rig):
    rig = make_rig()
    rig.start()
    before = rig.counted()
    rig.end()
    assert not is_running(rig)
    assert all(rig.counted().get(name) == before.get(name) for name in _OF_THE_CONNECTION)


def test_settings_know_every_kind():
    assert SourceSettings.model_json_schema()["properties"]["kind"]["enum"] == list(SOURCES)


def test_all_that_is_known_of_kinds_comes_from_the_sources(tmp_path):
    kinds = BusText.model_json_schema()["properties"]["kind"]
    texts = {text: name for name, kind in SOURCES.items() for text in kind.texts}
    assert kinds["enum"] == list(texts) and kinds["x-of-source"] == texts
    (init,) = [c for c in get_command(watch.app).commands.values() if c.name == "init"]
    assert set(SOURCES) <= {parameter.name for parameter in init.params}
    assert all(f"{{kind: {name}," in settings_template("a", None, {}, None, {}) for name in SOURCES)


@pytest.mark.parametrize("kind", SOURCES)
def test_an_example_is_an_address_and_nothing_is_none(kind):
    at = SOURCES[kind].reached(SOURCES[kind].example)
    assert SourceSettings(kind=kind, map="m", **at)
    if not SOURCES[kind].by_host:
        with pytest.raises(ValueError, match=r"example|must be"):
            SourceSettings(kind=kind, map="m")
