"""Records sampled much more finely than anything moves in them, at a rate that loses nothing.

Work grows with the samples, and a controller's kilohertz says no more of a slide that moves for
seconds than a hundred hertz do. Readings are taken at every k-th sample; inputs are means over the
k samples that follow it where they are held, centred ones where they move evenly. Whether that
loses anything is not guessed from spectra: the model is simulated on both, and the difference has
to be nothing beside its error.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from residuum.array_types import FloatArray
from residuum.identification.errors import BadInput
from residuum.identification.physics import Experiment, PhysicalModel, Simulator
from residuum.identification.residual_analysis.policy import ENOUGH_SAMPLES, FEWEST_AT_A_RATE, LOST


def at_lower_rate(
    model: PhysicalModel,
    experiments: Sequence[Experiment],
    initial: Sequence[FloatArray] | None = None,
) -> tuple[list[Experiment], int]:
    """The experiments at the lowest rate 1/2, 1/4, … of theirs that loses nothing and leaves enough
    samples; and how many samples one of it stands for. The model begins at its own first states, or
    at those `initial`.
    """
    # ever halved, as long as nothing is lost and enough samples are left: short records keep theirs
    counts = [e.n for e in experiments]
    most = min(sum(counts) // ENOUGH_SAMPLES, min(counts) // FEWEST_AT_A_RATE)
    outputs = _outputs(model, experiments, initial) if most >= 2 else None
    best, step = (list(experiments), 1), 2
    while outputs is not None and step <= most:
        coarse = [at_every(e, step) for e in experiments]
        if not _loses_nothing(outputs, coarse, _outputs(model, coarse, initial), step):
            break
        best, step = (coarse, step), 2 * step
    return best


def at_every(e: Experiment, k: int) -> Experiment:
    """Every k-th sample of an experiment, its inputs as means over the k samples there."""
    n = e.n // k
    U = e.U[: n * k : k].copy()
    # an input acts with its mean over the k samples; a clock tells the time of the first one
    for j, hold in enumerate(e.hold):
        if not (e.clocks and e.clocks[j]):
            U[:, j] = _means(e.U[:, j], k, n, centred=hold > 0.0)
    spare = {
        name: replace(s, values=_means(s.values, k, n, centred=False))
        for name, s in e.spare.items()
    }
    return replace(e, U=U, Y=e.Y[: n * k : k], sample_time=k * e.sample_time, spare=spare)


def _means(values: FloatArray, k: int, n: int, *, centred: bool) -> FloatArray:
    """Means over k samples from every k-th on, or around it."""
    if centred:
        half = k // 2
        padded = np.concatenate([np.full(half, values[0]), values, np.full(half, values[-1])])
        weights = np.ones(k + 1)
        weights[[0, -1]] = 0.5  # of the straight lines between samples
        return np.asarray(np.convolve(padded, weights / k, mode="valid")[: n * k : k])
    return np.asarray(values[: n * k].reshape(n, k).mean(axis=1))


def _loses_nothing(
    fine: Sequence[FloatArray],
    coarse: Sequence[Experiment],
    slow: Sequence[FloatArray] | None,
    k: int,
) -> bool:
    """Whether the model's outputs at the coarse rate differ by next to nothing of its error from
    the fine ones.
    """
    if slow is None:
        return False
    for e, y, z in zip(coarse, (y[::k] for y in fine), slow, strict=True):
        error, lost = e.Y - y[: e.n], z - y[: e.n]
        lost_power = np.nansum(np.where(np.isfinite(error), lost, 0.0) ** 2, axis=0)
        # of each output: one that is followed well must not lose behind one that is not
        if np.any(lost_power > LOST * np.nansum(error**2, axis=0)):
            return False
    return True


def _outputs(
    model: PhysicalModel, experiments: Sequence[Experiment], initial: Sequence[FloatArray] | None
) -> list[FloatArray] | None:
    """The model's outputs along experiments; None where it diverges."""
    simulator = Simulator(model)
    p = simulator.p()
    first = [simulator.x0(e.known) for e in experiments] if initial is None else initial
    try:
        # each rate with the integration steps that it needs, or coarse samples would lose by these
        substeps = simulator.substeps_each(experiments, first, p)
        runs = simulator.run_each(experiments, first, p, substeps=substeps)
    except BadInput:
        return None
    return [run.Y for run in runs] if runs.bounded else None
