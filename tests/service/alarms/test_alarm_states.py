"""Alarms under a hundred thousand random events: legal transitions only, no hidden fault, delays and deadband as ruled."""

import itertools
import random
from datetime import UTC, datetime, timedelta

import pytest

from residuum.service.alarms.alarm_states import (
    ACTIVE,
    AlarmEvent,
    AlarmRule,
    AlarmState,
    AlarmStatus,
    IllegalTransition,
    beyond,
    follow,
    in_deadband,
    operate,
    unjudged,
)

ASIDE = (AlarmState.SHELVED, AlarmState.SUPPRESSED, AlarmState.OUT_OF_SERVICE)

START = datetime(2026, 1, 1, tzinfo=UTC)
# Written out after ANSI/ISA-18.2-2016, figure 3, apart from the code: state → what each event may lead to.
LEGAL = {
    "normal": {
        "raise": {"unacknowledged"},
        "suppress": {"suppressed"},
        "remove-from-service": {"out-of-service"},
    },
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
    AlarmRule(on_delay=on, off_delay=off, latch=latch)
    for on, off, latch in itertools.product((0, 7), (0, 20), (False, True))
]


def settled(condition, shown, rule):
    """A condition by the rule as it is written: over all windows so far, None where one could not be judged; the reference."""
    seen = shown[-1][1]
    if seen == condition:
        return condition
    counted, every, last = 0.0, None, None
    delay = rule.on_delay if seen else rule.off_delay
    stretch = False
    for at, shows in shown:
        if shows is None:
            last = None
            continue
        pause = None if last is None else max((at - last).total_seconds(), 0.0)
        limit = max(delay, 2 * (every or 0.0))
        if shows != seen:
            stretch = False
        elif not stretch or (pause is not None and pause > limit):
            stretch, counted = True, 0.0
        else:
            counted += pause or 0.0
        every = every if pause is None else pause
        last = at
    return seen if counted >= delay else condition


@pytest.mark.parametrize("seed", range(40))
def test_delays_count_what_was_seen_as_a_reference_state_machine_does(seed):
    rng = random.Random(seed)
    rule = AlarmRule(on_delay=rng.choice((0, 30, 60)), off_delay=rng.choice((0, 45, 120)))
    status, now, shown, since = AlarmStatus(), START, [], 0
    for _ in range(250):
        now += timedelta(seconds=rng.choice((5, 10, 10, 10, 25, 100, 7200, -3600)))
        shows = (
            rng.choice((True, False, None))
            if rng.random() < 0.25
            else next((s for _, s in reversed(shown) if s is not None), True)
        )
        shown.append((now, shows))
        if shows is None:
            status = unjudged(status)
            continue
        before = status
        status, event = follow(status, shows, rule, now)
        assert status.condition == settled(before.condition, shown[since:], rule)
        assert (event is None) == (status.condition == before.condition)
        since = len(shown) - 1 if event is not None and shows != status.condition else since


def at(seconds):
    return START + timedelta(seconds=seconds)


def events_of(rule, shown):
    status, events = AlarmStatus(), []
    for seconds, shows in shown:
        status, event = (
            (unjudged(status), None) if shows is None else follow(status, shows, rule, at(seconds))
        )
        events += [(seconds, event.value)] if event else []
    return events


def test_what_was_not_seen_does_not_count():
    on, off = AlarmRule(on_delay=60), AlarmRule(off_delay=60)
    assert events_of(on, [(0, True), (7200, True)]) == []
    assert events_of(on, [(0, True), (7200, True), (7230, True), (7260, True)]) == [(7260, "raise")]
    assert events_of(on, [(0, True), *((s, None) for s in range(10, 80, 10)), (80, True)]) == []
    assert events_of(on, [(0, True), (50, True), (900, True)]) == []
    assert events_of(on, [(s, True) for s in range(0, 100, 10)]) == [(60, "raise")]
    # windows that come seldom
    assert events_of(on, [(600 * k, True) for k in range(4)]) == [(1200, "raise")]
    assert events_of(off, [(0, True), (10, False), (7210, False)]) == [(0, "raise")]
    back = events_of(
        on,
        [
            (0, True),
            (20, True),
            (40, True),
            (40 - 3600, True),
            (80 - 3600, True),
            (120 - 3600, True),
        ],
    )
    assert back[0][0] <= 120 - 3600


@pytest.mark.parametrize("seed", range(20))
def test_only_what_raised_an_alarm_holds_it_and_by_its_own_sign(seed):
    rng = random.Random(seed)
    tau = rng.uniform(0.5, 20) * rng.choice((-1, 1))
    rule = AlarmRule(deadband=0.1)
    inside, outside = tau - 0.05 * abs(tau), tau - 0.15 * abs(tau)
    taus = {"raised": tau, "other": 1.0}
    assert in_deadband(rule, {"raised": inside, "other": 0.0}, taus, {"raised"})
    assert not in_deadband(rule, {"raised": outside, "other": 0.95}, taus, {"raised"})
    # nobody kept which one it was
    assert in_deadband(rule, {"raised": outside, "other": 0.95}, taus)
    assert not in_deadband(rule, {"raised": -0.01}, {"raised": 0.0}, {"raised"})
    assert beyond({"raised": tau + 1, "other": 0.5}, taus) == {"raised"}


@pytest.mark.parametrize("number", range(len(RULES)))
def test_a_hundred_thousand_random_events_make_only_legal_transitions(number):
    rule, rng = RULES[number], random.Random(number)
    status, now, shown = AlarmStatus(), START, []
    seen_before, met = False, set()
    for _ in range(100_000 // len(RULES) + 1):
        now += timedelta(seconds=rng.choice((0.1, 1, 5)))
        before = status
        if rng.random() < 0.6:
            seen = seen_before if rng.random() < 0.7 else not seen_before
            seen_before = seen
            status, event = follow(status, seen, rule, now)
            shown.append((now, seen))
            assert status.condition == settled(before.condition, shown[-60:], rule)
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
    assert {state for state, _ in met} >= set(AlarmState) - {
        AlarmState.RETURNED_UNACKNOWLEDGED
    } and len(met) > 20


def test_noise_inside_the_deadband_raises_one_alarm_and_without_a_deadband_many():
    def raised(deadband):
        rule, rng, status, count = AlarmRule(deadband=deadband), random.Random(3), AlarmStatus(), 0
        for number in range(10_000):
            rms = 1.0 + rng.uniform(-0.09, 0.09)
            held = status.condition and in_deadband(
                rule, {"rms": rms, "other": None}, {"rms": 1.0, "absent": 5.0}
            )
            status, event = follow(
                status, rms > 1.0 or held, rule, START + timedelta(seconds=number)
            )
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
