"""Windows: store and score one, look at its signal and spectrum."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Header, Query, Request, Response
from starlette.concurrency import run_in_threadpool

from residuum.diagnosis.diagnosers.base import Channel, Diagnoser
from residuum.diagnosis.finding import Finding
from residuum.diagnosis.vibration.spectra import amplitude_spectrum
from residuum.identification.errors import BadInput
from residuum.identification.record import Record
from residuum.identification.record_formats.npz import write_npz_in_pieces
from residuum.service.api.answers import (
    PROBLEMS,
    PageOf,
    SignalAnswer,
    SpectrumAnswer,
    StoredWindowAnswer,
    WindowAnswer,
)
from residuum.service.api.parameters import (
    NAME,
    AssetName,
    ChannelNames,
    Cursor,
    Limit,
    Points,
    WindowId,
    known_channels,
)
from residuum.service.api.reading_options import remedies_in_query
from residuum.service.api.responses import Json, file_answer, of_one_channel, page_answer
from residuum.service.api.signal_body import (
    READ_ON_THE_LOOP,
    SIGNAL_BODY,
    body_of,
    kind_of,
    record_of,
)
from residuum.service.machines.baselines import (
    deciding_method,
    newest_baseline,
    newest_baseline_file,
)
from residuum.service.machines.scoring import diagnoser_class, score_window
from residuum.service.services import Running, Services
from residuum.service.store import NotFound, StoredWindow
from residuum.service.views.signal_view import extremes, signal_view
from residuum.service.work.worker_pool import PlainRecord

router = APIRouter(prefix="/assets/{asset}/windows", tags=["windows"], responses=PROBLEMS)


@router.post("", status_code=201, response_model=StoredWindowAnswer, openapi_extra=SIGNAL_BODY)
async def add_window(
    request: Request,
    running: Running,
    asset: AssetName,
    diagnoser: Annotated[
        str | None, Query(description="Needed with an asset's first window.", max_length=64)
    ] = None,
    method: Annotated[
        Literal["source", "default"] | None,
        Query(description="What decides, of a diagnoser with two; default: the machine's choice."),
    ] = None,
    baseline: Annotated[
        str | None,
        Query(description="Name of its trained baseline; default: the asset's own.", pattern=NAME),
    ] = None,
    unattended: Annotated[
        bool,
        Query(
            description=(
                "As gateways ask, of whom nobody reads the answer: judged in a worker process, what"
                " the diagnoser refuses is kept as not assessable, and a method that was chosen for"
                " the machine stands before `method`."
            )
        ),
    ] = False,
    idempotency_key: Annotated[
        str | None,
        Header(description="The same key never stores twice.", min_length=1, max_length=200),
    ] = None,
) -> Response:
    """Store a window and score it. The answer comes only when window and finding are on disk.

    With an `Idempotency-Key` the same request can be sent again after a broken connection: it
    stores nothing twice and gets the first answer. The diagnoser is the asset's, with the baseline
    of the asset's name where there is one.
    """
    judging = _unattended if unattended else _attended
    # Before the body is read: a window that nobody could judge is refused without it.
    score, channels = await run_in_threadpool(judging, running, asset, diagnoser, baseline, method)
    # Query and body together are the request: the same key with another one is refused.
    digest = await _digest(request.url.query.encode(), await body_of(request))
    with remedies_in_query(kind_of(request)):
        record = await record_of(request, channels)
        in_turn = running.judging if unattended else run_in_threadpool
        return await in_turn(_store, running, asset, record, score, idempotency_key, digest)


@router.get("", response_model=PageOf[WindowAnswer])
async def list_windows(
    running: Running, asset: AssetName, cursor: Cursor = None, limit: Limit = 50
) -> Response:
    """Windows of an asset, newest first."""
    return await page_answer(running, running.store.windows, asset, cursor, limit)


@router.get("/{window}", response_model=StoredWindowAnswer)
def get_window(running: Running, asset: AssetName, window: WindowId) -> Response:
    """One window with its latest finding."""
    return Json(_described(running, asset, window))


@router.get("/{window}/record", response_class=Response)
async def get_record(running: Running, asset: AssetName, window: WindowId) -> Response:
    """The window as a record file (NPZ), its signals called as the diagnoser has them."""
    record = await run_in_threadpool(running.store.window_in_pieces, asset, window)

    def write(path: Path) -> None:
        write_npz_in_pieces(path, record, record.dtypes, record.pieces)

    # Written to disk and sent from there: a long window would cost its size in memory for as long
    # as a slow client takes it.
    return await file_answer(running, f"{asset}-{window}.npz", write, "application/zip")


@router.get("/{window}/signal", response_model=SignalAnswer)
async def get_signal(
    running: Running,
    asset: AssetName,
    window: WindowId,
    channels: ChannelNames = None,
    points: Points = 2000,
    begin: Annotated[
        float, Query(alias="from", description="Seconds after the window's begin.", ge=0)
    ] = 0.0,
    end: Annotated[
        float | None, Query(alias="to", description="Seconds after the window's begin.", gt=0)
    ] = None,
) -> Response:
    """A stretch of the signals: all samples when there are few, else minimum and maximum of every
    interval.
    """
    known = await run_in_threadpool(running.store.window, asset, window)
    wanted = known_channels(channels, known.units)

    def view() -> Response:
        return Json(
            {
                "window": window,
                **signal_view(
                    running.store.window_in_pieces(asset, window, wanted), points, begin, end
                ),
            }
        )

    # Piece by piece: a window of 64 MiB would cost its size for its picture.
    return await running.listing(view)


@router.get("/{window}/spectrum", response_model=SpectrumAnswer)
async def get_spectrum(
    running: Running,
    asset: AssetName,
    window: WindowId,
    channel: Annotated[
        str | None, Query(description="Channel (default: the first).", max_length=200)
    ] = None,
    points: Points = 2000,
    highest: Annotated[
        float | None, Query(alias="to", description="Highest frequency to show [Hz].", gt=0)
    ] = None,
) -> Response:
    """Amplitude spectrum of one channel (Hann window, mean removed), the largest of every interval
    kept.
    """
    return await of_one_channel(
        running,
        asset,
        window,
        channel,
        lambda known, name: _spectrum(running, known, name, points, highest),
    )


def _spectrum(
    running: Services, window: StoredWindow, name: str, points: int, highest: float | None
) -> Response:
    record = running.store.window_record(window.asset, window.id, [name])
    spectrum = amplitude_spectrum(record[name], record.sample_time)
    wanted = (
        len(spectrum.amplitude) if highest is None else max(2, int(highest / spectrum.step) + 1)
    )
    reduced = extremes(spectrum.amplitude[:wanted], points)
    answer = {
        "window": window.id,
        "channel": name,
        "unit": record.units[name],
        "step": spectrum.step * reduced.samples,
        "amplitude": reduced.maximum,
        "resolution": spectrum.resolution,
    }
    return Json(answer)


Score = Callable[[Record], Finding]


def _attended(
    running: Services, asset: str, diagnoser: str | None, baseline: str | None, method: str | None
) -> tuple[Score, Sequence[Channel]]:
    """What judges a window in this process, and its channels: who sent the window reads what it
    refuses.
    """
    name = _diagnoser(running, asset, diagnoser)
    judge = _judge(running, asset, name, baseline)
    deciding = method or deciding_method(running.store, asset, name)
    judge = judge if deciding is None else judge.with_settings(method=deciding)
    return judge.score, judge.channels


def _unattended(
    running: Services, asset: str, diagnoser: str | None, baseline: str | None, method: str | None
) -> tuple[Score, Sequence[Channel]]:
    """What judges a window as those of the service's own buses are."""
    name = _diagnoser(running, asset, diagnoser)
    deciding = deciding_method(running.store, asset, name, method)
    file = newest_baseline_file(running.store, running.settings.data, asset, baseline)
    fmus, workers = running.settings.allow_fmus, running.workers

    def score(record: Record) -> Finding:
        try:
            return workers.call(score_window, name, file, PlainRecord.of(record), deciding, fmus)
        except BrokenProcessPool:
            if workers.closed:
                raise
            # sent again it would end the next worker, and hold up its machine for ever
            return Finding.not_assessable(name, "judging it ended its process several times")

    return score, diagnoser_class(name).channels


def _diagnoser(running: Services, asset: str, diagnoser: str | None) -> str:
    try:
        name = diagnoser or running.store.asset(asset).diagnoser
    except NotFound:
        name = None
    if name is None:
        raise BadInput(
            f"asset {asset!r}: has no diagnoser yet; say diagnoser=… in the query of its first"
            " window"
        )
    return name


def _judge(running: Services, asset: str, name: str, baseline: str | None) -> Diagnoser:
    try:
        return running.judges.trained(name, newest_baseline(running.store, asset, baseline).model)
    except NotFound:
        # Absolute indicators alone are judged then, as `POST /score` does without a baseline.
        return running.judges.untrained(name)


async def _digest(query: bytes, body: bytes) -> str:
    def digest() -> str:
        return hashlib.sha256(b"\n".join((query, body))).hexdigest()

    # SHA-256 of 64 MiB takes longer than anybody's request may be held up.
    return digest() if len(body) <= READ_ON_THE_LOOP else await run_in_threadpool(digest)


def _store(
    running: Services, asset: str, record: Record, score: Score, key: str | None, digest: str
) -> Response:
    # A repeated request is answered before its window is judged again.
    window = None if key is None else running.store.window_with_key(asset, key, digest)
    if window is None:
        window = running.store.add_window(asset, record, score(record), key, digest)
    return Json(
        _described(running, asset, window),
        201,
        {"Location": f"/api/v1/assets/{asset}/windows/{window}"},
    )


def _described(running: Services, asset: str, window: int) -> dict[str, Any]:
    described = running.store.window(asset, window).to_json()
    return {"window": described, "finding": running.store.finding_of(window).to_json()}
