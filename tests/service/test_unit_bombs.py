"""Units that would be computed for ever, by every door: each is answered, and none holds anybody up.

The campaign with hundreds of them is `python -m benchmarks.unit_bombs`.
"""

import random
from itertools import islice

import httpx
import pytest

from benchmarks.unit_bombs import KNOWN, MODEL, ask, bombs
from residuum.identification.common_units import LARGEST_POWER
from residuum.identification.errors import BadUnit
from residuum.identification.record import MOST_UNITS, Record
from residuum.identification.unit_registry import DEEPEST, MOST_FACTORS
from residuum.identification.units import parse_unit, read_registry

DRAWN = [*KNOWN, *islice(bombs(random.Random(7)), len(KNOWN), 40)]


@pytest.fixture(scope="module")
def service(run_service):
    read_registry()
    return run_service()


@pytest.mark.parametrize("way", ["JSON", "CSV", "NPZ", "YAML"])
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
