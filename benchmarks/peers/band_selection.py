"""Which band to demodulate: remedies for the kurtogram's known failures.

The kurtogram rewards rarity. One knock on the housing has a larger kurtosis than a thousand bearing impacts, and at low
signal-to-noise ratio a narrow band wins by chance. Three other merits of the same bands:

* `protrugram`: kurtosis of the envelope's spectrum; high when the envelope holds few strong lines (Barszcz & Jabłoński 2011).
* `infogram`: negentropy of the squared envelope plus that of its spectrum (Antoni 2016): impulsive *or* periodic.
* `separation`: how far kurtosis and power of each band lie from a healthy kurtogram.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import fft

from residuum.diagnosis.vibration.spectra import (
    Band,
    Kurtogram,
    PaddedSpectrum,
    kurtogram,
)
from residuum.diagnosis.vibration.vibration_indicators import indicators
from residuum.identification.errors import BadInput

Array = npt.NDArray[Any]
MERITS = ("kurtosis", "protrugram", "infogram")
_HARMONICS = 8
_CLIPPED = 20.0  # times the median of the squared envelope: a knock then weighs no more than one of many impacts


def choose_band(
    x: npt.ArrayLike,
    sampling_rate: float,
    *,
    merit: str = "protrugram",
    levels: int = 4,
    rates: tuple[float, float] = (10.0, 400.0),
) -> list[Band]:
    """Bands from the best down by one of the merits, non-overlapping; the first is the one to demodulate.

    The default, the protrugram, found the resonance of a bearing most often, from 0 to −14 dB and with random knocks
    (benchmarks/results/vibration.md has the counts).

    Parameters
    ----------
    x : array, shape (n,), no missing samples
    sampling_rate : float [Hz]
    merit : one of `MERITS`
    levels : int
        Depth of the ⅓-binary division.
    rates : (float, float)
        Between which rates [Hz] impacts are expected; lines of the envelope up to eight times the upper are looked at.

    Raises
    ------
    BadInput
        Unknown merit, or a record shorter than eight periods of the lowest rate.
    """
    if merit not in MERITS:
        raise BadInput(f"band selection: merit is {merit!r}; must be one of {', '.join(MERITS)}")
    of_tree = kurtogram(x, sampling_rate, levels, method="fft")
    return list(of_tree.in_order(merits(x, of_tree, merit, rates)))


def merits(
    x: npt.ArrayLike, of_tree: Kurtogram, merit: str, rates: tuple[float, float] = (10.0, 400.0)
) -> Array:
    """The merit of every band of a kurtogram of x, shape (bands,); −∞ for the whole band and where one is too narrow."""
    if merit == "kurtosis":
        return np.where(of_tree.level > 0, of_tree.kurtosis, -np.inf)
    signal: Array = np.asarray(x)
    rate = of_tree.sampling_rate
    if signal.shape[0] < 8 * rate / rates[0]:
        raise BadInput(
            f"band selection: {signal.shape[0] / rate:g} s hold fewer than 8 periods of {rates[0]:g} Hz"
        )
    spectrum = PaddedSpectrum.of(signal - signal.mean(), rate)
    found = np.full(of_tree.level.shape, -np.inf)
    for k, (centre, width) in enumerate(zip(of_tree.centre, of_tree.width, strict=True)):
        if of_tree.level[k] == 0 or width < 2 * rates[0]:
            continue
        envelope = spectrum.envelope(centre - width / 2, centre + width / 2)
        square = envelope.values**2
        square = np.minimum(square, _CLIPPED * np.median(square))
        power = (
            np.abs(fft.rfft(square - square.mean(), fft.next_fast_len(square.shape[0], real=True)))[
                1:
            ]
            ** 2
        )
        power = power[
            : max(
                8,
                int(power.shape[0] * min(1.0, 2 * _HARMONICS * rates[1] / envelope.sampling_rate)),
            )
        ]
        found[k] = (
            indicators(np.sqrt(power)).kurtosis
            if merit == "protrugram"
            else _negentropy(square) + _negentropy(power)
        )
    return found


def separation(current: Kurtogram, healthy: Sequence[Kurtogram]) -> Array:
    """How far each band lies from healthy kurtograms of the same division, shape (bands,).

    The larger of the deviations of ln power and of ln (K + 2), each in healthy standard deviations (at least 5 %), medians
    over the kurtograms' time segments: with 8 segments or more a few knocks leave them as they are. With a baseline this
    finds the fault's band at once, because what is impulsive or loud in health cancels.
    """
    if len(healthy) < 3 or any(other.level.shape != current.level.shape for other in healthy):
        raise BadInput(
            "band separation: needs three or more healthy kurtograms of the same division"
        )
    return np.asarray(
        np.max([_deviation(current, healthy, part) for part in (_log_power, _log_kurtosis)], axis=0)
    )


def _log_power(k: Kurtogram) -> Array:
    return np.asarray(np.log(np.median(k.power, axis=1)))


def _log_kurtosis(k: Kurtogram) -> Array:
    return np.asarray(np.log(np.median(k.kurtosis_of_segments, axis=1) + 2.0 + (k.level == 0)))


def _deviation(current: Kurtogram, healthy: Sequence[Kurtogram], part: Any) -> Array:
    of_healthy = np.array([part(k) for k in healthy])
    return np.asarray(
        (part(current) - of_healthy.mean(axis=0)) / np.maximum(of_healthy.std(axis=0, ddof=1), 0.05)
    )


def _negentropy(power: Array) -> float:
    ratio = power / power.mean()
    return float(np.mean(ratio * np.log(np.maximum(ratio, 1e-300))))
