"""Feedback: whether an input answers the noise of an output, as a controller's does that acts on the measurement.

Then means over several samples are no innovations: the input that moved within them knows their noise, and what acts there (a
lag) would seem to explain it. And the input was held: one that moved towards its next value would have known what is measured
then.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from residuum.array_types import FloatArray
from residuum.identification.physics import Experiment, PhysicalModel, Simulator
from residuum.identification.residual_analysis.noise.innovations import fit_noises
from residuum.identification.residual_analysis.policy.noise import NOISE_ORDER
from residuum.identification.residual_analysis.policy.records import (
    ANSWER_CERTAIN,
    ANSWER_LAGS,
    ANSWER_SAMPLES,
    ANSWER_SHARE,
    NORMAL_MEDIAN,
    OUTLYING_INNOVATION,
)


def feeds_back(model: PhysicalModel, experiments: Sequence[Experiment], residuals: Sequence[FloatArray]) -> bool:
    """Whether an input's innovations answer those of an output's `residuals` (n, outputs) of each experiment, at every sample.

    What an output feels at once (a current its voltage) may correlate with it for other reasons; there only later answers count.
    """
    at_once, most = _felt_at_once(model, experiments[0]), -(-ANSWER_SAMPLES // len(experiments))
    inputs = _innovations([e.U[:most] for e in experiments])
    for o, e in enumerate(_innovations([r[:most] for r in residuals])):
        for u in inputs:
            for lag in range(1 if at_once[o] else 0, ANSWER_LAGS):
                if e is not None and u is not None and _answers(e[: len(e) - lag], u[lag:]):
                    return True
    return False


def _felt_at_once(model: PhysicalModel, experiment: Experiment) -> npt.NDArray[np.bool_]:
    """Which outputs change with the inputs of the same sample."""
    simulator, first = Simulator(model), experiment.window(0, 2)
    there = replace(first, U=first.U + np.std(experiment.U, axis=0))
    runs = [simulator.run_vectors(e, simulator.x0(), simulator.p(), substeps=1) for e in (first, there)]
    return np.asarray(runs[0].Y[0] != runs[1].Y[0])


def _innovations(signals: Sequence[FloatArray]) -> list[FloatArray | None]:
    """What the past of each signal does not predict of it, in units of its spread, outliers drawn in; None if that is nothing."""
    found: list[FloatArray | None] = []
    for o, noise in enumerate(fit_noises(signals, NOISE_ORDER)):
        if noise is None:
            found.append(None)
            continue
        e = np.concatenate([_in_place(noise.whiten(np.ascontiguousarray(v[:, o])), len(v)) for v in signals])
        spread = np.nanmedian(np.abs(e)) / NORMAL_MEDIAN if e.size else 0.0
        found.append(np.clip(e / spread, -OUTLYING_INNOVATION, OUTLYING_INNOVATION) if spread > 0.0 else None)
    return found


def _in_place(e: FloatArray, n: int) -> FloatArray:
    """Innovations at their own samples: the first have no past, and how many depends on the noise's order, so on the signal."""
    return np.r_[np.full(n - len(e), np.nan), e]


def _answers(e: FloatArray, u: FloatArray) -> bool:
    known = np.isfinite(e) & np.isfinite(u)
    if not known.any():
        return False
    share = np.mean(e[known] * u[known]) ** 2 / (np.mean(e[known] ** 2) * np.mean(u[known] ** 2))
    return bool(share > ANSWER_SHARE and share * known.sum() > ANSWER_CERTAIN)
