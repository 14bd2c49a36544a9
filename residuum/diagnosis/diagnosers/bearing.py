"""Any rolling bearing, from one accelerometer: fault lines of the envelope, absolute indicators,
and a healthy baseline.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np

from residuum.array_types import AnyArray
from residuum.diagnosis.diagnosers.base import Channel, Diagnoser, Example, NotTrained
from residuum.diagnosis.finding import Finding, Verdict
from residuum.diagnosis.learning.stored import load_stored, save_stored
from residuum.diagnosis.thresholds.tails import HealthyBand
from residuum.diagnosis.vibration.bearing_lines import (
    CLASS_OF,
    BearingFrequencies,
    LineEvidence,
    line_evidence,
)
from residuum.diagnosis.vibration.moving_lines import (
    faulty_bearing,
    moving_line,
    without_knocks,
)
from residuum.diagnosis.vibration.rotation import (
    at_steady_speed,
    only_speed_channel,
    speed_channel,
    unusable_speeds,
    usual_speed,
)
from residuum.diagnosis.vibration.sensor_health import (
    hears_otherwise,
    remarks,
    suspect,
    unusable,
    without_spikes,
)
from residuum.diagnosis.vibration.spectra import octave_edges, octave_rms
from residuum.diagnosis.vibration.vibration_indicators import (
    LIMITS,
    LONGEST,
    blocks_of,
    indicators,
    score_in_blocks,
    severity,
)
from residuum.identification.errors import BadInput, NotIdentifiable
from residuum.identification.record import Record
from residuum.identification.units import compatible, convert
from residuum.nearest_names import known_names

SHAPE = ("rms", "kurtosis", "crest")  # indicators of the whole band
# Prominence [deciles of the control frequencies] from which on a line family means a fault;
# benchmarks/results/vibration.md. Healthy records, real and made, stay below 5.3.
PROMINENT = 6.0
# White noise reaches 4.5 and a slow swell 5.0: so low a limit names a part only where something
# else has changed already.
PROMINENT_BESIDE_A_CHANGE = 4.5
# one healthy second of a real rig reaches 6.1 while every level stays as it was
PROMINENT_WITHOUT_A_CHANGE = 7.5
# times what the same family showed in the healthy machine: a gear or the supply may modulate within
# 2 % of a fault's frequency
_OVER_HEALTHY = 1.3
# a line family that modulates the envelope by less is no fault yet, however significant
DEPTH = 0.08
# kurtosis; without a line to name a part, so impulsive a signal is `unknown`
IMPULSIVE = 6.0
# the cage's family has to lead by a quarter: its harmonics meet the others' lines, BPFO = N FTF
_CAGE_LEADS_BY = 1.25
# of the most prominent family: one fault's lines make another family stand out by half as much, on
# real rigs too
_RIVAL = 0.8
# deciles and share of the cage's: balls change their load once a turn of the cage
_BALL_BESIDE_CAGE = (3.5, 0.5)
_WINDOW = 1.0  # s, of which indicators are the median over a record
_SHORTEST = 1024  # samples
# times the healthy median: a change of less is no fault, however significant
_LEAST_CHANGE: AnyArray = np.array([1.6, 1.6, 1.6])
# below and above 1 kHz: load moves rotor-related bands, bearing faults ring higher
_LEAST_CHANGE_OF_BAND = (2.5, 2.0)
_FEWEST_WINDOWS = 4  # to know a mean and a scatter by
_VERSION = 1


@dataclass(frozen=True, eq=False)
class _Baseline:
    """Healthy windows: shape indicators, octave bands, and how prominent the fault lines were
    anyway.
    """

    sampling_rate: float
    window: float
    shape: HealthyBand
    edges: AnyArray
    bands: HealthyBand
    lines: Mapping[str, float]

    def deaf(self, measured: _Measured) -> str | None:
        """Why the sensor does not hear what it heard at training; None where it does."""
        names = _band_names(self.edges)
        healthy = dict(zip(names, np.exp(self.bands.mean), strict=True))
        edges = self.edges[: len(measured.bands) + 1]
        return hears_otherwise(
            [healthy[name] for name in measured.bands], list(measured.bands.values()), edges
        )


class Bearing(Diagnoser):
    """Names the damaged part of a rolling bearing from any vibration record.

    A line family (BPFI, BPFO, twice BSF, FTF and their harmonics in the squared-envelope spectrum)
    means a fault when it stands out from control frequencies by `PROMINENT` deciles and modulates
    the envelope by at least 8 %. Kurtosis above 6 without a line is `unknown`. Where neither is
    seen and there is no baseline, the finding is `not-assessable` and tells the limits that hold:
    wear that shows in no absolute limit needs the comparison. With a baseline, RMS, kurtosis, crest
    factor and octave-band RMS over one-second windows are also held against healthy prediction
    limits; a change there lowers the prominence that names a part to 4.5 (and is `unknown` when no
    line reaches it), and its absence raises it to 7.5.

    A speed channel may be in rpm, 1/min, Hz, rad/s or the like; one that varies by more than 0.5 %
    makes the lines be looked for in the angle domain. What points to the sensor (drift, loose
    mounting, mains hum, another sensitivity than the baseline's) is `not-assessable`, never a
    fault; so is a changing speed that contradicts what was said of it, or that the vibration's own
    lines show where no channel tells it. Two families that stand out nearly alike are `unknown`,
    and both told.

    Fails for: faults without impacts (evenly worn, general roughness) unless a baseline shows them;
    a stated speed that is wrong by more than 2 %; another source that modulates the vibration
    within 2 % of a fault frequency.

    Parameters
    ----------
    orders : mapping or None
        `bpfi`, `bpfo`, `bsf`, `ftf` (any of them) as multiples of shaft speed; needs a speed.
    hertz : mapping or None
        The same in hertz, and `shaft` if known; instead of `orders`.
    speed_rpm : float or None
        Shaft speed; None: from the record's speed channel (its name holds `speed`, `rpm` or
        `drehzahl`).
    channel : str or None
        The acceleration channel; None: the first one with a unit of acceleration, or an only
        channel without unit.
    machine_class : str or None
        Class of `vibration_indicators.LIMITS`; when given, velocity RMS and its zone are part of
        the evidence.
    false_alarm : float
        Probability that a healthy window passes any limit of the baseline, when its logarithms are
        normal.
    """

    name: ClassVar[str] = "bearing"
    quick: ClassVar[bool] = True
    channels: ClassVar[Sequence[Channel]] = (
        Channel("acceleration", "m/s²", "vibration of the bearing's housing; any name"),
        Channel("speed", "rpm", "shaft speed", required=False),
    )
    classes: ClassVar[Sequence[str]] = (*CLASS_OF.values(), "unknown")

    def __init__(
        self,
        *,
        orders: Mapping[str, float] | None = None,
        hertz: Mapping[str, float] | None = None,
        speed_rpm: float | None = None,
        channel: str | None = None,
        machine_class: str | None = None,
        false_alarm: float = 1e-5,
    ) -> None:
        _refuse_settings(orders, hertz, speed_rpm, machine_class, false_alarm)
        self.orders, self.hertz = dict(orders or {}), dict(hertz or {})
        self.speed_rpm, self.channel = speed_rpm, channel
        self.machine_class, self.false_alarm = machine_class, false_alarm
        self._baseline: _Baseline | None = None

    def with_settings(self, **settings: Any) -> Self:
        """This diagnoser and its baseline with other `orders`, `hertz` or `speed_rpm`; what is not
        given stays.
        """
        if "method" in settings:
            super().with_settings(method=settings.pop("method"))
        if unknown := [name for name in settings if name not in ("orders", "hertz", "speed_rpm")]:
            raise BadInput(f"bearing: has no setting {unknown[0]!r}; has orders, hertz, speed_rpm")
        lines = settings.keys() & {"orders", "hertz"}
        unchanged = (
            {"speed_rpm": self.speed_rpm}
            if lines
            else {"orders": self.orders, "hertz": self.hertz, "speed_rpm": self.speed_rpm}
        )
        bearing = type(self)(
            **{**unchanged, **settings},
            channel=self.channel,
            machine_class=self.machine_class,
            false_alarm=self.false_alarm,
        )
        same = (bearing.orders, bearing.hertz) == (self.orders, self.hertz)
        bearing._baseline = (
            self._baseline if same or self._baseline is None else replace(self._baseline, lines={})
        )
        return bearing

    def fit(self, records: Sequence[Record], labels: Sequence[str] | None = None) -> Self:
        """Learn what is healthy, from one-second windows of the records; records with another label
        are left out.

        Raises NotIdentifiable when they hold fewer than 4 windows, BadInput when they differ in
        rate or cannot be used.
        """
        healthy = _healthy(records, labels)
        rate = healthy[0].sampling_rate
        window = min(_WINDOW, *(record.duration for record in healthy))
        edges = octave_edges(rate, window)
        parts: list[AnyArray] = []
        lines: dict[str, float] = {}
        for record in healthy:
            speed = self._speed_channel(record)
            frequencies = self._frequencies(record, speed)
            x, _ = without_knocks(self._trainable(record), rate, _slowest(frequencies))
            parts += _windows(x, rate, window)
            if frequencies.lines:
                steady = at_steady_speed(
                    x, record, speed, self.speed_rpm, in_hertz=bool(self.hertz)
                )
                _keep_largest(lines, [*_windows(steady, rate, window), steady], rate, frequencies)
        if len(parts) < _FEWEST_WINDOWS:
            raise NotIdentifiable(
                f"bearing: {len(parts)} healthy windows of {window:g} s; at least {_FEWEST_WINDOWS}"
                " are needed"
            )
        shape = HealthyBand.of([_shape(part) for part in parts])
        bands = HealthyBand.of([octave_rms(part, rate, edges) for part in parts])
        self._baseline = _Baseline(rate, window, shape, edges, bands, lines)
        return self

    def _trainable(self, record: Record) -> AnyArray:
        """The acceleration of a record that may be trained on; BadInput says why another may
        not.
        """
        x, _ = self._acceleration(record)
        if reason := unusable(x, _SHORTEST):
            raise BadInput(f"bearing: record {record.source!r} cannot be trained on: {reason}")
        return without_spikes(x)[0]

    def score(self, record: Record) -> Finding:
        """Judge one record: its fault lines over the whole of it, its indicators as medians over
        windows.

        A record of more than `LONGEST` samples is judged in blocks, without a copy of
        the whole. Without a baseline nothing is `healthy`: the finding is `not-assessable` where no
        absolute limit is passed, and says which hold.
        """
        whole = record.n > LONGEST
        judged = (
            score_in_blocks(self.name, self._score_block, record)
            if whole
            else self._score_block(record)
        )
        if self._baseline is None and judged.verdict is Verdict.HEALTHY:
            return judged.without_baseline(_held(judged))
        return judged

    def _score_block(self, record: Record) -> Finding:
        raw, unit = self._acceleration(record)
        if reason := unusable(raw, _SHORTEST):
            return Finding.not_assessable(self.name, reason)
        rate = record.sampling_rate
        speed = self._speed_channel(record)
        frequencies = self._frequencies(record, speed)
        x, spikes = without_spikes(raw)
        x, knocks = without_knocks(x, rate, _slowest(frequencies))
        if reason := suspect(x, rate, frequencies.shaft):
            return Finding.not_assessable(self.name, reason)
        measured = _Measured.of(x, rate, self._baseline)
        if self._baseline and (reason := self._baseline.deaf(measured)):
            return Finding.not_assessable(self.name, reason)
        try:
            evidence = self._lines(record, x, speed, frequencies)
            beside = self._beside_lines(x, rate, knocks)
        except BadInput as error:
            return Finding.not_assessable(self.name, str(error))
        # a baseline judges levels too, for which no line is needed
        if frequencies.lines and not evidence and self._baseline is None:
            return Finding.not_assessable(
                self.name, f"the window of {record.duration:g} s is too short for any fault line"
            )
        judged = self._judge(measured, evidence, unit, beside).with_remarks(
            remarks(x, rate, unit, spikes)
        )
        if speed is not None:
            return judged  # the lines were looked for in shaft angle: nothing is smeared
        return self._unless_speed_changes(judged, record, x, frequencies)

    def _unless_speed_changes(
        self, judged: Finding, record: Record, x: AnyArray, frequencies: BearingFrequencies
    ) -> Finding:
        """The finding, or that the window cannot be judged where its lines were smeared.

        A changing speed smears the fast lines first: what is left says `healthy`, or names the
        cage, whose line is the slowest. Any other class stood out although it was smeared.
        """
        smeared = judged.verdict is Verdict.HEALTHY or judged.fault_class == CLASS_OF["ftf"]
        if smeared and (line := _moving(x, record, frequencies)):
            return Finding.not_assessable(self.name, line)
        return judged

    def _lines(
        self, record: Record, x: AnyArray, speed: str | None, frequencies: BearingFrequencies
    ) -> dict[str, LineEvidence]:
        """Evidence of each fault line, looked for in shaft angle where the speed varies."""
        if not frequencies.lines:
            return {}
        steady = at_steady_speed(x, record, speed, self.speed_rpm, in_hertz=bool(self.hertz))
        return line_evidence(steady, record.sampling_rate, frequencies)

    def _beside_lines(self, x: AnyArray, rate: float, knocks: list[float]) -> dict[str, Any]:
        """Evidence that names no part: velocity RMS and its zone where a machine class was given,
        and the times of knocks that were taken out [s].
        """
        evidence: dict[str, Any] = {}
        if self.machine_class:
            evidence["severity"] = vars(severity(x, rate, self.machine_class))
        if knocks:
            evidence["knocks_s"] = knocks
        return evidence

    def _judge(
        self,
        measured: _Measured,
        lines: Mapping[str, LineEvidence],
        unit: str,
        more: dict[str, Any],
    ) -> Finding:
        limits = self._limits(measured)
        values = dict(zip(SHAPE, map(float, measured.shape), strict=True)) | measured.bands
        changed = [name for name in limits if values[name] > limits[name]]
        prominences = {f"prominence_{name}": line.prominence for name, line in lines.items()}
        line_limits = self._line_limits(lines, bool(changed))
        likely = _likely(lines, line_limits)
        verdict, fault_class, reason = Verdict.HEALTHY, None, None
        if likely or changed:
            # two families that stand out nearly alike name no part
            fault_class = CLASS_OF[likely[0]] if len(likely) == 1 else "unknown"
            verdict, reason = Verdict.FAULTY, _says(likely, lines, changed, values, limits)
        evidence = {
            "lines": {name: vars(line) for name, line in lines.items()},
            "changed": changed,
            "baseline": self._baseline is not None,
        }
        if len(likely) > 1:
            evidence["likely"] = [CLASS_OF[name] for name in likely]
        return Finding(
            self.name,
            verdict,
            fault_class,
            {
                **values,
                **prominences,
                "severity": _largest_excess(values, limits, lines, line_limits),
            },
            {**limits, **line_limits, "severity": 1.0},
            {name: unit for name in values if name.startswith("rms")},
            {**evidence, **more},
            reason,
        )

    def _limits(self, measured: _Measured) -> dict[str, float]:
        baseline = self._baseline
        if baseline is None:
            return {"kurtosis": IMPULSIVE}
        share = self.false_alarm / (len(SHAPE) + len(measured.bands))
        limits: dict[str, float] = {}
        if measured.comparable:
            limits = dict(
                zip(SHAPE, map(float, baseline.shape.upper(share, _LEAST_CHANGE)), strict=True)
            )
        least = np.where(
            baseline.edges[:-1] >= 1000, _LEAST_CHANGE_OF_BAND[1], _LEAST_CHANGE_OF_BAND[0]
        )
        upper = dict(
            zip(
                _band_names(baseline.edges),
                map(float, baseline.bands.upper(share, least)),
                strict=True,
            )
        )
        return limits | {name: upper[name] for name in measured.bands} or {"kurtosis": IMPULSIVE}

    def _line_limits(self, names: Iterable[str], changed: bool) -> dict[str, float]:
        """From which prominence on each family means a fault, beside a changed level or without."""
        limit = PROMINENT
        usual: Mapping[str, float] = {}
        if self._baseline is not None:
            limit, usual = PROMINENT_WITHOUT_A_CHANGE, self._baseline.lines
        if changed:
            limit = PROMINENT_BESIDE_A_CHANGE
        return {
            f"prominence_{name}": max(limit, _OVER_HEALTHY * usual.get(name, 0.0)) for name in names
        }

    def _acceleration(self, record: Record) -> tuple[AnyArray, str]:
        """The vibration in m/s² (or without unit), float32 kept."""
        name = self.channel or next(
            (name for name in record.names if compatible(record.units[name], "m/s²")), None
        )
        if (
            name is None
            and len(record.names) == 1
            and compatible(record.units[record.names[0]], "")
        ):
            name = record.names[0]
        if name is None:
            raise BadInput(
                f"bearing: record {record.source!r} has no channel with a unit of acceleration, but"
                f" {dict(record.units)}",
                way_on=[("units", {record.names[0]: "g"})],
            )
        unit = record.units[name]
        if compatible(unit, ""):
            return record[name], ""
        gain = float(convert(1.0, unit, "m/s²", what=f"channel {name!r}"))
        return record[name] if gain == 1.0 else record[name] * record[name].dtype.type(gain), "m/s²"

    def _speed_channel(self, record: Record) -> str | None:
        """The channel of the shaft's speed; several are no reason to refuse a record that does not
        need one.
        """
        speed_is_optional = self.hertz or self.speed_rpm or not self.orders
        return only_speed_channel(record) if speed_is_optional else speed_channel(record)

    def _frequencies(self, record: Record, channel: str | None) -> BearingFrequencies:
        """Fault frequencies at the record's speed; without lines where no bearing was described."""
        speed = self.speed_rpm or usual_speed(record, channel)
        if self.hertz:
            return BearingFrequencies.from_hertz(self.hertz, speed / 60 if speed else None)
        if not self.orders:
            return BearingFrequencies({})
        if speed:
            return BearingFrequencies.from_orders(self.orders, speed / 60)
        wrong, way_on = unusable_speeds(record)
        raise BadInput(
            "bearing: orders are multiples of shaft speed; give speed_rpm, or a record with a speed"
            " channel" + (f" ({wrong})" if wrong else ""),
            way_on=way_on,
        )

    def save(self, path: str | Path) -> None:
        """Store the baseline and the bearing's frequencies."""
        baseline = self._baseline
        if baseline is None:
            raise NotTrained("bearing: has no baseline to store; train it on healthy records first")
        meta = {
            "orders": self.orders,
            "hertz": self.hertz,
            "speed_rpm": self.speed_rpm,
            "channel": self.channel,
            "machine_class": self.machine_class,
            "false_alarm": self.false_alarm,
            "baseline": {
                "sampling_rate": baseline.sampling_rate,
                "window": baseline.window,
                "n": baseline.shape.n,
                "lines": dict(baseline.lines),
            },
        }
        arrays = {
            "shape_mean": baseline.shape.mean,
            "shape_scatter": baseline.shape.scatter,
            "edges": baseline.edges,
            "bands_mean": baseline.bands.mean,
            "bands_scatter": baseline.bands.scatter,
        }
        save_stored(path, self.name, _VERSION, meta, arrays)

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """The diagnoser that `save` stored."""
        stored = load_stored(path, cls.name)
        meta, a = dict(stored.meta), stored.arrays
        try:
            b = meta.pop("baseline")
            diagnoser = cls(**meta)
            diagnoser._baseline = _Baseline(
                b["sampling_rate"],
                b["window"],
                HealthyBand(a["shape_mean"], a["shape_scatter"], b["n"]),
                a["edges"],
                HealthyBand(a["bands_mean"], a["bands_scatter"], b["n"]),
                b["lines"],
            )
        except (KeyError, TypeError) as error:
            raise BadInput(f"{path}: is not a complete bearing baseline: {error}") from None
        return diagnoser

    @classmethod
    def examples(cls) -> Sequence[Example]:
        """A deep-groove bearing at 30 Hz, 12 kHz: noise and shaft harmonics, with impacts of an
        inner- or outer-race fault.
        """
        training = [_example_record(None, seed=1, seconds=8.0)]
        healthy = [_example_record(None, seed=seed) for seed in (2, 3)]
        faulty = [_example_record("bpfi", seed=4), _example_record("bpfo", seed=5)]
        return (Example(training, None, healthy, faulty),)


@dataclass(frozen=True, eq=False)
class _Measured:
    """Indicators of a record: medians over windows; `comparable` when rate (and so bandwidth) is
    the baseline's.
    """

    shape: AnyArray
    bands: dict[str, float]
    comparable: bool

    @classmethod
    def of(cls, x: AnyArray, rate: float, baseline: _Baseline | None) -> _Measured:
        parts = _windows(x, rate, baseline.window if baseline else _WINDOW)
        shape = np.median([_shape(part) for part in parts], axis=0)
        if baseline is None:
            return cls(shape, {}, comparable=False)
        comparable = abs(rate / baseline.sampling_rate - 1) < 0.005
        # below both recorders' own filters
        top = rate / 2 if comparable else 0.4 * min(rate, baseline.sampling_rate)
        bands = np.median([octave_rms(part, rate, baseline.edges) for part in parts], axis=0)
        usable = (
            baseline.edges[1:] <= top * (1 + 1e-6)
            if not comparable
            else np.ones(bands.shape, dtype=bool)
        )
        names = _band_names(baseline.edges)
        return cls(
            shape,
            {
                name: float(value)
                for name, value, use in zip(names, bands, usable, strict=True)
                if use
            },
            comparable,
        )


def _refuse_settings(
    orders: Mapping[str, float] | None,
    hertz: Mapping[str, float] | None,
    speed_rpm: float | None,
    machine_class: str | None,
    false_alarm: float,
) -> None:
    """BadInput for settings that contradict each other or that no bearing has."""
    if orders and hertz:
        raise BadInput("bearing: orders and hertz are given; must be one of them")
    if speed_rpm is not None and not 0 < speed_rpm < np.inf:
        raise BadInput(f"bearing: speed_rpm is {speed_rpm!r}; must be a positive number")
    if not 0 < false_alarm < 0.5:
        raise BadInput(f"bearing: false_alarm is {false_alarm!r}; must be between 0 and 0.5")
    if machine_class is not None and machine_class not in LIMITS:
        raise BadInput(
            f"bearing: machine class {machine_class!r} is not known;"
            f" {known_names(machine_class, LIMITS)}"
        )
    # made for their refusals alone: the shaft's frequency is not known before there is a record
    if orders:
        BearingFrequencies.from_orders(orders, 1.0)
    if hertz:
        BearingFrequencies.from_hertz(hertz)


def _healthy(records: Sequence[Record], labels: Sequence[str] | None) -> list[Record]:
    """The healthy ones of the records, long ones in blocks; BadInput when they differ in rate."""
    if labels is not None and len(labels) != len(records):
        raise BadInput(
            f"bearing: {len(records)} records but {len(labels)} labels; must be one each"
        )
    healthy = [
        record for k, record in enumerate(records) if labels is None or labels[k] == "healthy"
    ]
    rates = {round(record.sampling_rate, 3) for record in healthy}
    if len(rates) != 1:
        raise BadInput(
            f"bearing: healthy records of {sorted(rates)} Hz; must be of one rate; train one"
            " baseline a rate"
        )
    return [block for record in healthy for block in blocks_of(record)]


def _keep_largest(
    lines: dict[str, float], parts: list[AnyArray], rate: float, frequencies: BearingFrequencies
) -> None:
    """Raise `lines` to how prominent each family is in healthy signals anyway: the largest over
    them.
    """
    for part in parts:
        for name, evidence in line_evidence(part, rate, frequencies).items():
            lines[name] = max(lines.get(name, -np.inf), evidence.prominence)


def _windows(x: AnyArray, rate: float, window: float) -> list[AnyArray]:
    """Whole windows of `window` seconds; the record itself when it is shorter than one."""
    n = round(window * rate)
    return [x[start : start + n] for start in range(0, x.shape[0] - n + 1, n)] or [x]


def _shape(x: AnyArray) -> list[float]:
    statistics = indicators(x - x.mean())
    return [statistics.rms, statistics.kurtosis, statistics.crest]


def _band_names(edges: AnyArray) -> list[str]:
    return [f"rms_{low:.4g}_{high:.4g}_hz" for low, high in pairwise(edges)]


def _likely(lines: Mapping[str, LineEvidence], limits: Mapping[str, float]) -> list[str]:
    """The family that stands out most, and the next one where it stands out nearly as much: then
    neither can be named.
    """
    named = _most_prominent(lines, limits)
    if named is None or named == "ftf":
        return [named] if named else []
    least = _RIVAL * lines[named].prominence
    rivals = [
        name
        for name in _over(lines, limits)
        if name not in (named, "ftf") and lines[name].prominence >= least
    ]
    return [named, *sorted(rivals, key=lambda name: -lines[name].prominence)[:1]]


def _over(lines: Mapping[str, LineEvidence], limits: Mapping[str, float]) -> dict[str, float]:
    """Prominence of the families that mean a fault."""
    return {
        name: line.prominence
        for name, line in lines.items()
        if line.prominence > limits[f"prominence_{name}"] and line.depth >= DEPTH
    }


def _most_prominent(lines: Mapping[str, LineEvidence], limits: Mapping[str, float]) -> str | None:
    """The family that stands out most; the cage only when it does so by a quarter, and no ball does
    so half as much.

    A damaged ball passes the load once a turn of the cage, which puts the cage's line beside its
    own. The cage's harmonics in turn meet the others' lines: BPFO = N FTF.
    """
    over = _over(lines, limits)
    named = max(
        over, key=lambda name: over[name] / (_CAGE_LEADS_BY if name == "ftf" else 1.0), default=None
    )
    if named == "ftf" and "bsf" in lines and lines["bsf"].depth >= DEPTH:
        least, share = _BALL_BESIDE_CAGE
        return "bsf" if lines["bsf"].prominence >= max(least, share * over["ftf"]) else "ftf"
    return named


def _largest_excess(
    values: Mapping[str, float],
    limits: Mapping[str, float],
    lines: Mapping[str, LineEvidence],
    line_limits: Mapping[str, float],
) -> float:
    """The largest indicator or line as a multiple of its limit.

    A line family that modulates the envelope by less than `DEPTH` counts for as much less.
    """
    levels = [values[name] / limits[name] for name in limits]
    prominences = [
        line.prominence / line_limits[f"prominence_{name}"] * min(1.0, line.depth / DEPTH)
        for name, line in lines.items()
    ]
    return max(levels + prominences)


def _says(
    likely: list[str],
    lines: Mapping[str, LineEvidence],
    changed: list[str],
    values: Mapping[str, float],
    limits: Mapping[str, float],
) -> str:
    parts = []
    for name in likely:
        line = lines[name]
        parts.append(
            f"the envelope of {line.low:.0f}–{line.high:.0f} Hz is modulated by"
            f" {100 * line.depth:.0f} % at {line.frequency:.1f} Hz and its harmonics"
            f" ({name.upper()}: {line.expected:.1f} Hz), {line.prominence:.1f} deciles above the"
            " control frequencies"
        )
    if len(likely) > 1:
        parts.append(
            f"{' and '.join(CLASS_OF[name] for name in likely)} are alike: neither can be named"
        )
    if changed:
        worst = max(changed, key=lambda name: values[name] / limits[name])
        parts.append(f"{worst} is {values[worst]:.3g} against a limit of {limits[worst]:.3g}")
    return "; ".join(parts)


def _held(finding: Finding) -> str:
    """The limits that a finding holds, each with its value."""
    names = [name for name in finding.thresholds if name != "severity"]
    held = [
        f"{name} {finding.indicators[name]:.3g} of {finding.thresholds[name]:.3g}" for name in names
    ]
    return ", ".join(held) + "; train on healthy records for a baseline"


def _moving(x: AnyArray, record: Record, frequencies: BearingFrequencies) -> str:
    """Why no line that was not found says anything: the vibration shows a changing speed; empty for
    a steady one.
    """
    lines = {name: f for name, f in frequencies.lines.items() if name != "ftf"}
    line = moving_line(x, record.sampling_rate, lines) if lines else None
    if line is None:
        return ""
    return (
        f"a line of the envelope goes from {line.first:.0f} to {line.last:.0f} Hz within"
        f" {line.seconds:.2g} s: the shaft changes its speed and no channel tells it; record the"
        " speed beside the vibration, or judge a stretch of steady speed"
    )


def _slowest(frequencies: BearingFrequencies) -> float | None:
    return min(frequencies.lines.values(), default=None)


def _example_record(fault: Any, seed: int, seconds: float = 2.0) -> Record:
    rate, shaft = 12000.0, 30.0
    orders = {"bpfi": 5.4152, "bpfo": 3.5848, "bsf": 2.357, "ftf": 0.398}
    n = round(seconds * rate)
    x = faulty_bearing(n, rate, shaft, orders, fault, snr_db=3.0, seed=seed)
    return Record(
        {"acceleration": x, "speed": np.full(n, 60 * shaft)},
        {"acceleration": "m/s²", "speed": "rpm"},
        1 / rate,
        source="example",
    )
