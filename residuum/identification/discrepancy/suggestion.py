"""A formula for the free term: the few simple functions of its axis that make up its curve."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from residuum.array_types import FloatArray
from residuum.identification.discrepancy.policy import FORMULA_TERMS

LIBRARY: Mapping[str, Callable[[FloatArray], FloatArray]] = {
    "1": np.ones_like,
    "{z}": lambda z: z,
    "{z}²": np.square,
    "{z}³": lambda z: z**3,
    "sign({z})": np.sign,
    "|{z}|·{z}": lambda z: np.abs(z) * z,
    "|{z}|": np.abs,
    "sin(2π·{z})": lambda z: np.sin(2 * np.pi * z),
    "cos(2π·{z})": lambda z: np.cos(2 * np.pi * z),
    "exp(−({z}/0.15)²)·sign({z})": lambda z: np.exp(-((z / 0.15) ** 2)) * np.sign(z),
}
"""Functions of z = axis / largest magnitude on the axis."""


@dataclass(frozen=True)
class Suggestion:
    """A sum of library functions: `formula` (coefficients in the term's unit), `largest` = the axis
    value that z = 1 stands for, and the `share` of the curve's variance that it follows.
    """

    formula: str
    largest: float
    share: float


def nearest_formula(at: FloatArray, value: FloatArray) -> Suggestion | None:
    """The sparse regression of a curve, `value` (knots,) over `at` (knots,); None for one without
    any spread.

    Every sum of up to three functions is tried (the library is small); Schwarz's criterion on the
    knots chooses. It is a description, not a law: a function of the wrong axis is described as
    willingly.
    """
    largest = float(np.max(np.abs(at)))
    spread = float(np.sum((value - value.mean()) ** 2))
    if not largest > 0 or not spread > 0:
        return None
    z, n = at / largest, at.size
    columns = {name: function(z) for name, function in LIBRARY.items()}
    best: tuple[float, tuple[str, ...], FloatArray, float] | None = None
    for count in range(1, FORMULA_TERMS + 1):
        for names in combinations(columns, count):
            design: FloatArray = np.column_stack([columns[name] for name in names])
            coefficients: FloatArray = np.asarray(
                np.linalg.lstsq(design, value, rcond=None)[0], dtype=np.float64
            )
            squares = float(np.sum((value - design @ coefficients) ** 2))
            criterion = float(n * np.log(squares / spread + 1e-6) + count * np.log(n))
            if best is None or criterion < best[0]:
                best = criterion, names, coefficients, squares
    assert best is not None
    _, chosen, weights, left = best
    terms = [f"{c:+.3g}·{name.format(z='z')}" for c, name in zip(weights, chosen, strict=True)]
    return Suggestion(" ".join(terms), largest, max(0.0, 1.0 - left / spread))
