"""What else a page draws of a window: its kurtogram, the envelope spectrum of a band, the residual
with its threshold.
"""

from __future__ import annotations

from typing import Annotated, TypeVar

import numpy as np
from fastapi import APIRouter, Query, Response
from pydantic import BaseModel, Field
from starlette.concurrency import run_in_threadpool

from residuum.diagnosis.diagnosers.base import Diagnoser
from residuum.diagnosis.diagnosers.gate_actuator import GateActuator
from residuum.diagnosis.diagnosers.robust_residual import RobustResidual
from residuum.diagnosis.gate.classifier_plane import classifier_plane, plane_features
from residuum.diagnosis.vibration.spectra import band_envelope, kurtogram
from residuum.identification.errors import BadInput, BadRecord
from residuum.identification.record import Record
from residuum.service.api.answers import PROBLEMS
from residuum.service.api.parameters import AssetName, WindowId
from residuum.service.api.responses import Json, StrictRoute, of_one_channel
from residuum.service.services import Running, Services
from residuum.service.store import Conflict, NotFound, StoredWindow
from residuum.service.views.signal_view import extremes

router = APIRouter(
    prefix="/assets/{asset}/windows/{window}",
    tags=["assets"],
    route_class=StrictRoute,
    responses=PROBLEMS,
)

ChannelName = Annotated[
    str | None, Query(description="Channel (default: the first).", max_length=200)
]
Feature = Annotated[str | None, Query(description="Feature across or up.", max_length=40)]
Largest = Annotated[float | None, Query(description="Where the plane ends.", gt=0, lt=1e12)]
Judge = TypeVar("Judge", bound=Diagnoser)
# Level of the narrowest bands of a kurtogram, reached by windows of 2⁶ · 256 = 16 384 samples.
_DEEPEST = 6
# Of a curve. As many as a wide screen has columns.
_MOST_POINTS = 2000


class KurtogramAnswer(BaseModel):
    """Kurtosis of the envelope, a row a level of the ⅓-binary tree (0 = Gaussian)."""

    channel: str
    level: list[float] = Field(description="log₂ of the number of bands side by side.")
    frequency: list[float] = Field(description="Centres of the columns [Hz].")
    kurtosis: list[list[float]]
    best: dict[str, float] = Field(
        description="`centre`, `width` [Hz] and `kurtosis` of the most impulsive band."
    )


class EnvelopeAnswer(BaseModel):
    """Amplitude spectrum of the envelope of a band, the largest of every interval kept."""

    channel: str
    unit: str
    low: float = Field(description="Lower edge of the band [Hz].")
    high: float = Field(description="Upper edge of the band [Hz].")
    step: float = Field(description="Hertz between values.")
    amplitude: list[float | None]


class ResidualAnswer(BaseModel):
    """The residual of a window and the statistic that is held against the threshold."""

    unit: str
    time: list[float] = Field(
        description="Seconds after the window's begin, of each interval's first sample."
    )
    lowest: list[float | None] = Field(
        description="Smallest residual of the interval; null while a memory fills."
    )
    highest: list[float | None]
    statistic: list[float | None] = Field(
        description="Largest statistic of the interval, in standard deviations."
    )
    threshold: float


class RegionsAnswer(BaseModel):
    """Which class the trained classifier gives at each place of the plane of two features."""

    features: list[str] = Field(
        description="What planes can be made of; empty when no faults were trained."
    )
    x: list[float] = Field(
        description="Grid along the first feature, in the unit of the indicator."
    )
    y: list[float]
    classes: list[str]
    region: list[list[int]] = Field(description="Index into `classes`; rows go along y.")


@router.get("/kurtogram", response_model=KurtogramAnswer)
async def get_kurtogram(
    running: Running, asset: AssetName, window: WindowId, channel: ChannelName = None
) -> Response:
    """In which band, and at which width, the signal is most impulsive."""
    return await of_one_channel(
        running, asset, window, channel, lambda known, name: _kurtogram(running, known, name)
    )


def _kurtogram(running: Services, window: StoredWindow, name: str) -> Response:
    record = _channel(running, window, name)
    # By FFT: a third of the filter bank's time (0.095 and 0.29 s for 2.3 million samples on idle
    # cores, benchmarks/results/vibration.md); a picture needs no more.
    bands = kurtogram(record[name], record.sampling_rate, _levels(record.n), method="fft")
    level, frequency, kurtosis = bands.as_map()
    best = {"centre": bands.best.centre, "width": bands.best.width, "kurtosis": bands.best.kurtosis}
    return Json(
        {
            "channel": name,
            "level": level,
            "frequency": frequency,
            "kurtosis": np.ascontiguousarray(kurtosis),
            "best": best,
        }
    )


@router.get("/envelope", response_model=EnvelopeAnswer)
async def get_envelope(
    running: Running,
    asset: AssetName,
    window: WindowId,
    channel: ChannelName = None,
    low: Annotated[
        float | None, Query(description="Lower edge [Hz] (default: the most impulsive band).", ge=0)
    ] = None,
    high: Annotated[float | None, Query(description="Upper edge [Hz].", gt=0)] = None,
) -> Response:
    """Spectrum of the envelope of a band: what rhythm its impacts have."""
    if (low is None) != (high is None):
        raise BadInput("query, low and high: give both edges of the band, or none")
    return await of_one_channel(
        running,
        asset,
        window,
        channel,
        lambda known, name: _envelope(running, known, name, low, high),
    )


def _envelope(
    running: Services, window: StoredWindow, name: str, low: float | None, high: float | None
) -> Response:
    record = _channel(running, window, name)
    if low is None or high is None:
        best = kurtogram(record[name], record.sampling_rate, _levels(record.n), method="fft").best
        low, high = max(best.low, 0.0), min(best.high, record.sampling_rate / 2)
    frequency, amplitude = band_envelope(record[name], record.sampling_rate, low, high).spectrum(
        "amplitude"
    )
    # Line 0 is the envelope's mean, which tells nothing of its rhythm.
    reduced = extremes(amplitude[1:], _MOST_POINTS)
    step = float(frequency[1] - frequency[0]) * reduced.samples if len(frequency) > 1 else 0.0
    answer = {
        "channel": name,
        "unit": record.units[name],
        "low": low,
        "high": high,
        "step": step,
        "amplitude": reduced.maximum,
    }
    return Json(answer)


@router.get("/residual", response_model=ResidualAnswer)
async def get_residual(running: Running, asset: AssetName, window: WindowId) -> Response:
    """What the machine's model does not explain of the window; 409 for a diagnoser that judges
    without a residual.
    """
    judge = await run_in_threadpool(_residual_judge, running, asset)
    known = await run_in_threadpool(running.store.window, asset, window)
    return await running.sampling(known.size_bytes, _residual, running, asset, window, judge)


def _residual(running: Services, asset: str, window: int, judge: RobustResidual) -> Response:
    record = running.store.window_record(asset, window)
    model = judge.design.model
    u, y = (
        record.in_unit(judge.input, model.input_unit),
        record.in_unit(judge.output, model.output_unit),
    )
    # From rest, as the window was judged: the first samples fill the filters' memory, and are not
    # valid.
    monitor = judge.stream()
    signals, bank = monitor.process(u, y)
    residual, statistic = (
        np.where(signals.valid, values, np.nan) for values in (signals.primary, bank.statistic)
    )
    reduced = extremes(residual, _MOST_POINTS)
    answer = {
        "unit": model.output_unit,
        "time": (np.arange(len(reduced.minimum)) * reduced.samples * record.sample_time).tolist(),
        "lowest": reduced.minimum,
        "highest": reduced.maximum,
        "statistic": extremes(statistic, _MOST_POINTS).maximum,
        "threshold": running.store.finding_of(window).finding.thresholds.get("glr", float("nan")),
    }
    return Json(answer)


@router.get("/decision-regions", response_model=RegionsAnswer)
def get_decision_regions(
    running: Running,
    asset: AssetName,
    window: WindowId,
    x: Feature = None,
    y: Feature = None,
    x_to: Largest = None,
    y_to: Largest = None,
) -> Response:
    """The regions of a gate actuator's classifier, in the plane of F1 and F2 or as a cut through
    this window's movement.

    Without x and y the answer only says which features planes can be made of. The plane spans from
    0 to `x_to` and `y_to` (default: twice the window's own values). 409 for another diagnoser.
    """
    judge = _trained_judge(running, asset, GateActuator, "decision region")
    features = plane_features(judge.baseline)
    if x is None or y is None or not features:
        return Json({"features": features, "x": [], "y": [], "classes": [], "region": []})
    point = running.store.finding_of(window).finding.indicators
    ends = [
        2 * point.get(name, 0.5) if end is None else end for name, end in ((x, x_to), (y, y_to))
    ]
    plane = classifier_plane(judge.baseline, point, x, y, [[0.0, 0.0], ends])
    return Json(
        {
            "features": features,
            "x": plane.x,
            "y": plane.y,
            "classes": plane.classes,
            "region": plane.region.tolist(),
        }
    )


def _residual_judge(running: Services, asset: str) -> RobustResidual:
    return _trained_judge(running, asset, RobustResidual, "residual")


def _trained_judge(running: Services, asset: str, kind: type[Judge], view: str) -> Judge:
    diagnoser = running.store.asset(asset).diagnoser
    # 409 and not 404: the window is there, and another diagnoser would have this view.
    if diagnoser != kind.name:
        raise Conflict(f"asset {asset!r}: is judged by {diagnoser}, which has no {view}")
    try:
        judge = running.judges.trained(diagnoser, asset)
    except NotFound:
        raise Conflict(f"asset {asset!r}: has no baseline yet, so there is no {view}") from None
    if not isinstance(judge, kind):
        raise Conflict(f"asset {asset!r}: its baseline is one of {judge.name}")
    return judge


def _channel(running: Services, window: StoredWindow, name: str) -> Record:
    record = running.store.window_record(window.asset, window.id, [name])
    # One NaN makes every line of a transform NaN; filled in, a hole would be an impact.
    if np.isnan(record[name]).any():
        raise BadRecord(
            f"window {window.id}, channel {name!r}: has missing samples; this view needs all of"
            " them"
        )
    return record


def _levels(n: int) -> int:
    """Deepest level at which every band keeps the samples that a kurtosis needs."""
    # 256 samples a band at the deepest level.
    return int(np.clip(np.log2(max(n, 2) / 256), 1, _DEEPEST))
