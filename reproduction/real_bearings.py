"""The same chain on bearings that nobody here made: recordings of Case Western Reserve University, where they are at hand."""

from pathlib import Path

import numpy as np
import plotly.graph_objects as go
from scipy.io import loadmat

from reproduction.check import at_least, near
from reproduction.item import Item
from residuum.diagnosis.vibration.spectra import band_envelope, kurtogram
from residuum.diagnosis.vibration.vibration_indicators import indicators

RIG = Path(__file__).resolve().parents[2] / "shared" / "data" / "cwru"
RATE, LEVELS = 12000.0, 5
ORDERS = {"105_0": ("inner race", 5.4152), "130_0": ("outer race", 3.5848)}
SPEED = 1796 / 60  # Hz
"""Turns of the shaft, from the recordings' own list; orders from the bearing's geometry (SKF 6205)."""


def real_bearings() -> list[Item]:
    """One item, or none where the recordings are not at hand."""
    return [_item()] if RIG.is_dir() else []


def _item() -> Item:
    healthy = _recording("97_Normal_0")
    figure = go.Figure(
        layout={"xaxis_title": "f [Hz]", "yaxis_title": "envelope spectrum over its median"}
    )
    checks = []
    for file, (part, order) in ORDERS.items():
        a = _recording(file)
        band = kurtogram(a, RATE, LEVELS).best
        envelope, calm = (
            band_envelope(x - x.mean(), RATE, band.low, band.high, decimate=False).values
            for x in (a, healthy)
        )
        f, spectrum = _spectrum(envelope)
        near_line = (f > 20) & (f < 400)
        found = float(f[near_line][np.argmax(spectrum[near_line])])
        checks += [
            near(
                f"strongest line of the envelope from 20 to 400 Hz, {part}, over the geometry's or a harmonic",
                1.0,
                _ratio(found, order * SPEED),
                0.02,
            ),
            at_least(
                f"envelope RMS over the healthy bearing's, {part}",
                indicators(envelope).rms / indicators(calm).rms,
                1.5,
            ),
        ]
        figure.add_scatter(x=f[near_line], y=spectrum[near_line], name=part)
    source = "the source's chain (kurtogram, envelope, indicators) is made for bearings' impacts"
    return Item("Section 6.3", "The chain on real bearings", source, checks, figures=[figure])


def _ratio(found: float, line: float) -> float:
    """Over the nearest of the line, its shaft side bands and the shaft itself."""
    places = [line, line - SPEED, line + SPEED, 2 * line, SPEED, 2 * SPEED]
    return found / min(places, key=lambda place: abs(place - found))


def _recording(file: str) -> np.ndarray:
    return next(
        value.ravel()
        for key, value in loadmat(RIG / f"{file}.mat").items()
        if key.endswith("DE_time")
    )


def _spectrum(envelope: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    spectrum = np.abs(np.fft.rfft(envelope - envelope.mean()))
    return np.fft.rfftfreq(len(envelope), 1 / RATE), spectrum / np.median(spectrum)
