"""The free term: what any smooth function of one signal, in one balance, would explain beyond a structure.

It stands for the effects that the catalogue does not have. A balance receives Σ c_j·φ_j(axis) with hat functions φ_j on a
signal of the model (velocity, position, current, temperature, level, time); its effect on the outputs is propagated through the
linearised model and c is found by whitened least squares together with the free parameters and initial states. It pays for
every coefficient.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from residuum.identification.discrepancy.fitting.structures import Structure
from residuum.identification.discrepancy.policy.answers import FACTOR_KNOTS, FREE_TERM_KNOTS
from residuum.identification.discrepancy.policy.likelihood import FREE_TERM_RIDGE
from residuum.identification.discrepancy.screening.first_order import first_order_fit
from residuum.identification.discrepancy.searching.evidence import tempered
from residuum.identification.physics import Experiment, PhysicalModel, Simulator, balance_variables
from residuum.identification.residual_analysis.noise.innovations import Noises
from residuum.identification.side_by_side import side_by_side
from residuum.identification.unseen_blocks.free_term import hats
from residuum.identification.unseen_blocks.linear_response import LinearResponse, linear_response

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class FreeTerm:
    """The best free term.

    Attributes
    ----------
    balance, axis, unit : str
        Where it acts, the signal it is a function of, the unit of its value.
    at, value : array, shape (knots,)
        The curve: the term at these values of the axis.
    rest : float
        Power of the residual that remains, outputs in units of their innovations' scale.
    gain : float
        Log-likelihood gain over the structure, coefficients paid for.
    evidence : float
        The same, tempered, and less the logarithm of the number of free terms tried.
    """

    balance: str
    axis: str
    unit: str
    at: FloatArray
    value: FloatArray
    rest: float
    gain: float
    evidence: float


def free_term(structure: Structure, experiments: Sequence[Experiment]) -> FreeTerm | None:
    """The free term that explains most beyond the structure; None when the model has nowhere to put one."""
    model = structure.model
    responses = [
        linear_response(model, e, x, s) for e, x, s in zip(experiments, structure.initial, structure.substeps, strict=True)
    ]
    if not all(np.all(np.isfinite(r.F)) for r in responses):
        return None

    def fitted(term: tuple[str, str, FloatArray, list[FloatArray]]) -> FreeTerm:
        balance, axis, knots, terms = term
        columns = [e.means(r.to(balance, t)) for e, r, t in zip(experiments, responses, terms, strict=True)]
        by_parameters = [np.concatenate([J, c], axis=2) for J, c in zip(structure.by_parameters, columns, strict=True)]
        step, pointwise, rest = first_order_fit(
            structure, structure.residuals, by_parameters, structure.by_states, ridge=FREE_TERM_RIDGE
        )
        price = 0.5 * terms[0].shape[1] * np.log(structure.samples)
        d = pointwise - structure.pointwise
        unit = model.balances[balance].unit if axis in FREE_TERM_KNOTS else ""  # a factor has none
        value, power = step[len(structure.parameters) :], scaled_power(rest, structure.noises)
        return FreeTerm(balance, axis, unit, knots, value, power, float(d.sum()) - price, tempered(d) - price)

    found = side_by_side(fitted, list(_terms(structure, experiments, responses)))
    if not found:
        return None
    best = max(found, key=lambda term: term.gain)
    return replace(best, evidence=best.evidence - float(np.log(len(found))))


def scaled_power(residuals: Sequence[FloatArray], noises: Noises) -> float:
    """Σ over outputs of the residual's mean square in units of the innovations' squared scale."""
    stacked = np.concatenate(residuals)
    return float(
        sum(np.nanmean(stacked[:, o] ** 2) / noise.innovation_variance for o, noise in enumerate(noises) if noise is not None)
    )


def _terms(
    structure: Structure, experiments: Sequence[Experiment], responses: Sequence[LinearResponse]
) -> Iterator[tuple[str, str, FloatArray, list[FloatArray]]]:
    simulator = Simulator(structure.model)
    for name, balance in structure.model.balances.items():
        signals = [balance_variables(simulator, balance, e, r.X) for e, r in zip(experiments, responses, strict=True)]
        times = [e.sample_time * np.arange(e.n, dtype=float) for e in experiments]
        axes = {axis: [s[axis] for s in signals] for axis in FREE_TERM_KNOTS if axis in signals[0]} | {"time": times}
        for axis, values in axes.items():
            joined = np.concatenate(values)
            if not np.ptp(joined) > 0:
                continue
            for count in FREE_TERM_KNOTS[axis]:
                knots = np.linspace(joined.min(), joined.max(), count)
                yield name, axis, knots, [hats(v, knots) for v in values]
        yield from _changing(structure.model, name, signals, times)


def _changing(
    model: PhysicalModel, balance: str, signals: Sequence[Mapping[str, FloatArray]], times: Sequence[FloatArray]
) -> Iterator[tuple[str, str, FloatArray, list[FloatArray]]]:
    """Each effect of the balance with a size that changes with the speed, or with time: then it is not that effect."""
    for use in model.effects:
        name = f"term:{use.label.split('@')[0]}"
        if use.target != balance or name not in signals[0]:
            continue
        axes = {"time": list(times)}
        if "velocity" in signals[0]:
            axes["velocity"] = [np.abs(s["velocity"]) for s in signals]
        for axis, values in axes.items():
            joined = np.concatenate(values)
            if np.ptp(joined) > 0:
                knots = np.linspace(joined.min(), joined.max(), FACTOR_KNOTS)
                terms = [hats(v, knots) * s[name][:, None] for v, s in zip(values, signals, strict=True)]
                yield balance, f"{axis} (factor of {use.id})", knots, terms
