"""Which parameter values a machine can have at all: bounds across parameters, beside those that
each has of its own.

An end of the travel lies above the other one; what multiplies a derivative (a mass, an inertia, a
heat capacity) keeps its sign.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from residuum.identification.physics.files.expression import Expression, evaluate
from residuum.identification.physics.model import PhysicalModel

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Possible:
    """Whether parameter vectors of one model, in its kernel's order, are those of a machine that
    can be.

    Parameters
    ----------
    pairs : tuple of (int, int)
        Positions of two parameters of which the first must lie below the second.
    storages : tuple of (expression, names with their positions, sign)
        What multiplies the derivative of each balance, as far as parameters alone say it, and the
        sign that it has in the model.
    """

    pairs: tuple[tuple[int, int], ...]
    storages: tuple[tuple[Expression, Mapping[str, int], float], ...]

    @classmethod
    def of(cls, model: PhysicalModel, index: Mapping[str, int]) -> Possible:
        """The bounds of a model whose parameters stand at these positions."""
        pairs = [
            (f"{use.label}.{low}", f"{use.label}.{high}")
            for use in model.effects
            for low, high in use.effect.ordered
        ]
        values, storages = model.values, []
        for balance in model.balances.values():
            names = {
                name: index[name]
                for name in balance.storage.names
                if name in model.parameters and name in index
            }
            now = evaluate(balance.storage.tree, values)
            if names and now and math.isfinite(now):
                storages.append((balance.storage, names, math.copysign(1.0, now)))
        return cls(tuple((index[low], index[high]) for low, high in pairs), tuple(storages))

    def __call__(self, p: Array) -> bool:
        """Whether the machine with these parameters, shape (parameters,), can be."""
        if any(not p[low] < p[high] for low, high in self.pairs):
            return False
        sizes = (
            evaluate(s.tree, {n: float(p[k]) for n, k in names.items()}) * sign
            for s, names, sign in self.storages
        )
        return all(not size <= 0.0 for size in sizes)
