"""How strongly data prefer one structure to another: likelihood ratio, tempered by how evenly it is earned."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from residuum.identification.discrepancy.fitting.structures import Structure
from residuum.identification.discrepancy.policy.acceptance import ALIKE, OUT_OF_BOUNDS, TEMPERING_BLOCKS
from residuum.identification.physics.effects import EFFECTS

FloatArray = npt.NDArray[np.float64]
K = TypeVar("K")


def tempered_gain(better: Structure, worse: Structure) -> float:
    """Log-likelihood by which `better` exceeds `worse`, at what it is worth.

    A gain G = Σ d that well-specified Gaussian structures earn from a true difference has variance 2G. Measured over blocks
    of time, the variance V of the gain is larger when few moments earn it all (a shock, an ill-timed step, a tail heavier
    than normal); then G counts as min(1, 2G/V)·G, so that one lucky moment is worth two units, whatever its size.

    References
    ----------
    Q. H. Vuong, Econometrica 57 (1989) 307; P. Bissiri, C. Holmes, S. Walker, J. R. Stat. Soc. B 78 (2016) 1103 (tempering).
    """
    return tempered(better.pointwise - worse.pointwise)


def tempered(d: FloatArray) -> float:
    """What a gain earned as d, sample by sample, is worth (see `tempered_gain`)."""
    gain = float(d.sum())
    if gain == 0.0:
        return 0.0
    sums = np.array([part.sum() for part in np.array_split(d, min(TEMPERING_BLOCKS, d.size))])
    variance = float(np.sum((sums - sums.mean()) ** 2))
    return gain * min(1.0, 2.0 * abs(gain) / max(variance, 1e-300))


def preferred(structures: Mapping[K, Structure], base: Structure) -> K | None:
    """The structure with the largest Schwarz criterion among those that exceed the base's; None when none does.

    Of structures within `ALIKE` of the largest, at what the gain is worth, the one with the fewest parameters is preferred.
    An estimate on a physical bound is another effect, or none, in disguise, and so is one that no output feels (a play that is
    never taken up): such a structure is never preferred.
    """
    score = {key: s.log_likelihood - s.penalty(base) for key, s in structures.items() if not _is_no_estimate(key, s)}
    better = [key for key in score if score[key] > base.log_likelihood]
    if not better:
        return None
    highest = structures[max(better, key=lambda key: score[key])]
    alike = [key for key in better if highest is structures[key] or _behind(highest, structures[key]) > -ALIKE]
    return min(alike, key=lambda key: (len(structures[key].parameters), -score[key]))


def relative_evidence(structures: Mapping[K, Structure], base: Structure) -> tuple[dict[K, float], float]:
    """Log evidence of each structure, and of the base, relative to the preferred one (0): tempered gains less prices.

    Gains are tempered pairwise, against the preferred structure, so that the order of two structures is never reversed;
    none exceeds the preferred one, and what is no estimate stands at least a hundred times below it.
    """
    best = preferred(structures, base)
    winner = base if best is None else structures[best]
    values: dict[K, float] = {}
    for key, structure in structures.items():
        highest = -OUT_OF_BOUNDS if key != best and _is_no_estimate(key, structure) else 0.0
        values[key] = 0.0 if key == best else min(_behind(winner, structure), highest)
    return values, 0.0 if best is None else _behind(winner, base)


def _is_no_estimate(key: K, structure: Structure) -> bool:
    """Whether the effect was estimated on a bound, or no output feels its first parameter, which is what it does."""
    label = "@".join(map(str, key)) if isinstance(key, tuple) else str(key)
    effect = EFFECTS.get(label.partition("@")[0])
    natural = () if effect is None else effect.natural_bounds
    own = [k for k, name in enumerate(structure.parameters) if name.startswith(f"{label}.")]
    if own and not any(np.any(slopes[:, :, own[0]]) for slopes in structure.by_parameters):
        return True
    return any(_owner(name) == label and name.rpartition(".")[2] not in natural for name in structure.at_bound)


def _owner(name: str) -> str:
    """`spring@arm` of the full name `spring@arm.k`, and of `spring@arm#2.k`, the same parameter of a second instance."""
    return name.rpartition(".")[0].partition("#")[0]


def _behind(winner: Structure, other: Structure) -> float:
    return -tempered_gain(winner, other) + winner.penalty(other)
