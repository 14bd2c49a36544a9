"""Tables: what a machine's pictures show, as rows: for Grafana's data source of JSON, for
spreadsheets, for scripts.
"""

from __future__ import annotations

from collections import deque
from typing import Annotated, Any

import numpy as np
from fastapi import APIRouter, Query, Response
from starlette.concurrency import run_in_threadpool

from residuum.diagnosis.vibration.spectra import amplitude_spectrum
from residuum.library.picture import Curve
from residuum.service.api.answers import PROBLEMS
from residuum.service.api.parameters import AssetName, SpanBegin, SpanEnd
from residuum.service.api.responses import Json, StrictRoute, in_pieces, of_one_channel
from residuum.service.results.month_report import Followed
from residuum.service.results.parquet_tables import findings_in, span_of
from residuum.service.services import Running, Services
from residuum.service.store import NotFound, StoredFinding, StoredWindow

router = APIRouter(
    prefix="/assets/{asset}/tables", tags=["results"], route_class=StrictRoute, responses=PROBLEMS
)

Points = Annotated[
    int,
    Query(
        description="Most rows of a curve; smallest and largest of each stretch are kept.",
        ge=10,
        le=20_000,
    ),
]
Window = Annotated[
    int | None, Query(description="Number of the window; default: the newest.", ge=1, le=2**53 - 1)
]
ChannelName = Annotated[
    str | None, Query(description="Channel; default: the first.", max_length=200)
]
# Rows of a table of findings; the newest are kept.
_MOST_FINDINGS = 5000
# Rows of all indicators together, and rows that each may have however many there are.
_MOST_ROWS, _FEWEST = 50_000, 10


@router.get("/findings")
def get_findings_table(
    running: Running, asset: AssetName, begin: SpanBegin, end: SpanEnd
) -> Response:
    """The newest 5000 findings of a span of time: when, window, verdict, class, reason."""
    # A deque of this length: a year's findings pass through, and are never in memory together.
    newest = deque(
        (_finding_row(stored) for stored in findings_in(running.store, asset, span_of(begin, end))),
        _MOST_FINDINGS,
    )
    return _rows(list(newest))


@router.get("/indicators")
def get_indicators_table(
    running: Running, asset: AssetName, begin: SpanBegin, end: SpanEnd, points: Points = 1000
) -> Response:
    """Indicators of a span of time with their limits: a row a moment and indicator, some 50 000
    rows at most over all of them.
    """
    followed: dict[str, Followed] = {}
    for stored in findings_in(running.store, asset, span_of(begin, end)):
        for name, value in stored.finding.indicators.items():
            # Numbers alone: a finding's evidence may be long, and goes with the page that it came
            # in.
            curve = followed.setdefault(name, Followed(stored.finding.units.get(name, "")))
            curve.append(stored.at, value, None, stored.finding.thresholds.get(name))
    share = min(points, max(_FEWEST, _MOST_ROWS // max(1, len(followed))))
    answer = _rows(
        [
            {
                "at": curve.at[k],
                "name": name,
                "value": curve.value[k],
                "threshold": curve.high[k],
                "unit": curve.unit,
            }
            for name, curve in followed.items()
            for k in _kept(curve.value, share)
        ]
    )
    # Some megabytes: sent at once they would hold up everybody.
    return in_pieces(bytes(answer.body), "application/json", {})


@router.get("/waveform")
async def get_waveform_table(
    running: Running,
    asset: AssetName,
    window: Window = None,
    channel: ChannelName = None,
    points: Points = 2000,
) -> Response:
    """The signal of a window: a row a moment [s after its begin]."""

    def rows(known: StoredWindow, name: str) -> Response:
        record = running.store.window_record(asset, known.id, [name])
        values, unit = record[name], record.units[name]
        return _rows(
            [
                {"time": k * record.sample_time, "value": values[k], "unit": unit}
                for k in _kept(values, points)
            ]
        )

    return await of_one_channel(
        running, asset, await _window(running, asset, window), channel, rows
    )


@router.get("/spectrum")
async def get_spectrum_table(
    running: Running,
    asset: AssetName,
    window: Window = None,
    channel: ChannelName = None,
    points: Points = 2000,
) -> Response:
    """Amplitude spectrum of a window's signal (Hann window, mean removed): a row a frequency
    [Hz].
    """

    def rows(known: StoredWindow, name: str) -> Response:
        record = running.store.window_record(asset, known.id, [name])
        spectrum, unit = amplitude_spectrum(record[name], record.sample_time), record.units[name]
        shown = _kept(spectrum.amplitude, points)
        return _rows(
            [
                {"frequency": k * spectrum.step, "amplitude": spectrum.amplitude[k], "unit": unit}
                for k in shown
            ]
        )

    return await of_one_channel(
        running, asset, await _window(running, asset, window), channel, rows
    )


async def _window(running: Services, asset: str, window: int | None) -> int:
    """The number of the window that is asked for, None: the newest."""
    if window is not None:
        return window
    newest = (await run_in_threadpool(running.store.windows, asset, limit=1)).items
    if not newest:
        raise NotFound(f"asset {asset!r}: has no window yet")
    return newest[0].id


def _finding_row(stored: StoredFinding) -> dict[str, Any]:
    """The columns alone: a finding's evidence may be long."""
    finding = stored.finding
    columns = {"verdict": finding.verdict, "class": finding.fault_class, "reason": finding.reason}
    return {"at": stored.at, "window": stored.window, **columns}


def _kept(values: Any, points: int) -> list[int]:
    """Places of the rows that are kept."""
    y = np.asarray(values, dtype=float)
    return Curve("", np.arange(len(y), dtype=float), y).reduced(points).x.astype(int).tolist()


def _rows(rows: list[dict[str, Any]]) -> Response:
    return Json({"items": rows})
