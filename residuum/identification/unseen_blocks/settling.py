"""The unit of the error: nats of noise, once what a structure leaves is noise alike all along the
records.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from operator import itemgetter

import numpy as np

from residuum.array_types import FloatArray
from residuum.identification.errors import MAY_DIVERGE, NotIdentifiable
from residuum.identification.physics import Simulator
from residuum.identification.residual_analysis.noise import times_the_noise
from residuum.identification.unseen_blocks.data import Data, one_turned, turned
from residuum.identification.unseen_blocks.judged import Judged, judged
from residuum.identification.unseen_blocks.ladder import Climbed, innovations_on
from residuum.identification.unseen_blocks.looks import Court
from residuum.identification.unseen_blocks.policy import NOISY, UNEVEN
from residuum.identification.unseen_blocks.scale import Scale, clipped, of_noise, of_power
from residuum.identification.unseen_blocks.structure import descended
from residuum.identification.unseen_blocks.tried import Search


def settle(best: Judged, court: Court) -> tuple[Court, Judged] | None:
    """The court in nats and the structure judged there, where what it leaves is noise alike all
    along the records; None otherwise.
    """
    last, data = court.last, court.data
    fit = court.begun(best.structure)
    if fit is None:
        return None
    scale = replace(of_noise(fit.residuals, last, data.measured), filters=None)
    for _ in range(3):  # outputs weighed by their own errors, then these whitened
        fit = descended(fit.in_unit(scale), steps=12, tolerance=1e-5)
        if fit.cost == np.inf:
            return None
        scale = of_noise(fit.residuals, last, data.measured)
    times = max(
        times_the_noise([r[:, o] for r in fit.residuals]) for o in np.flatnonzero(data.measured)
    )
    if times > NOISY or _unevenness(fit.residuals, scale, court) > UNEVEN:
        return None
    scale = clipped(scale, fit.residuals, last)
    fit = fit.in_unit(scale)
    in_nats = judged(best.structure.at(last, fit), fit, last, data, scale)
    return None if in_nats is None else (replace(court, scale=scale), in_nats)


def accurate(best: Judged, court: Court) -> Judged:
    """The structure refitted with as many integration steps a sample as its simulation asks for; as
    it was, where that leaves more.

    Steps that follow the modes do for a search. In noise alone values are as sure as a fraction of
    the error of such a step: a shift in time by parts of a sample bends the input within it.
    """
    last, structure = court.last, best.structure
    simulator, taken = Simulator(best.model), structure.steps[last.windows]
    X0 = [
        simulator.x0({**known, **part.known})
        for known, part in zip(structure.states[last.windows], last.parts, strict=True)
    ]
    steps = np.maximum(simulator.substeps_each(last.parts, X0, simulator.p()), taken).tolist()
    if steps == list(taken):
        return best
    finer = replace(structure, steps={**structure.steps, last.windows: steps})
    refitted = court.judge(finer, steps=15, tolerance=1e-6)
    return best if refitted is None or refitted.cost > best.cost else refitted


def _unevenness(residuals: Sequence[FloatArray], scale: Scale, court: Court) -> float:
    """Times the scatter of white noise that the powers of the blocks have, at the output where it
    is most.
    """
    starts, measured = court.last.starts.tolist(), court.data.measured
    white = scale.whitened(np.nan_to_num(np.concatenate(residuals)) * scale.weights, starts)[
        :, measured
    ]
    block = court.last.block
    n = np.bincount(block, minlength=court.data.blocks)
    powers = [
        np.bincount(block, weights=column**2, minlength=len(n))[n > 0] / n[n > 0]
        for column in white.T
    ]
    scatter = np.sqrt(2.0 / n[n > 0].mean())
    return max(float(np.std(np.log(np.maximum(p, 1e-300)), ddof=1) / scatter) for p in powers)


# Where a search begins: the model as it is, judged.


def begun(climbed: Climbed) -> Search:
    """The model as it is, judged; in nats where all it leaves is noise."""
    data, last = climbed.data, climbed.last
    first = judged(climbed.structure, climbed.found, last, data, climbed.scale)
    if first is None:
        raise NotIdentifiable(f"model {data.model.name!r}: diverges on the records; {MAY_DIVERGE}")
    scale = of_power(climbed.scale, data, first.power)
    first = replace(first, cost=scale.cost(first.power, first.parameters), seen=np.inf)
    court = Court(data, last, climbed.middle, scale, climbed.there)
    if (turned := settle(first, court)) is not None:
        court, first = turned
    return Search(court, first, first, None, {(): first})


# The input timing that suits what was found: the timing of the data was chosen before anything
# was.


def at_the_timing_it_suits(search: Search) -> Data | None:
    """The data at the other input timing, where the best structure fits better there; None where it
    does not, or nothing drives the machine.
    """
    court = search.court
    if not search.best.model.inputs:
        return None
    current = _innovations(search, court.data)
    alternatives = [
        (_innovations(search, data), data) for data in (turned(court.data), *one_turned(court.data))
    ]
    least, data = min(alternatives, key=itemgetter(0))
    return data if least < current else None


def _innovations(search: Search, data: Data) -> float:
    court = search.court
    rung = court.last if data is court.data else data.rung(court.last.windows)
    return innovations_on(rung, search.best.model, search.best.structure, court.scale)
