"""What a rule says of an alarm: priority, for how long and why it is shelved, in which state of the machine it is suppressed."""

import csv
import io
import itertools

import httpx
import numpy as np
import pytest
from pydantic import ValidationError

from residuum.diagnosis.finding import Finding
from residuum.identification.record import Record
from residuum.service.alarms.alarm_states import AlarmEvent, AlarmRule, priority_of
from residuum.service.alarms.machine_states import suppressing_state
from residuum.service.results.rationalisation import rationalisation_table
from residuum.service.storage import DiskStore

STANDS = {"signal": "speed", "unit": "rpm", "below": 60}


def record(speed=1500.0, unit="rpm"):
    return Record({"speed": np.full(5, speed)}, {"speed": unit}, 1.0)


def finding(verdict):
    return Finding("bearing", verdict, reason="-")


@pytest.fixture
def open_store(tmp_path):
    stores = []

    def opened(**rule):
        store = DiskStore(
            tmp_path,
            f"sqlite:///{tmp_path / 'residuum.db'}",
            rule_of=lambda _asset: AlarmRule(**rule),
        )
        stores.append(store)
        return store

    yield opened
    for store in stores:
        store.close()


def test_priority_rises_with_the_consequence_and_with_less_time():
    ranks = ["low", "medium", "high"]
    table = [
        [ranks.index(priority_of(c, t)) for t in (3600, 1200, 60)]
        for c in ("minor", "major", "severe")
    ]
    assert table == [[0, 0, 1], [0, 1, 2], [1, 2, 2]]
    for one, two in itertools.product(np.argwhere(np.ones((3, 3))), repeat=2):
        if (one <= two).all():
            assert table[one[0]][one[1]] <= table[two[0]][two[1]]


@pytest.mark.parametrize(
    ("rule", "says"),
    [
        ({"consequence": "major"}, "write both"),
        ({"suppress": [{"signal": "n", "unit": "rpm"}]}, "one limit"),
        ({"suppress": [{"signal": "n", "unit": "rpm", "below": 1, "above": 2}]}, "one limit"),
        ({"suppress": [{"signal": "n", "unit": "rpm/", "below": 1}]}, "unit"),
        ({"longest_shelving": 0}, "greater than 0"),
    ],
)
def test_rules_that_say_nothing_are_refused(rule, says):
    with pytest.raises(ValidationError, match=says):
        AlarmRule(**rule)


def test_an_alarm_has_the_priority_of_its_rule_also_after_a_restart(open_store):
    store = open_store(consequence="severe", time_to_respond=60)
    store.add_window("press", record(), finding("faulty"))
    store.add_window("press", record(), finding("not-assessable"))
    told = {alarm.kind: alarm.priority for alarm in open_store().alarms().items}
    assert told == {"machine": "high", "signal": "low"}
    high = store.alarm_history(priority="high").items
    assert [(each.kind, each.priority) for each in high] == [("machine", "high")]
    assert [each.kind for each in store.alarm_history(kind="signal").items] == ["signal"]


def test_a_state_is_told_by_the_median_in_any_unit_and_not_where_nothing_is_measured():
    rule = AlarmRule(suppress=[STANDS, {"signal": "oil", "unit": "°C", "above": 80}])
    oil = {"oil": np.full(5, 300.0)}

    def told(speed, unit, **more):
        return suppressing_state(
            rule,
            Record({"speed": speed, **more}, {"speed": unit} | dict.fromkeys(more, "K"), 1.0),
        )

    assert told([0.0, 0.0, 0.0, 9e9, np.nan], "rpm", **oil) == "speed below 60 rpm"
    assert told(np.full(5, 0.9), "rev/s", **oil) == "speed below 60 rpm"
    assert told(np.full(5, 1.1), "rev/s", **oil) == ""
    assert told(np.full(5, 1.1), "rev/s", oil=np.full(5, 360.0)) == "oil above 80 °C"
    assert told(np.full(5, 1.1), "rev/s") is None, "the oil was not measured"
    assert told(np.full(5, np.nan), "rpm", **oil) is None
    assert told(np.full(5, 0.9), "V", **oil) is None, "volts are no speed"
    assert told(np.full(5, 0.9), "pulses", **oil) is None
    assert suppressing_state(AlarmRule(), record()) == ""


def test_an_alarm_is_suppressed_while_its_machine_stands_and_comes_back_as_its_fault_is(open_store):
    store = open_store(suppress=[STANDS])

    def see(verdict, speed, unit="rpm"):
        store.add_window("press", record(speed, unit), finding(verdict))
        (alarm,) = [each for each in store.alarms(active=False).items if each.kind == "machine"]
        return alarm.state.value, alarm.suppressed_by

    stands = ("suppressed", "speed below 60 rpm")
    assert see("faulty", 1500) == ("unacknowledged", None)
    assert see("faulty", 0) == stands
    assert see("healthy", 0) == stands and see("faulty", 0) == stands
    assert see("faulty", 0, "V") == stands, "a window that cannot tell changes nothing"
    assert see("faulty", 1500) == ("unacknowledged", None)
    assert see("not-assessable", 0) == stands, "most windows of a machine that stands"
    assert see("faulty", 1500) == ("unacknowledged", None)
    assert see("healthy", 0)[0] == "suppressed" and see("healthy", 1500) == ("normal", None)
    assert see("healthy", 0) == ("normal", None), "what is not on the list needs no suppression"
    before = len(store.alarm_journal(1))
    assert see("faulty", 0) == stands, "never on the list"
    told = [(entry.event, entry.state.value) for entry in store.alarm_journal(1)]
    assert told[: len(told) - before] == [("raise", "suppressed"), ("suppress", "suppressed")]
    assert see("not-assessable", 1500)[0] == "unacknowledged", "released, and its fault stands"


def test_what_an_operator_suppressed_is_not_released_by_the_machine(open_store):
    store = open_store(suppress=[STANDS])
    store.add_window("press", record(), finding("faulty"))
    store.operate_alarm(1, AlarmEvent.SUPPRESS, "eva")
    store.add_window("press", record(0), finding("faulty"))
    store.add_window("press", record(), finding("faulty"))
    assert store.alarm(1).state == "suppressed"


def test_shelving_asks_for_a_reason_and_ends_as_the_rule_says(run_service):
    rule = {"shelving_reason": True, "longest_shelving": 90}
    service = run_service(alarms=rule)
    service.services.store.add_window("press", record(), finding("faulty"))
    with httpx.Client(base_url=f"{service.url}/api/v1", timeout=60) as client:

        def shelve(**body):
            answer = client.post("/alarms/1/shelve", json=body)
            return answer.status_code, answer.json()

        assert "setting shelving_reason" in shelve(minutes=60)[1]["detail"]
        assert "setting shelving_reason" in shelve(minutes=60, comment="  ")[1]["detail"]
        status, told = shelve(minutes=91, comment="spare part ordered")
        assert status == 422 and "at most 90 minutes" in told["detail"]
        status, told = shelve(minutes=90, comment="spare part ordered")
        assert (status, told["state"], told["comment"]) == (200, "shelved", "spare part ordered")
        history = client.get("/alarms/history", params={"kind": "machine"}).json()["items"]
        assert len(history) == 1 and history[0]["priority"] is None
        assert client.get("/alarms/history", params={"priority": "high"}).json()["items"] == []
        assert client.get("/alarms/history", params={"priority": "urgent"}).status_code == 422
        table = client.get("/alarms/rationalisation.csv")
        assert table.headers["content-type"].startswith("text/csv")
        assert table.text.count("\r\n") == 3 and "press" in table.text


def test_the_table_has_every_alarm_with_its_rule_and_no_formulas(open_store):
    rule = {
        "deadband": 0.1,
        "on_delay": 60,
        "consequence": "major",
        "time_to_respond": 1200,
        "action": "=HYPERLINK(1)",
        "suppress": [STANDS],
    }
    store = open_store(**rule)
    limits = Finding("bearing", "healthy", None, {"rms": 0.5}, {"rms": 1.5}, {"rms": "m/s²"})
    for number in range(130):
        store.add_window(f"press-{number:03d}", record(), limits)
    text = rationalisation_table(store, lambda _asset: AlarmRule(**rule))
    rows = list(csv.DictReader(io.StringIO(text)))
    assert len(rows) == 260 and [row["alarm"] for row in rows[:2]] == ["machine", "signal"]
    machine, signal = rows[:2]
    assert (machine["limits"], machine["priority"], signal["priority"]) == (
        "rms 1.5 m/s²",
        "medium",
        "low",
    )
    assert (machine["action"], machine["suppressed_while"]) == (
        "'=HYPERLINK(1)",
        "speed below 60 rpm",
    )
    assert (machine["deadband"], machine["on_delay"]) == ("0.1", "60.0")
    few = rationalisation_table(store, lambda _asset: AlarmRule(), {"press-007"})
    assert few.count("\r\n") == 3
