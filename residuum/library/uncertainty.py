"""How far an identified plant is to be trusted, at every frequency."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from os import PathLike
from typing import Any

import numpy as np

from residuum.identification.linear_models.identified_model import IdentifiedModel
from residuum.identification.linear_models.uncertainty import UncertaintyWeight
from residuum.library.picture import Curve, Panel, Picture
from residuum.library.plant import Plant, plant_of
from residuum.library.questions import asks
from residuum.library.questions.uncertainty import Uncertainty as Asked
from residuum.library.questions.uncertainty import weight_for
from residuum.library.result import Result, Row


@dataclass(frozen=True, eq=False, repr=False)
class Uncertainty(Result):
    """The error of the models that an identified model's distribution allows, and the weight W_T
    above it (Algorithm 1).

    Attributes
    ----------
    bound : UncertaintyWeight
        The weight, the largest error Ω at frequencies ω [rad/s], and what the number of drawn
        models promises.

    Examples
    --------
    >>> import residuum as rs
    >>> plant = rs.identify(rs.simulate("process-plant", seed=1), input="u", output="y", order=40)
    >>> rs.uncertainty(plant).to_dict()["samples"]
    738
    """

    bound: UncertaintyWeight
    asked: Asked

    def _answer(self) -> dict[str, Any]:
        bound = self.bound
        return {
            # Whoever read the model from a file puts the file's name here.
            "identified": None,
            "form": bound.form,
            "rule": self.asked.rule,
            "epsilon": self.asked.epsilon,
            "zeta": self.asked.zeta,
            "samples": bound.n_samples,
            "promise": bound.promise,
            "certified": bound.certified,
            "weight": {
                "numerator": bound.weight.num,
                "denominator": bound.weight.den,
                "sample_time": bound.weight.sample_time,
            },
            "critical_frequency_rad_s": bound.critical_frequency,
            "frequency_rad_s": bound.omega,
            "largest_error": bound.magnitude,
        }

    def __str__(self) -> str:
        bound = self.bound
        proven = "proven at every frequency"
        between = (
            proven
            if bound.certified
            else "at the grid's frequencies alone; nothing is proven between them"
        )
        crossing = (
            "nowhere"
            if bound.critical_frequency is None
            else f"from {bound.critical_frequency:.4g} rad/s on"
        )
        return "\n".join(
            [
                (
                    f"{bound.form} error of {bound.n_samples} random models: at most"
                    f" {float(np.max(bound.magnitude)):.4g}"
                ),
                (
                    f"  W_T(z) = {_polynomial(bound.weight.num)} over"
                    f" {_polynomial(bound.weight.den)}, descending powers of z"
                ),
                f"  above the error {between}; 1 or more {crossing}",
                f"  {bound.promise}",
            ]
        )

    def _rows(self) -> Sequence[Row]:
        rows = zip(self.bound.omega, self.bound.magnitude, self._weight, strict=True)
        return [
            {
                "frequency_rad_s": float(omega),
                "largest_error": float(error),
                "weight": float(weight),
            }
            for omega, error, weight in rows
        ]

    def _picture(self) -> Picture:
        errors = Curve("largest error of the drawn models", self.bound.omega, self.bound.magnitude)
        weight = Curve("weight W_T", self.bound.omega, self._weight)
        return Picture(
            [
                Panel(
                    "error of the model",
                    "frequency [rad/s]",
                    self.bound.form,
                    [errors, weight],
                    "log",
                )
            ]
        )

    @property
    def _weight(self) -> np.ndarray[Any, np.dtype[np.float64]]:
        return np.abs(self.bound.weight.frequency_response(self.bound.omega))


def _polynomial(coefficients: np.ndarray[Any, Any]) -> str:
    return "[" + ", ".join(f"{value:.6g}" for value in coefficients) + "]"


@asks(Asked)
def uncertainty(plant: Plant | str | PathLike[str], **given: Any) -> Uncertainty:
    """How far the models that an identified model's distribution allows lie from it, at every
    frequency (Algorithm 1).

    Parameters
    ----------
    plant : Plant or file

    Returns
    -------
    Uncertainty

    Raises
    ------
    BadInput
        A lowest frequency that is not below π/Ts; a model whose response is zero.

    Examples
    --------
    See `Uncertainty`.

    >>> import residuum as rs
    >>> plant = rs.identify(rs.simulate("process-plant", seed=1), input="u", output="y", order=40)
    >>> rs.uncertainty(plant, rule="worst-case").to_dict()["form"]
    'multiplicative'
    """
    return bounded(plant_of(plant).identified, Asked.of(given))


def bounded(model: IdentifiedModel, asked: Asked) -> Uncertainty:
    """The answer for an identified model."""
    return Uncertainty(weight_for(model, asked, asked.form, asked.seed), asked)
