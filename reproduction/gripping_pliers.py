"""Fig. 73–77 and Table 6: the gripping pliers' damaged bearing, on the virtual machine."""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import plotly.graph_objects as go

from reproduction.item import Item
from residuum.diagnosis.thresholds.healthy_band import HealthyBand
from residuum.diagnosis.vibration.envelope import band_envelope
from residuum.diagnosis.vibration.kurtogram import Band, Kurtogram, kurtogram
from residuum.diagnosis.vibration.round_comparison import RoundComparison, compare_rounds, round_profile
from residuum.diagnosis.vibration.rounds import cut_rounds
from residuum.diagnosis.vibration.vibration_indicators import indicators
from residuum.identification.record import Record
from residuum.simulation import MACHINES

RATE, DURATION, UNLOADED = 12800.0, 180.0, 40.0  # Hz, s, s without preforms
G = 9.80665  # m/s²
LEVELS, QUADRANTS = 5, 4
SOURCE_BAND = (1533.3, 133.3)  # f_c and whole width [Hz]: band 11 of 48
SOURCE_TABLE = {"kurtosis": (6.1, 5.7, 101.3, 1617.0), "rms": (0.0075, 0.0075, 0.0165, 120.0)}
_NAMES = {"kurtosis": "kurtosis", "rms": "RMS [g]"}
NEAR = 0.25  # of the source's variation: what is called agreement
FALSE_ALARM = 1e-5  # of a healthy round
COLOURS = {"H1": "#1a1f26", "H2": "#8a97a6", "F": "#b3541e"}


@dataclass(frozen=True)
class _Test:
    """One three-minute test in one band: acceleration and envelope [g], envelope RMS along each round."""

    acceleration: np.ndarray
    envelope: np.ndarray
    profiles: np.ndarray

    @classmethod
    def of(cls, record: Record, low: float, high: float) -> "_Test":
        a = record["acceleration"] / G
        envelope = band_envelope(a - a.mean(), RATE, low, high, decimate=False).values
        rounds = cut_rounds(record["indicator"], QUADRANTS)
        order = sorted(range(QUADRANTS), key=rounds.quadrant)
        segments = ([envelope[first:last] for first, last in pairwise(edges)] for edges in rounds.edges)
        return cls(a, envelope, np.array([round_profile([parts[k] for k in order]) for parts in segments]))


def bench_records() -> dict[str, Record]:
    """Healthy tests H1 and H2 and the faulty test F: three minutes each, the first 40 s without load."""
    records = {}
    for seed, (name, faults) in enumerate({"H1": {}, "H2": {}, "F": {"plier-bearing": 1.0}}.items(), start=1):
        signals = MACHINES["gripping-pliers"](seed=seed, faults=faults, preforms_after=UNLOADED).simulate(DURATION)
        records[name] = Record(signals.channels, signals.units, signals.sample_time, source=f"virtual pliers, {name}")
    return records


def items() -> list[Item]:
    """Fig. 73 (signals), 74 (kurtogram), 75 and Table 6 (envelope), 76 (rounds), 77 (quadrants)."""
    records = bench_records()
    picture = kurtogram(records["F"]["acceleration"] / G, RATE, LEVELS)
    band = picture.best
    tests = {name: _Test.of(record, band.low, band.high) for name, record in records.items()}
    healthy = HealthyBand.of(tests["H1"].profiles)
    compared = {name: compare_rounds(healthy, test.profiles, FALSE_ALARM, QUADRANTS) for name, test in tests.items()}
    return [
        _signals(tests),
        _kurtogram(picture, band),
        _table_6(tests, band),
        _rounds(compared),
        _quadrants(compared),
    ]


def _signals(tests: Mapping[str, _Test]) -> Item:
    first = {name: indicators(tests[name].acceleration[: round(UNLOADED * RATE)]) for name in ("H1", "F")}
    rows = [("test", "RMS [g]", "peak [g]", "kurtosis")]
    rows += [(name, f"{x.rms:.4f}", f"{x.peak:.3f}", f"{x.kurtosis:.2f}") for name, x in first.items()]
    healthy, faulty = first["H1"], first["F"]
    says = f"peak {healthy.peak:.3f} → {faulty.peak:.3f} g, kurtosis {healthy.kurtosis:.2f} → {faulty.kurtosis:.2f} over 40 s"
    figure = _time_figure({name: tests[name].acceleration for name in ("F", "H1")}, "a [g]")
    agrees = faulty.peak > 1.2 * healthy.peak and faulty.kurtosis > healthy.kurtosis
    return Item("Fig. 73", "Vibration, first 40 s", "a difference is already visible on raw data", says, agrees, rows, [figure])


def _kurtogram(picture: Kurtogram, band: Band) -> Item:
    rows = [("", "centre [Hz]", "whole width [Hz]", "kurtosis of the band")]
    rows.append(("source", "1533", "133", "not printed"))
    rows += [(f"ours, {n}.", f"{b.centre:.0f}", f"{b.width:.0f}", f"{b.kurtosis:.1f}") for n, b in enumerate(_best(picture), 1)]
    same = abs(band.centre - SOURCE_BAND[0]) < 1 and abs(band.width - SOURCE_BAND[1]) < 1
    says = f"{band.centre:.0f} Hz, {band.width:.0f} Hz wide (the virtual machine's frame rings at 1530 Hz)"
    levels, frequency, values = picture.as_map()
    figure = go.Figure(layout={"xaxis_title": "f [Hz]", "yaxis_title": "level"})
    figure.add_heatmap(x=frequency, y=[f"{level:.1f}" for level in levels], z=values, colorscale="Viridis")
    source = "f_c = 1533 Hz and b = 133 Hz (band 11 of 48, so the whole width)"
    return Item("Fig. 74", "Kurtogram of the faulty test", source, says, same, rows, [figure])


def _best(picture: Kurtogram, count: int = 3) -> list[Band]:
    return [band for _, band in zip(range(count), picture.in_order(), strict=False)]


def _table_6(tests: Mapping[str, _Test], band: Band) -> Item:
    found = [indicators(tests[name].envelope) for name in ("H1", "H2", "F")]
    rows = [("indicator of the envelope", "band [Hz]", "H1", "H2", "F", "variation")]
    variations = {}
    for name, (*printed, variation) in SOURCE_TABLE.items():
        h1, h2, f = (getattr(each, name) for each in found)
        variations[name] = 100 * (2 * f / (h1 + h2) - 1)
        rows.append((f"{_NAMES[name]}, source", "1533 ± 67", *(f"{value:g}" for value in printed), f"{variation:+.0f} %"))
        ours = (f"{value:.3g}" for value in (h1, h2, f))
        rows.append((f"{_NAMES[name]}, ours", f"{band.centre:.0f} ± {band.width / 2:.0f}", *ours, f"{variations[name]:+.0f} %"))
    near = {name: abs(changed / SOURCE_TABLE[name][3] - 1) <= NEAR for name, changed in variations.items()}
    says = (
        f"kurtosis {variations['kurtosis']:+.0f} % (source +1617 %), RMS {variations['rms']:+.0f} % (source +120 %); called "
        f"agreement within {100 * NEAR:.0f} % of the source's variation: {_which(near)}"
    )
    figure = _time_figure({name: tests[name].envelope for name in ("F", "H1")}, "r_e [g]")
    source = "kurtosis 6.1, 5.7 → 101.3 (+1617 %), RMS .0075, .0075 → .0165 g (+120 %)"
    return Item("Fig. 75, Table 6", "Envelope and its indicators", source, says, all(near.values()), rows, [figure])


def _which(near: Mapping[str, bool]) -> str:
    return ", ".join(f"{_NAMES[name].removesuffix(' [g]')} {'agrees' if holds else 'differs'}" for name, holds in near.items())


def _rounds(compared: Mapping[str, RoundComparison]) -> Item:
    exceeding = {name: each.exceeding.reshape(QUADRANTS, -1).max(axis=1) for name, each in compared.items()}
    rows = [("rounds over the healthy limit, at the place with most", *(f"Q{q + 1}" for q in range(QUADRANTS)))]
    rows += [(name, *(f"{100 * share:.0f} %" for share in shares)) for name, shares in exceeding.items()]
    H1, H2 = (np.median(compared[name].rounds, axis=0) for name in ("H1", "H2"))
    repeat = float(np.corrcoef(H1, H2)[0, 1])
    F = exceeding["F"]
    says = (
        f"the median rounds of H1 and H2 correlate by {repeat:.2f}; rounds of F are over the healthy limit in at most "
        f"{', '.join(f'{100 * share:.0f} % (Q{q + 1})' for q, share in enumerate(F))} at one place"
    )
    figure = go.Figure(layout={"xaxis_title": "place in the round [quadrants]", "yaxis_title": "envelope RMS [g]"})
    for name, each in (("F", compared["F"]), ("H1", compared["H1"])):
        for k, profile in enumerate(each.rounds[-20:]):
            line = {"color": COLOURS[name], "width": 0.7}
            figure.add_scatter(x=each.place, y=profile, line=line, opacity=0.5, name=name, legendgroup=name, showlegend=k == 0)
    limit = compared["F"].upper
    figure.add_scatter(x=compared["F"].place, y=limit, name="healthy limit", line={"color": "#2e7d4f", "dash": "dash"})
    agrees = F[2] > F[3] > max(F[0], F[1]) and exceeding["H2"].max() < 0.05 and repeat > 0.5
    source = "very repeatable; spikes when P3 is in Q3, lower ones in Q4"
    return Item("Fig. 76", "Rounds overlapped", source, says, agrees, rows, [figure])


def _quadrants(compared: Mapping[str, RoundComparison]) -> Item:
    medians = {name: np.median(each.quadrant_rms, axis=0) for name, each in compared.items()}
    rows = [("median envelope RMS [g]", *(f"Q{q + 1}" for q in range(QUADRANTS)))]
    rows += [(name, *(f"{value:.4f}" for value in values)) for name, values in medians.items()]
    growth = 100 * (2 * medians["F"] / (medians["H1"] + medians["H2"]) - 1)
    rows.append(("growth", *(f"{value:+.0f} %" for value in growth)))
    says = f"growth by quadrant {', '.join(f'Q{q + 1} {value:+.0f} %' for q, value in enumerate(growth))}"
    figure = go.Figure(layout={"yaxis_title": "envelope RMS [g]", "boxmode": "group"})
    for name, each in compared.items():
        labels = np.repeat([f"Q{q + 1}" for q in range(QUADRANTS)], len(each.quadrant_rms))
        figure.add_box(x=labels, y=each.quadrant_rms.T.ravel(), name=name, marker_color=COLOURS[name])
    agrees = bool(growth[2] > growth[3] > max(growth[0], growth[1]))
    source = "the fault shows mainly in Q3, then in Q4"
    return Item("Fig. 77", "Envelope RMS by quadrant", source, says, agrees, rows, [figure])


def _time_figure(signals: Mapping[str, np.ndarray], unit: str, bins: int = 1000) -> go.Figure:
    """The first 40 s, drawn as the least and largest value of each 40 ms."""
    figure = go.Figure(layout={"xaxis_title": "t [s]", "yaxis_title": unit})
    for name, x in signals.items():
        parts = x[: round(UNLOADED * RATE)].reshape(bins, -1)
        t = np.repeat(np.arange(bins) * UNLOADED / bins, 2)
        y = np.stack([parts.min(axis=1), parts.max(axis=1)], axis=1).ravel()
        figure.add_scatter(x=t, y=y, name=name, line={"color": COLOURS[name], "width": 1})
    return figure
