"""Ten thousand drawn signals with gaps: what raises and clears an alarm, when, is what a reference says that keeps nothing."""

import itertools
import random
from datetime import UTC, datetime, timedelta

from residuum.service.alarms.alarm_states import (
    AlarmEvent,
    AlarmRule,
    AlarmStatus,
    beyond,
    follow,
    in_deadband,
    unjudged,
)

SIGNALS, WINDOWS = 10_000, 30
START = datetime(2026, 1, 1, tzinfo=UTC)
PAUSES = (5, 5, 5, 10, 10, 30, 90, 400, 7200, -600)
"""Seconds from one window to the next: usual ones, lost ones, gaps, a clock that was set back."""


def drawn(rng):
    """A signal around its limit: (second, value or None where a window cannot be judged)."""
    now, level, signal = 0, 0.8, []
    for _ in range(WINDOWS):
        now += rng.choice(PAUSES[:6]) if rng.random() < 0.9 else rng.choice(PAUSES)
        level = level if rng.random() < 0.75 else rng.choice((0.5, 0.85, 0.96, 1.0, 1.1, 2.0))
        signal.append((now, None if rng.random() < 0.08 else level))
    return signal


def referred(signal, tau, deadband, delays):
    """The changes (window, raised), found by looking back from each window: nothing is carried but the condition and its begin.

    `delays` are those of raising and clearing. A window shows the fault above τ, and while the alarm stands above τ − d|τ|. It
    changes the condition where the windows before it, back to the first one that showed the same without a break, have seen it
    for the delay: pauses between neighbours that were both judged, none of them longer than the delay and than twice the pause
    before it.
    """
    judged = [k for k, (_, x) in enumerate(signal) if x is not None]
    neighbours = {
        b: max(signal[b][0] - signal[a][0], 0) for a, b in itertools.pairwise(judged) if b == a + 1
    }
    before, last = {}, 0
    for k in judged:
        before[k] = last
        last = neighbours.get(k, last)
    raised, begin, changes, shown = False, 0, [], {}
    for k in judged:
        x = signal[k][1]
        shown[k] = x > tau or (raised and deadband > 0 and x > tau - deadband * abs(tau))
        if shown[k] == raised:
            continue
        delay, seen, j = delays[0 if shown[k] else 1], 0, k
        while True:
            earlier = [i for i in judged if begin <= i < j]
            if not earlier or shown[earlier[-1]] != shown[k]:
                break
            pause = neighbours.get(j, 0)
            if pause > max(delay, 2 * before[j]):
                break
            seen, j = seen + pause, earlier[-1]
        if seen >= delay:
            raised, begin = shown[k], k + 1
            changes.append((k, raised))
    return changes


def followed(signal, tau, rule):
    status, changes, raised_by = AlarmStatus(), [], None
    for k, (second, x) in enumerate(signal):
        if x is None:
            status = unjudged(status)
            continue
        values, limits = {"rms": x, "other": 0.99}, {"rms": tau, "other": 1.0}
        above = beyond(values, limits)
        held = status.condition and in_deadband(rule, values, limits, raised_by)
        now = START + timedelta(seconds=second)
        status, event = follow(status, bool(above) or held, rule, now)
        raised_by = above if event is AlarmEvent.RAISE else raised_by
        if event is not None:
            changes.append((k, status.condition))
    return changes


def test_ten_thousand_signals_with_gaps_raise_and_clear_as_the_reference_says():
    rng = random.Random(36)
    raised = cleared = differing = 0
    for _ in range(SIGNALS):
        deadband, delays = (
            rng.choice((0.0, 0.05, 0.2)),
            rng.choice(((0, 0), (20, 0), (15, 40), (60, 60))),
        )
        rule = AlarmRule(deadband=deadband, on_delay=delays[0], off_delay=delays[1])
        signal = drawn(rng)
        changes = followed(signal, 1.0, rule)
        differing += changes != referred(signal, 1.0, deadband, delays)
        raised += sum(up for _, up in changes)
        cleared += sum(not up for _, up in changes)
    assert differing == 0
    assert raised > SIGNALS / 2 and cleared > SIGNALS / 4
