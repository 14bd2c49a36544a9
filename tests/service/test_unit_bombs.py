"""Units that would be computed for ever, by every door: each is answered, none holds anybody up, and the scorer goes on.

The campaign with hundreds of them is `python -m benchmarks.unit_bombs`.
"""

import random
from itertools import islice

import httpx
import pytest

from benchmarks.unit_bombs import KNOWN, MODEL, ask, bombs, by_broker
from residuum.identification.common_units import LARGEST_POWER
from residuum.identification.errors import BadUnit
from residuum.identification.record import MOST_UNITS, Record
from residuum.identification.unit_registry import DEEPEST, MOST_FACTORS
from residuum.identification.units import parse_unit, read_registry
from residuum.service.window_queue.set_aside import ATTEMPTS, Attempts, SetAside

DRAWN = [*KNOWN, *islice(bombs(random.Random(7)), len(KNOWN), 40)]


@pytest.fixture(scope="module")
def service(run_service):
    read_registry()
    return run_service()


@pytest.mark.parametrize("way", ["JSON", "CSV", "YAML"])
def test_every_bomb_is_answered(service, way):
    found = ask(service.port, way, DRAWN)
    assert not found["wrong"] and sum(found["answers"].values()) == len(DRAWN)
    assert found["answers"].get(422, 0) > len(KNOWN)


def test_the_model_of_the_campaign_is_refused_for_its_unit_alone(service):
    url = f"{service.url}/api/v1/models?name=good"
    assert httpx.post(url, content=MODEL.format(unit="A*s"), timeout=60).status_code == 201
    refused = httpx.post(url, content=MODEL.format(unit="9**9**9"), timeout=60)
    assert refused.status_code == 422 and "not a known unit" in refused.json()["detail"]


@pytest.mark.parametrize(
    ("unit", "rule"),
    [
        ("((m**9)**9)**9", "an exponent"),
        (f"m**{LARGEST_POWER + 1:g}", "an exponent"),
        ("m**1e9", "an exponent"),
        ("km**99", "an exponent"),
        ("(" * (DEEPEST + 1) + "kg" + ")" * (DEEPEST + 1), "parentheses"),
        ("*".join(f"w{k}x" for k in range(MOST_FACTORS + 1)), "units are multiplied"),
        ("m" * 81, "longer than"),
        ("9**9**9", "not a known unit"),
        ("m**(1/0)", "an exponent"),
    ],
)
def test_each_bound_says_its_name(unit, rule):
    with pytest.raises(BadUnit, match=rule):
        parse_unit(unit)


def test_new_words_take_nothing_from_those_that_come_later():
    for k in range(3000):
        parse_unit(f"word{k}x")
    assert parse_unit("ticks/s").symbols == {"ticks": 1.0, "s": -1.0}
    with pytest.raises(BadUnit, match="different units"):
        Record(
            {f"a{k}": [0.0] for k in range(MOST_UNITS + 1)},
            {f"a{k}": f"word{k}" for k in range(MOST_UNITS + 1)},
            1.0,
        )


def test_a_scorer_sets_bombs_aside_and_goes_on(start_mosquitto, free_port, run_service, tmp_path):
    pytest.importorskip(
        "paho.mqtt.client", reason="the extra 'mqtt' is not installed: MQTT was not tried"
    )
    port = free_port()
    start_mosquitto(port)
    found = by_broker(port, tmp_path, DRAWN[:12])
    assert found["last"] and found["refused"] == found["set aside"] >= 8
    url = run_service(data=tmp_path).url
    told = httpx.get(f"{url}/api/v1/status").json()["set_aside"]
    assert told["count"] == found["set aside"] and "unit" in told["newest"][0]["reason"]
    assert (
        f"residuum_set_aside_messages {found['set aside']:.1f}" in httpx.get(f"{url}/metrics").text
    )


def test_what_ends_the_scorer_again_and_again_is_begun_no_more(tmp_path):
    for attempt in range(1, ATTEMPTS + 2):
        # a scorer that ended, and its successor
        assert Attempts(tmp_path, "1-of-1").begin("poison") == attempt
    last = Attempts(tmp_path, "1-of-1")
    last.finish("poison")
    assert Attempts(tmp_path, "1-of-1").begin("poison") == 1


def test_what_is_set_aside_is_bounded_and_counted(tmp_path, monkeypatch):
    monkeypatch.setattr("residuum.service.window_queue.set_aside._MOST", 3)
    aside = SetAside(tmp_path)
    assert aside.to_json() == {"count": 0, "newest": []}
    for number in range(5):
        aside.put(f"../key {number}", "hall", b"x", "why")
    kept = [each.key for each in aside.newest()]
    assert (aside.count, kept) == (5, [f"../key {number}" for number in (4, 3, 2)])
    assert {file.parent for file in tmp_path.rglob("*.message")} == {tmp_path / "set-aside"}
