"""The question `control design`."""

from __future__ import annotations

import math
import warnings
from dataclasses import asdict
from typing import Annotated, Any, Self

from pydantic import BeforeValidator, Field, model_validator

from residuum.identification.errors import BadInput
from residuum.library.questions import field
from residuum.library.questions.uncertainty import WeightQuestion
from residuum.robust_control.control_problem import AIMS, STRUCTURES, WeightChoice

WISHES = {"nominal": ("overshoot", "settling-time"), "robust": ("high-gain", "critical-frequency")}
"""Aim → the two coordinates of its Pareto front."""

_NOMINAL, _ROBUST = {"aim": ["nominal"]}, {"aim": ["robust"]}

# JSON has no infinity; `-inf` of a command means the same as no limit.
Limit = Annotated[
    Annotated[float, Field(ge=-1e300, le=1e300)] | None,
    BeforeValidator(lambda given: None if str(given).lower() in ("-inf", "inf") else given),
]
"""A bound; none where it is infinite."""


class DesignController(WeightQuestion):
    """A robust controller of fixed structure for every plant that identified models do not
    exclude.
    """

    aim: str = field(
        "nominal",
        "nominal (the best behaviour, Algorithm 2) or robust (every model, Algorithm 3).",
        choices=AIMS,
    )
    structure: str = field("pidn", "Form of the controller.", choices=STRUCTURES)
    overshoot: float = field(
        0.01,
        "nominal: overshoot below which less brings no benefit (0.01 = 1 %).",
        only_with=(_NOMINAL,),
        gt=0,
        lt=1,
    )
    settling_time: float | None = field(
        None,
        "nominal: longest settling time [s]; default: ten times the longest impulse response.",
        only_with=(_NOMINAL,),
        gt=0,
        le=1e12,
    )
    slack: float = field(
        0.1,
        "nominal: slack γ of the mixed-sensitivity bound 1 + γ.",
        only_with=(_NOMINAL,),
        gt=0,
        le=100,
    )
    only: str | None = field(
        None,
        "Meet one wish alone: overshoot or settling-time; with the aim robust high-gain or"
        " critical-frequency.",
        choices=[wish for wishes in WISHES.values() for wish in wishes],
        choices_with={wish: {"aim": [aim]} for aim, wishes in WISHES.items() for wish in wishes},
        only_with=({"in_time": [False]}, _ROBUST),
    )
    in_time: bool = field(
        False,
        "nominal: hold overshoot and settling time in time, in the nominal loop and in 95 % of"
        " random plants.",
        only_with=(_NOMINAL,),
    )
    low_gain: float = field(
        120.0, "robust: l_g, gain of W_S at low frequency [dB].", only_with=(_ROBUST,), gt=0, le=400
    )
    # Below −0.5 dB, the largest h_g that is sought (`RobustAim`).
    high_gain: float = field(
        -50.0,
        "robust: smallest h_g, gain of W_S at high frequency [dB].",
        only_with=(_ROBUST,),
        lt=-0.5,
        ge=-400,
    )
    critical_frequency: float | None = field(
        None,
        "robust: lowest ω_c [rad/s]; default: a thousandth of where W_T reaches 1.",
        only_with=(_ROBUST,),
        gt=0,
        le=1e12,
    )
    points: int = field(600, "Frequencies of the grid, logarithmic up to π/Ts.", ge=50, le=5000)
    fix: dict[str, float] | None = field(
        None, "Parameters of the controller to hold.", example={"k_d": 0.0}
    )
    within: dict[str, tuple[float, float]] | None = field(
        None, "Parameters of the controller to keep between limits.", example={"k_i": [0.0, 0.3]}
    )
    limits: tuple[Limit, Limit] | None = field(
        None,
        "Limits of the actuator in the exported code, in the unit of the plant's input; default:"
        " none.",
        example=[-10.0, 10.0],
    )
    seed: int = field(0, "Seed of the random plants.", ge=0, le=2**32 - 1)

    @property
    def actuator(self) -> tuple[float, float]:
        """The limits as numbers."""
        low, high = self.limits or (None, None)
        return -math.inf if low is None else low, math.inf if high is None else high

    @model_validator(mode="before")
    @classmethod
    def _weight_as_before(cls, given: Any) -> Any:
        """The weight was a value of its own in Python."""
        if not (isinstance(given, dict) and isinstance(given.get("weight"), WeightChoice)):
            return given
        warnings.warn(
            "weight: will not be read much longer; say epsilon, zeta and so on",
            FutureWarning,
            stacklevel=4,
        )
        return asdict(given["weight"]) | {
            name: value for name, value in given.items() if name != "weight"
        }

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        self._refuse_wish_of_other_aim()
        if self.in_time and (self.aim != "nominal" or self.only is not None):
            raise BadInput(
                "", "in_time", "needs the aim nominal, and holds both wishes; leave only out"
            )
        low, high = self.limits or (None, None)
        if low is not None and high is not None and low >= high:
            raise BadInput(f"{low:g} {high:g}", "limits", "must have the lower one first")
        return self

    def _refuse_wish_of_other_aim(self) -> None:
        if self.only is None or self.only in WISHES[self.aim]:
            return
        right_aim = next(aim for aim, wishes in WISHES.items() if self.only in wishes)
        raise BadInput(
            repr(self.only),
            "only",
            f"is a wish of the aim {right_aim}",
            way_on=[("aim", right_aim)],
        )
