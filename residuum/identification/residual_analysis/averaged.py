"""How much of long experiments is used, and over how many samples their residuals are averaged."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from residuum.identification.physics import Experiment
from residuum.identification.residual_analysis.policy.records import ABOVE_NYQUIST, FEWEST_IN_A_SPECTRUM, SHORTENED

FloatArray = npt.NDArray[np.float64]


def averaged(experiments: Sequence[Experiment], most: int) -> list[Experiment]:
    """The experiments with blocks of residuals averaged so that about `most` remain in all.

    Only residuals and their derivatives are averaged (`Experiment.means`), after a simulation at the full rate, so nothing is
    approximated: averaging inputs would look like a lag of part of a sample. Blocks are kept short enough for the signals' own
    spectra, and to leave an experiment at least 64 of them.

    Of experiments that together have more than three times `most` samples the liveliest stretches are taken.
    """
    experiments = liveliest(experiments, SHORTENED * most)
    total = sum(e.n for e in experiments)
    block = max(1, min(-(-total // most), min(e.n for e in experiments) // FEWEST_IN_A_SPECTRUM))
    while block > 1 and any(_too_coarse(e, block) for e in experiments):
        block -= 1
    return [replace(e, block=block) for e in experiments]


def liveliest(experiments: Sequence[Experiment], most: int) -> list[Experiment]:
    """The stretches over which the outputs vary most, of at most so many samples together."""
    total = sum(e.n for e in experiments)
    return (
        [_liveliest(e, max(FEWEST_IN_A_SPECTRUM, e.n * most // total)) for e in experiments]
        if total > most
        else list(experiments)
    )


def _too_coarse(experiment: Experiment, block: int) -> bool:
    return any(_above(y, block, floor=True) > ABOVE_NYQUIST for y in experiment.Y.T) or any(
        _above(u, block, floor=False) > ABOVE_NYQUIST for u in experiment.U.T
    )


def _above(signal: FloatArray, block: int, *, floor: bool) -> float:
    """Share of a signal's power above the Nyquist frequency of blocks, without a flat noise floor if there is to be one."""
    known = signal[np.isfinite(signal)]
    if known.size < FEWEST_IN_A_SPECTRUM:
        return 0.0
    power = np.abs(np.fft.rfft((known - known.mean()) * np.hanning(known.size))) ** 2
    total = float(power.sum())
    flat = float(np.median(power[-power.size // 4 :])) / np.log(2.0) if floor else 0.0
    return float((power[power.size // block :] - flat).sum()) / total if total > 0 else 0.0


def _liveliest(experiment: Experiment, samples: int) -> Experiment:
    """The stretch of so many samples over which the outputs vary most."""
    if samples >= experiment.n:
        return experiment
    starts = range(0, experiment.n - samples + 1, max(1, samples // 8))
    measured = experiment.Y[:, experiment.measured]
    spread = np.nanstd(measured, axis=0)
    scaled = measured / np.where(spread > 0, spread, 1.0)
    lively = [float(np.nansum(_variance(scaled[s : s + samples]))) for s in starts]
    first = starts[int(np.argmax(lively))]
    return experiment.window(first, first + samples)


def _variance(Y: FloatArray) -> FloatArray:
    """Of each column's present samples, 0 where there are none."""
    count = np.maximum(np.isfinite(Y).sum(axis=0), 1)
    return np.asarray(np.nansum(Y**2, axis=0) / count - (np.nansum(Y, axis=0) / count) ** 2)
