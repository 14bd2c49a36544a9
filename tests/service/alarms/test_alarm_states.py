"""Alarms under a hundred thousand random events: legal transitions only, no hidden fault, delays and deadband as ruled."""

import itertools
import random
from datetime import UTC, datetime, timedelta

import pytest

from residuum.service.alarms.alarm_rules import AlarmRule, in_deadband
from residuum.service.alarms.alarm_states import (
    ACTIVE,
    AlarmEvent,
    AlarmState,
    AlarmStatus,
    IllegalTransition,
    follow,
    operate,
)

ASIDE = (AlarmState.SHELVED, AlarmState.SUPPRESSED, AlarmState.OUT_OF_SERVICE)

START = datetime(2026, 1, 1, tzinfo=UTC)
# Written out after ANSI/ISA-18.2-2016, figure 3, apart from the code: state → what each event may lead to.
LEGAL = {
    "normal": {"raise": {"unacknowledged"}, "suppress": {"suppressed"}, "remove-from-service": {"out-of-service"}},
    "unacknowledged": {
        "clear": {"returned-unacknowledged", "unacknowledged"},
        "acknowledge": {"acknowledged"},
        "shelve": {"shelved"},
        "suppress": {"suppressed"},
        "remove-from-service": {"out-of-service"},
        "raise": {"unacknowledged"},
    },
    "acknowledged": {
        "clear": {"normal", "acknowledged"},
        "reset": {"normal"},
        "shelve": {"shelved"},
        "suppress": {"suppressed"},
        "remove-from-service": {"out-of-service"},
        "raise": {"acknowledged"},
    },
    "returned-unacknowledged": {
        "raise": {"unacknowledged"},
        "acknowledge": {"normal"},
        "shelve": {"shelved"},
        "suppress": {"suppressed"},
        "remove-from-service": {"out-of-service"},
    },
    "shelved": {
        "unshelve": {"normal", "unacknowledged"},
        "remove-from-service": {"out-of-service"},
        "raise": {"shelved"},
        "clear": {"shelved"},
    },
    "suppressed": {
        "release": {"normal", "unacknowledged"},
        "remove-from-service": {"out-of-service"},
        "raise": {"suppressed"},
        "clear": {"suppressed"},
    },
    "out-of-service": {
        "return-to-service": {"normal", "unacknowledged"},
        "raise": {"out-of-service"},
        "clear": {"out-of-service"},
    },
}
ASKED = [event for event in AlarmEvent if event not in (AlarmEvent.RAISE, AlarmEvent.CLEAR)]
RULES = [
    AlarmRule(on_delay=on, off_delay=off, latch=latch) for on, off, latch in itertools.product((0, 7), (0, 20), (False, True))
]


@pytest.mark.parametrize("number", range(len(RULES)))
def test_a_hundred_thousand_random_events_make_only_legal_transitions(number):
    rule, rng = RULES[number], random.Random(number)
    status, now, seen_since, seen_before = AlarmStatus(), START, START, False
    met = set()
    for _ in range(100_000 // len(RULES) + 1):
        now += timedelta(seconds=rng.choice((0.1, 1, 5)))
        before = status
        if rng.random() < 0.6:
            seen = seen_before if rng.random() < 0.7 else not seen_before
            seen_since = now if seen != seen_before else seen_since
            seen_before = seen
            status, event = follow(status, seen, rule, now)
            stood = (now - seen_since).total_seconds()
            settled = before.condition if stood < (rule.on_delay if seen else rule.off_delay) else seen
            assert status.condition == settled
            assert (event is None) == (status.condition == before.condition)
        else:
            event = rng.choice(ASKED)
            try:
                status = operate(status, event)
            except IllegalTransition:
                assert status == before
                assert event not in LEGAL[before.state] or event == "reset"
                continue
            assert status.condition == before.condition
        if event is not None:
            met.add((before.state, event))
            assert status.state in LEGAL[before.state][event]
        if status.condition:
            assert status.state in (AlarmState.UNACKNOWLEDGED, AlarmState.ACKNOWLEDGED, *ASIDE)
        if before.condition and not status.condition and rule.latch and before.state in ACTIVE:
            assert status.state is before.state
    assert {state for state, _ in met} >= set(AlarmState) - {AlarmState.RETURNED_UNACKNOWLEDGED} and len(met) > 20


def test_noise_inside_the_deadband_raises_one_alarm_and_without_a_deadband_many():
    def raised(deadband):
        rule, rng, status, count = AlarmRule(deadband=deadband), random.Random(3), AlarmStatus(), 0
        for number in range(10_000):
            rms = 1.0 + rng.uniform(-0.09, 0.09)
            held = status.condition and in_deadband(rule, {"rms": rms, "other": None}, {"rms": 1.0, "absent": 5.0})
            status, event = follow(status, rms > 1.0 or held, rule, START + timedelta(seconds=number))
            count += event is AlarmEvent.RAISE
        return count

    assert raised(0.1) == 1
    assert raised(0.0) > 1000


def test_a_latched_alarm_waits_for_acknowledge_and_reset():
    rule = AlarmRule(latch=True)
    status, _ = follow(AlarmStatus(), True, rule, START)
    status = operate(status, AlarmEvent.ACKNOWLEDGE)
    with pytest.raises(IllegalTransition, match="while its condition stands"):
        operate(status, AlarmEvent.RESET)
    status, _ = follow(status, False, rule, START)
    assert (status.state, status.condition) == (AlarmState.ACKNOWLEDGED, False)
    assert operate(status, AlarmEvent.RESET).state is AlarmState.NORMAL


@pytest.mark.parametrize("event", ["suppress", "remove-from-service"])
def test_what_was_put_aside_comes_back_with_its_fault(event):
    back = {"suppress": "release", "remove-from-service": "return-to-service"}[event]
    status = operate(AlarmStatus(), AlarmEvent(event))
    status, _ = follow(status, True, AlarmRule(), START)
    assert status.state in ASIDE
    assert operate(status, AlarmEvent(back)).state is AlarmState.UNACKNOWLEDGED
    status, _ = follow(status, False, AlarmRule(), START)
    assert operate(status, AlarmEvent(back)).state is AlarmState.NORMAL
