"""Where structured outputs and their balances' missing terms are large."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from residuum.array_types import FloatArray
from residuum.identification.physics import Experiment, PhysicalModel
from residuum.identification.physics.simulate.kalman import Smoothed
from residuum.identification.residual_analysis.noise.coloured_noise import stretches
from residuum.identification.residual_analysis.places.axes import direction_of_movement
from residuum.identification.residual_analysis.places.locate import Axis, Region, locate
from residuum.identification.residual_analysis.policy.answers import MOST_REGIONS
from residuum.identification.residual_analysis.structured_error import StructuredError


def regions(
    model: PhysicalModel,
    experiments: Sequence[Experiment],
    residuals: Sequence[FloatArray],
    smoothed: Sequence[Smoothed],
    axes: Sequence[Sequence[Axis]],
    floors: Mapping[str, float],
    structured: Mapping[str, StructuredError],
) -> tuple[Region, ...]:
    """Regions of every axis and of frequency, the most telling first; none when no output's error is structured.

    `floors` is the noise floor of each output; a missing term is compared with the width of its own band.
    """
    present = [name for name, test in structured.items() if test.present]
    if not present:
        return ()
    joined = [replace(axis, values=np.concatenate([a[k].values for a in axes])) for k, axis in enumerate(axes[0])]
    direction = direction_of_movement(joined)
    found: list[Region] = []
    for name in present:
        errors = [residual[:, list(model.outputs).index(name)] for residual in residuals]
        memory = max(structured[name].noise.time_constant, 1.0)
        error = np.concatenate(errors)
        found += locate(error, joined, noise_rms=floors[name], of=name, direction=direction, correlation_samples=memory)
        amplitude, frequency = _spectrum(errors, experiments)
        found += locate(amplitude, [frequency], noise_rms=floors[name], of=name)
    for balance in smoothed[0].missing:
        term = np.concatenate([s.missing[balance].value for s in smoothed])
        band = float(np.median(np.concatenate([s.missing[balance].std for s in smoothed])))
        memory = _correlation_samples(term)
        found += locate(term, joined, noise_rms=band, of=balance, direction=direction, correlation_samples=memory)
    return tuple(sorted(found, key=lambda region: -region.score)[:MOST_REGIONS])


def _spectrum(errors: Sequence[FloatArray], experiments: Sequence[Experiment]) -> tuple[FloatArray, Axis]:
    """Amplitudes |E(f)|/√n of the longest stretch (white noise of RMS σ gives RMS σ), and their frequencies [Hz]."""
    parts = [
        (error[part], e.sample_time)
        for error, e in zip(errors, experiments, strict=True)
        for part in stretches(np.isfinite(error))
    ]
    longest, sample_time = max(parts, key=lambda part: len(part[0]))
    amplitude = np.abs(np.fft.rfft(longest)) / np.sqrt(len(longest))
    frequency = np.arange(1, amplitude.shape[0], dtype=np.float64) / (len(longest) * sample_time)
    return amplitude[1:], Axis("frequency", "Hz", "frequency", frequency)


def _correlation_samples(x: FloatArray) -> float:
    """Lag at which the autocorrelation of x has fallen below 1/e, at least 1."""
    centred = x - x.mean()
    size = 1 << (2 * len(x) - 1).bit_length()
    spectrum = np.fft.rfft(centred, size)
    correlation = np.fft.irfft(np.abs(spectrum) ** 2, size)[: len(x)]
    below = np.flatnonzero(correlation < correlation[0] / np.e)
    return float(max(1, below[0] if below.size else len(x)))
