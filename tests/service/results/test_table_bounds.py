"""Tables stay small however many findings a span of time has, and however much these hold."""

import asyncio
import tracemalloc
from datetime import UTC, datetime, timedelta
from types import SimpleNamespace

import numpy as np
import orjson
import pytest

from residuum.diagnosis.finding import Finding
from residuum.service.api import tables
from residuum.service.store import StoredFinding

RUNNING = SimpleNamespace(store=None)
SPAN = ("2026-11-01", "2026-12-01")
BEGIN = datetime(2026, 11, 1, tzinfo=UTC)


@pytest.fixture
def stored(monkeypatch):
    """Says what a span of time has: so many findings, made as they are read, with these indicators and this evidence."""

    def stream(count, indicators, evidence):
        for k in range(count):
            values = {name: float(k) for name in indicators}
            finding = Finding("bearing", "healthy", None, values, {}, {}, evidence(), f"no. {k}")
            yield StoredFinding(k + 1, "press", k + 1, BEGIN + timedelta(minutes=k), finding)

    def say(count, indicators=(), evidence=dict):
        monkeypatch.setattr(tables, "findings_in", lambda *_: stream(count, indicators, evidence))

    return say


async def sent(response):
    return orjson.loads(b"".join([piece async for piece in response.body_iterator]))["items"]


def test_the_evidence_of_findings_is_not_held(stored):
    size = 100_000
    stored(100, evidence=lambda: {"residual": np.zeros(size)})
    tracemalloc.start()
    try:
        answer = tables.get_findings_table(RUNNING, "press", *SPAN)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert len(orjson.loads(answer.body)["items"]) == 100 and peak < 8 * size * 4


def test_the_newest_findings_are_told(stored):
    stored(5100)
    rows = orjson.loads(tables.get_findings_table(RUNNING, "press", *SPAN).body)["items"]
    assert [rows[0]["window"], rows[-1]["window"], len(rows)] == [101, 5100, 5000]
    assert rows[-1] == {
        "at": "2026-11-04T12:59:00Z",
        "window": 5100,
        "verdict": "healthy",
        "class": None,
        "reason": "no. 5099",
    }


def test_all_indicators_together_have_a_bound_and_keep_their_extremes(stored):
    names = [f"band {k}" for k in range(40)]
    stored(2000, indicators=names)
    rows = asyncio.run(sent(tables.get_indicators_table(RUNNING, "press", *SPAN, 20_000)))
    assert len(rows) <= 50_000 and {row["name"] for row in rows} == set(names)
    assert {0.0, 1999.0} <= {row["value"] for row in rows if row["name"] == names[-1]}
