"""The unit of the error: nats of noise, once what a structure leaves is noise alike all along the records."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from residuum.array_types import FloatArray
from residuum.identification.physics import Simulator
from residuum.identification.residual_analysis.noise.noise_floor import times_the_noise
from residuum.identification.unseen_blocks.judged import Judged, judged
from residuum.identification.unseen_blocks.looks import Court
from residuum.identification.unseen_blocks.policy import NOISY, UNEVEN
from residuum.identification.unseen_blocks.scale import Scale, clipped, of_noise
from residuum.identification.unseen_blocks.structure import descended


def settle(best: Judged, court: Court) -> tuple[Court, Judged] | None:
    """The court in nats and the structure judged there, where what it leaves is noise alike all along the records; None
    otherwise.
    """
    last, data = court.last, court.data
    found = court.begun(best.structure)
    if found is None:
        return None
    scale = replace(of_noise(found.residuals, last, data.measured), filters=None)
    for _ in range(3):  # outputs weighed by their own errors, then these whitened
        found = descended(found.in_unit(scale), steps=12, tolerance=1e-5)
        if found.cost == np.inf:
            return None
        scale = of_noise(found.residuals, last, data.measured)
    times = max(times_the_noise([r[:, o] for r in found.residuals]) for o in np.flatnonzero(data.measured))
    if times > NOISY or _unevenness(found.residuals, scale, court) > UNEVEN:
        return None
    scale = clipped(scale, found.residuals, last)
    found = found.in_unit(scale)
    in_nats = judged(best.structure.at(last, found), found, last, data, scale)
    return None if in_nats is None else (replace(court, scale=scale), in_nats)


def accurate(best: Judged, court: Court) -> Judged:
    """The structure refitted with as many integration steps a sample as its simulation asks for; as it was, where that leaves
    more.

    Steps that follow the modes do for a search. In noise alone values are as sure as a fraction of the error of such a step: a
    shift in time by parts of a sample bends the input within it.
    """
    last, structure = court.last, best.structure
    simulator, taken = Simulator(best.model), structure.steps[last.windows]
    X0 = [simulator.x0({**known, **part.known}) for known, part in zip(structure.states[last.windows], last.parts, strict=True)]
    steps = np.maximum(simulator.substeps_each(last.parts, X0, simulator.p()), taken).tolist()
    if steps == list(taken):
        return best
    finer = replace(structure, steps={**structure.steps, last.windows: steps})
    found = court.judge(finer, steps=15, tolerance=1e-6)
    return best if found is None or found.cost > best.cost else found


def _unevenness(residuals: Sequence[FloatArray], scale: Scale, court: Court) -> float:
    """Times the scatter of white noise that the powers of the blocks have, at the output where it is most."""
    starts, measured = court.last.starts.tolist(), court.data.measured
    white = scale.whitened(np.nan_to_num(np.concatenate(residuals)) * scale.weights, starts)[:, measured]
    block = court.last.block
    n = np.bincount(block, minlength=court.data.blocks)
    powers = [np.bincount(block, weights=column**2, minlength=len(n))[n > 0] / n[n > 0] for column in white.T]
    scatter = np.sqrt(2.0 / n[n > 0].mean())
    return max(float(np.std(np.log(np.maximum(p, 1e-300)), ddof=1) / scatter) for p in powers)
