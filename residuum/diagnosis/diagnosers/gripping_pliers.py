"""Gripping pliers: posterior bearings judged by the envelope of a frame accelerometer, round by
round.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np

from residuum.array_types import AnyArray
from residuum.diagnosis.diagnosers.base import Channel, Diagnoser, Example, NotTrained
from residuum.diagnosis.finding import Finding, Verdict
from residuum.diagnosis.learning.stored import load_stored, save_stored
from residuum.diagnosis.thresholds.tails import HealthyBand
from residuum.diagnosis.vibration.rotation import (
    RoundComparison,
    Rounds,
    compare_rounds,
    cut_rounds,
    round_profile,
)
from residuum.diagnosis.vibration.sensor_health import (
    hears_otherwise,
    remarks,
    suspect,
    unusable,
    without_spikes,
)
from residuum.diagnosis.vibration.spectra import Band, Kurtogram, band_envelope, kurtogram
from residuum.diagnosis.vibration.vibration_indicators import indicators
from residuum.identification.errors import BadInput, NotIdentifiable
from residuum.identification.record import Record

QUADRANTS = 4
OF_ROUND = ("kurtosis", "rms", "crest", "impulsiveness")
OF_QUADRANT = ("kurtosis", "rms")
NAMES = (*OF_ROUND, *(f"{name}_q{q + 1}" for name in OF_QUADRANT for q in range(QUADRANTS)))
_LEAST_CHANGE: AnyArray = np.array(
    [1.3 if name.startswith(("kurtosis", "crest", "impulsiveness")) else 1.15 for name in NAMES]
)
_LEAST_BAND_CHANGE = 1.5
_VERSION = 1


class GrippingPliers(Diagnoser):
    """Algorithm 7 of the source with thresholds from healthy rounds, and a look at all other bands.

    Training: the kurtogram of the healthy (and, when there are some, faulty) rounds chooses the
    band f_c ± b/2. For each round the envelope r_e(t) of that band gives kurtosis, RMS, crest
    factor and impulsiveness, and kurtosis and RMS in each quadrant. The limit of each indicator is
    the one-sided prediction limit of a log-normal healthy round. Because the healthy kurtogram
    cannot know which band a fault will excite, every band of the kurtogram is held against its own
    healthy limit too: its RMS in each quadrant and its kurtosis. This also tells where in the
    round, and at which frequency, the machine differs from its healthy self.

    A record of one round is faulty when an indicator passes its limit; a record of many when at
    least two rounds do. False alarms: `false_alarm` a round, shared over all limits (Bonferroni),
    if healthy logarithms are normal. Fails when the speed differs from the trained one (the source
    assumes constant speed): such records are not assessed.

    Parameters
    ----------
    false_alarm : float
        Probability that a healthy round passes any limit.
    minimum_rounds : int
        Fewest healthy rounds to train on.
    levels : int
        Depth of the kurtogram; 4 and its thirds give bands down to 133 Hz at 12.8 kHz.

    References
    ----------
    N. Valceschini, Data-Driven Robust Control and Diagnosis, chapter 6, Algorithm 7, Remarks 6.1
    and 6.2.
    """

    name: ClassVar[str] = "gripping-pliers"
    channels: ClassVar[Sequence[Channel]] = (
        Channel("acceleration", "m/s²", "vibration of the frame beside the cam"),
        Channel("indicator", "", "1 while a plier passes the sensor; four pulses a round"),
        Channel("speed", "rpm", "speed of the pliers' rotor", required=False),
        Channel("current", "A", "quadrature current of the pliers' motor", required=False),
        Channel("temperature", "°C", "temperature of the pliers' motor", required=False),
    )
    classes: ClassVar[Sequence[str]] = ("plier-bearing",)

    def __init__(
        self, *, false_alarm: float = 1e-5, minimum_rounds: int = 10, levels: int = 5
    ) -> None:
        if not 0 < false_alarm < 0.5:
            raise BadInput(
                f"gripping-pliers: false_alarm is {false_alarm!r}; must be between 0 and 0.5"
            )
        if minimum_rounds < 3:
            raise BadInput(
                f"gripping-pliers: minimum_rounds is {minimum_rounds!r}; must be at least 3"
            )
        self.false_alarm, self.minimum_rounds, self.levels = false_alarm, minimum_rounds, levels
        self._baseline: _Baseline | None = None

    @property
    def band(self) -> Band:
        """The band that training chose."""
        return self._trained().band

    def fit(self, records: Sequence[Record], labels: Sequence[str] | None = None) -> Self:
        """Learn limits from the healthy records; faulty ones (any other label) only help to choose
        the band.

        Raises NotIdentifiable when there are fewer healthy rounds than `minimum_rounds`, BadInput
        when records differ in rate or cannot be used (the reason is the one `score` would give).
        """
        labels = ["healthy"] * len(records) if labels is None else list(labels)
        if len(labels) != len(records):
            raise BadInput(
                f"gripping-pliers: {len(records)} records but {len(labels)} labels; must be one"
                " each"
            )
        pairs = list(zip(records, labels, strict=True))
        # healthy ones first: theirs is the refusal where several records cannot be used
        healthy = [_RoundsOf(record) for record, label in pairs if label == "healthy"]
        faulty = [_RoundsOf(record) for record, label in pairs if label != "healthy"]
        _refuse_unusable([*healthy, *faulty])
        rates = {round(part.record.sampling_rate, 3) for part in (*healthy, *faulty)}
        count = sum(part.rounds.count for part in healthy)
        if count < self.minimum_rounds:
            raise NotIdentifiable(
                f"gripping-pliers: {count} healthy rounds; at least {self.minimum_rounds} are"
                " needed"
            )
        if len(rates) != 1:
            raise BadInput(
                f"gripping-pliers: records of {sorted(rates)} Hz; all must have one rate; train one"
                " baseline a rate"
            )
        self._baseline = _Baseline.of(healthy, faulty, self.levels)
        return self

    def score(self, record: Record) -> Finding:
        """Judge every complete round of the record; reported are medians over rounds, of quadrants
        geometric means.
        """
        baseline = self._trained()
        part = _RoundsOf(record)
        reason = part.reason or baseline.mismatch(part)
        if reason:
            return Finding.not_assessable(self.name, reason)
        measured, bands = part.measure(baseline.band, self.levels)
        if not (np.isfinite(measured).all() and np.isfinite(bands).all()):
            return Finding.not_assessable(
                self.name, "a band holds no signal: its envelope is constant"
            )
        if reason := baseline.deaf(bands):
            return Finding.not_assessable(self.name, reason)
        return self._judge(baseline, part, measured, bands)

    def compare(self, record: Record) -> RoundComparison:
        """The record's rounds overlapped with the healthy band; BadInput with the reason when it
        cannot be assessed.
        """
        baseline = self._trained()
        part = _RoundsOf(record)
        if reason := part.reason or baseline.mismatch(part):
            raise BadInput(
                f"gripping-pliers: record {record.source!r} cannot be compared: {reason}"
            )
        return compare_rounds(
            baseline.profile, part.profiles(baseline.band), self.false_alarm, QUADRANTS
        )

    def _judge(
        self, baseline: _Baseline, part: _RoundsOf, measured: AnyArray, bands: AnyArray
    ) -> Finding:
        share = self.false_alarm / (len(NAMES) + bands[0].size)
        limits = baseline.indicators.upper(share, _LEAST_CHANGE)
        band_limits = baseline.bands.upper(share, _LEAST_BAND_CHANGE)
        exceeding = (measured > limits).any(axis=1) | (bands > band_limits).any(axis=(1, 2))
        faulty = int(exceeding.sum()) >= min(2, exceeding.shape[0])
        shown = exceeding if faulty else slice(None)
        values, excess = (
            np.median(measured[shown], axis=0),
            np.median(bands[shown] / band_limits, axis=0),
        )
        # Impacts scatter log-normally: of few rounds the geometric mean tells quadrants apart more
        # surely than the median does.
        evidence = self._evidence(baseline, part, excess, np.exp(np.log(bands[shown]).mean(axis=0)))
        evidence |= {"rounds": part.rounds.count, "exceeding_rounds": int(exceeding.sum())}
        figures = dict(zip(NAMES, map(float, values), strict=True)) | {
            "band_excess": float(excess.max())
        }
        thresholds = dict(zip(NAMES, map(float, limits), strict=True)) | {"band_excess": 1.0}
        units = {name: "m/s²" for name in NAMES if name.startswith("rms")}
        verdict, fault_class = (
            (Verdict.FAULTY, "plier-bearing") if faulty else (Verdict.HEALTHY, None)
        )
        says = _says(figures, thresholds, evidence) if faulty else None
        return Finding(
            self.name, verdict, fault_class, figures, thresholds, units, evidence, says
        ).with_remarks(part.remarks)

    def _evidence(
        self, baseline: _Baseline, part: _RoundsOf, excess: AnyArray, bands: AnyArray
    ) -> dict[str, Any]:
        row, column = np.unravel_index(int(np.argmax(excess)), excess.shape)
        differs = part.axes(self.levels).band(int(row))
        quadrant_ratio = (bands[row] / np.exp(baseline.bands.mean[row]))[:QUADRANTS]
        known = part.rounds.phase is not None
        return {
            "band": {"centre": baseline.band.centre, "width": baseline.band.width, "unit": "Hz"},
            "differs_most": {
                "centre": differs.centre,
                "width": differs.width,
                "unit": "Hz",
                "in": f"quadrant {column + 1}" if column < QUADRANTS else "kurtosis over the round",
                "quadrant_rms_ratio": quadrant_ratio,
            },
            # Remark 6.2: the plier whose pulse opens a quadrant is the one that the sensor hears
            # there.
            "loudest_plier": int(np.argmax(quadrant_ratio)) + 1 if known else None,
            "baseline_rounds": baseline.indicators.n,
        }

    def save(self, path: str | Path) -> None:
        """Store limits and band."""
        baseline = self._trained()
        meta = {
            "false_alarm": self.false_alarm,
            "minimum_rounds": self.minimum_rounds,
            "levels": self.levels,
            "sampling_rate": baseline.sampling_rate,
            "round_duration": baseline.round_duration,
            "marked": baseline.marked,
            "band": vars(baseline.band),
            "n": baseline.indicators.n,
        }
        arrays = {
            "indicator_mean": baseline.indicators.mean,
            "indicator_scatter": baseline.indicators.scatter,
            "band_mean": baseline.bands.mean,
            "band_scatter": baseline.bands.scatter,
            "profile_mean": baseline.profile.mean,
            "profile_scatter": baseline.profile.scatter,
        }
        save_stored(path, self.name, _VERSION, meta, arrays)

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """The diagnoser that `save` stored."""
        stored = load_stored(path, cls.name)
        meta, arrays = stored.meta, stored.arrays
        try:
            diagnoser = cls(
                false_alarm=meta["false_alarm"],
                minimum_rounds=meta["minimum_rounds"],
                levels=meta["levels"],
            )
            diagnoser._baseline = _Baseline(
                Band(**meta["band"]),
                HealthyBand(arrays["indicator_mean"], arrays["indicator_scatter"], meta["n"]),
                HealthyBand(arrays["band_mean"], arrays["band_scatter"], meta["n"]),
                HealthyBand(arrays["profile_mean"], arrays["profile_scatter"], meta["n"]),
                meta["sampling_rate"],
                meta["round_duration"],
                meta["marked"],
            )
        except (KeyError, TypeError) as error:
            raise BadInput(f"{path}: is not a complete gripping-pliers baseline: {error}") from None
        return diagnoser

    def _trained(self) -> _Baseline:
        if self._baseline is None:
            raise NotTrained("gripping-pliers: has no baseline; train it on healthy records first")
        return self._baseline

    @classmethod
    def examples(cls) -> Sequence[Example]:
        """Rounds of 2 s with four mild impacts; the faulty ones ring at 1.5 kHz in the third
        quadrant.
        """
        training = [_example_record(rounds=12, seed=1)]
        healthy = [_example_record(rounds=1, seed=seed) for seed in (2, 3)]
        faulty = [_example_record(rounds=1, seed=seed, damage=2.5) for seed in (4, 5)]
        return (Example(training, None, healthy, faulty),)


class _RoundsOf:
    """A record cut into rounds, or the reason why it cannot be."""

    def __init__(self, record: Record) -> None:
        self.record = record
        self.acceleration = record.in_unit("acceleration", "m/s²")
        indicator = record.in_unit("indicator", "")
        self.rounds = Rounds(np.empty((0, QUADRANTS + 1), dtype=int), None)
        self.reason = unusable(self.acceleration) or suspect(
            self.acceleration, record.sampling_rate
        )
        self.remarks: list[str] = []
        if self.reason is None:
            self.acceleration, spikes = without_spikes(self.acceleration)
            self.remarks = remarks(self.acceleration, record.sampling_rate, "m/s²", spikes)
            try:
                self.rounds = cut_rounds(indicator, QUADRANTS)
            except BadInput as error:
                self.reason = str(error)

    @property
    def round_duration(self) -> float:
        """Median duration of a round [s]."""
        return float(np.median(np.diff(self.rounds.edges[:, [0, -1]]))) * self.record.sample_time

    def segments(self) -> list[AnyArray]:
        """The acceleration of each round."""
        return [self.acceleration[first:last] for first, last in self.rounds.edges[:, [0, -1]]]

    def axes(self, levels: int) -> Kurtogram:
        """A kurtogram of the first round, for its bands."""
        return kurtogram(self.segments()[0], self.record.sampling_rate, levels, method="fft")

    def envelope(self, a: AnyArray, edges: AnyArray, band: Band) -> tuple[AnyArray, list[AnyArray]]:
        """Envelope of one round in the band, and its quadrants from the first to the last."""
        envelope = band_envelope(
            a - a.mean(), self.record.sampling_rate, band.low, band.high, decimate=False
        ).values
        parts = np.split(envelope, (edges - edges[0])[1:-1])
        return envelope, [parts[s] for s in self._segment_of_quadrant()]

    def profiles(self, band: Band) -> AnyArray:
        """Envelope RMS along each round, shape (rounds, PLACES)."""
        pairs = zip(self.segments(), self.rounds.edges, strict=True)
        return np.array([round_profile(self.envelope(a, edges, band)[1]) for a, edges in pairs])

    def measure(self, band: Band, levels: int) -> tuple[AnyArray, AnyArray]:
        """What is judged of each round.

        Indicators of the chosen band, shape (rounds, indicators); of every band of the kurtogram
        the RMS in the quadrants and E|c|⁴ / (E|c|²)², shape (rounds, bands, quadrants + 1).
        """
        measured, bands = [], []
        order = self._segment_of_quadrant()
        for a, edges in zip(self.segments(), self.rounds.edges, strict=True):
            measured.append(_indicators(*self.envelope(a, edges, band)))
            k = kurtogram(a, self.record.sampling_rate, levels, segments=QUADRANTS, method="fft")
            bands.append(
                np.column_stack(
                    [np.sqrt(k.power[:, order]), k.kurtosis + np.where(k.level == 0, 3.0, 2.0)]
                )
            )
        return np.array(measured), np.array(bands)

    def _segment_of_quadrant(self) -> list[int]:
        return sorted(range(QUADRANTS), key=self.rounds.quadrant)


def _refuse_unusable(parts: Sequence[_RoundsOf]) -> None:
    for part in parts:
        if part.reason:
            raise BadInput(
                f"gripping-pliers: record {part.record.source!r} cannot be trained on:"
                f" {part.reason}"
            )


def _indicators(envelope: AnyArray, quadrants: list[AnyArray]) -> list[float]:
    whole, parts = indicators(envelope), [indicators(quadrant) for quadrant in quadrants]
    return [
        *(getattr(whole, name) for name in OF_ROUND),
        *(getattr(part, name) for name in OF_QUADRANT for part in parts),
    ]


@dataclass(frozen=True, eq=False)
class _Baseline:
    """What healthy rounds showed; `marked`: a longer pulse tells the quadrants apart."""

    band: Band
    indicators: HealthyBand
    bands: HealthyBand
    profile: HealthyBand
    sampling_rate: float
    round_duration: float
    marked: bool

    def deaf(self, bands: AnyArray) -> str | None:
        """Why the sensor does not hear what it heard at training, by the RMS in each band of the
        kurtogram.
        """
        healthy = np.exp(self.bands.mean)[:, :QUADRANTS].mean(axis=1)
        current = np.median(bands[:, :, :QUADRANTS], axis=0).mean(axis=1)
        return hears_otherwise(healthy, current)

    @classmethod
    def of(cls, healthy: list[_RoundsOf], faulty: list[_RoundsOf], levels: int) -> _Baseline:
        band = _choose_band(healthy, faulty, levels)
        measurements = [part.measure(band, levels) for part in healthy]
        measured, bands = (np.concatenate([pair[k] for pair in measurements]) for k in (0, 1))
        profiles = np.concatenate([part.profiles(band) for part in healthy])
        marked = all(part.rounds.phase is not None for part in healthy)
        if not marked:  # no pulse says which quadrant is which: all four share one limit
            measured, bands, profiles = _pooled(measured, bands, profiles)
        rate = healthy[0].record.sampling_rate
        duration = float(np.median([part.round_duration for part in healthy]))
        return cls(
            band,
            HealthyBand.of(measured),
            HealthyBand.of(bands),
            HealthyBand.of(profiles),
            rate,
            duration,
            marked,
        )

    def mismatch(self, part: _RoundsOf) -> str | None:
        """Why a record does not fit the baseline; None when it does."""
        rate = part.record.sampling_rate
        if abs(rate / self.sampling_rate - 1) > 0.005:
            return f"the rate is {rate:g} Hz; the baseline is of {self.sampling_rate:g} Hz"
        if abs(part.round_duration / self.round_duration - 1) > 0.1:
            return (
                f"a round takes {part.round_duration:.3g} s; the baseline is of rounds of"
                f" {self.round_duration:.3g} s"
            )
        if self.marked and part.rounds.phase is None:
            return (
                "no longer pulse marks the first quadrant; the baseline knows the quadrants apart"
            )
        return None


def _choose_band(healthy: list[_RoundsOf], faulty: list[_RoundsOf], levels: int) -> Band:
    """The band of the largest kurtosis: of the faulty rounds relative to the healthy ones when
    there are any.
    """
    of_healthy = _mean_kurtogram(healthy, levels)
    if not faulty:
        return of_healthy.best
    of_faulty = _mean_kurtogram(faulty, levels)
    narrow = of_faulty.level > 0
    return of_faulty.band(
        int(np.argmax(np.where(narrow, (of_faulty.kurtosis + 2) / (of_healthy.kurtosis + 2), 0.0)))
    )


def _mean_kurtogram(parts: list[_RoundsOf], levels: int) -> Kurtogram:
    """The kurtogram of all rounds together, without anything outside complete rounds."""
    every = np.concatenate([a for part in parts for a in part.segments()])
    return kurtogram(every, parts[0].record.sampling_rate, levels)


def _pooled(
    measured: AnyArray, bands: AnyArray, profiles: AnyArray
) -> tuple[AnyArray, AnyArray, AnyArray]:
    """Every round turned by 0, 1, 2, 3 quadrants, so that all quadrants share one distribution."""
    turns = [np.roll(np.arange(QUADRANTS), turn) for turn in range(QUADRANTS)]
    first = len(OF_ROUND)
    of_quadrant = measured[:, first:].reshape(-1, len(OF_QUADRANT), QUADRANTS)
    turned = [
        np.concatenate(
            [measured[:, :first], of_quadrant[:, :, turn].reshape(len(measured), -1)], axis=1
        )
        for turn in turns
    ]
    along = profiles.reshape(len(profiles), QUADRANTS, -1)
    return (
        np.concatenate(turned),
        np.concatenate([bands[:, :, [*turn, QUADRANTS]] for turn in turns]),
        np.concatenate([along[:, turn].reshape(len(profiles), -1) for turn in turns]),
    )


def _says(figures: dict[str, float], thresholds: dict[str, float], evidence: dict[str, Any]) -> str:
    worst = max(thresholds, key=lambda name: figures[name] / thresholds[name])
    differs = evidence["differs_most"]
    return (
        f"{worst} is {figures[worst]:.3g} against a limit of {thresholds[worst]:.3g}; the machine"
        f" differs most from its healthy self around {differs['centre']:.0f} Hz ({differs['in']})"
    )


def _example_record(rounds: int, seed: int, damage: float = 0.0) -> Record:
    """Rounds of 2 s at 12.8 kHz: noise, an impact a quadrant at 3 kHz, and with damage five impacts
    at 1.5 kHz in Q3.
    """
    rng = np.random.default_rng(seed)
    rate, quadrant = 12800.0, 6400
    n = rounds * QUADRANTS * quadrant
    k = np.arange(n)
    ring = np.exp(-400 * np.arange(256) / rate) * np.sin(
        2 * np.pi * np.arange(256) / rate * np.array([[1500.0], [3000.0]])
    )
    impacts = np.zeros((2, n))
    impacts[1, 2000::quadrant] = 0.8 * (
        1 + 0.1 * rng.standard_normal(impacts[1, 2000::quadrant].shape[0])
    )
    in_third = (k // quadrant % QUADRANTS == 2) & (k % 1280 == 500)
    impacts[0, in_third] = damage * (1 + 0.2 * rng.standard_normal(int(in_third.sum())))
    a = 0.3 * rng.standard_normal(n) + sum(
        np.convolve(impact, h)[:n] for impact, h in zip(impacts, ring, strict=True)
    )
    width = np.where(k // quadrant % QUADRANTS == 0, 1024, 512)
    indicator = (k % quadrant < width).astype(float)
    return Record(
        {"acceleration": a, "indicator": indicator},
        {"acceleration": "m/s²", "indicator": ""},
        1 / rate,
        source="example",
    )
