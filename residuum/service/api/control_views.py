"""Robust controllers to look at: the front of what is possible, bounds, step responses, and code for the target."""

from __future__ import annotations

from typing import Annotated, Literal

from fastapi import APIRouter, Response
from pydantic import BaseModel, Field, model_validator

from residuum.robust_control.control_problem import WeightChoice
from residuum.service.api.answers import PROBLEMS, JobAnswer
from residuum.service.api.jobs import accepted
from residuum.service.api.json_response import StrictRoute
from residuum.service.api.parameters import NAME
from residuum.service.services import Running, Services
from residuum.service.store import Conflict
from residuum.service.views.control_view import view_control_design

router = APIRouter(tags=["analyses"], route_class=StrictRoute, responses=PROBLEMS)

Limit = Annotated[float | None, Field(ge=-1e300, le=1e300, description="Of the actuator, for the exported code; null: none.")]


class ModelVersion(BaseModel, extra="forbid"):
    """A stored identified model."""

    model: str = Field(pattern=NAME)
    version: int | None = Field(None, ge=1, le=10**9, description="Null: the newest.")


class ControlView(BaseModel, extra="forbid"):
    """Which models a controller is designed for, of which structure, and what is asked of the loop."""

    models: list[ModelVersion] = Field(min_length=1, max_length=16, description="One an operating point.")
    aim: Literal["nominal", "robust"] = Field("nominal", description="Best behaviour, or every model of the band.")
    structure: Literal["pidn", "pid", "pi", "lead-lag", "rational"] = Field("pidn", description="Form of the controller.")
    overshoot: float = Field(0.01, gt=0, lt=1, description="nominal: overshoot below which less brings no benefit (0.01 = 1 %).")
    settling_time: float | None = Field(None, gt=0, le=1e12, description="nominal: longest settling time [s].")
    slack: float = Field(0.1, gt=0, le=100, description="nominal: slack of the mixed-sensitivity bound.")
    only: Literal["overshoot", "settling-time", "high-gain", "critical-frequency"] | None = Field(
        None, description="One wish alone chooses the point: the first two with `nominal`, the others with `robust`."
    )
    in_time: bool = Field(False, description="nominal: hold overshoot and settling time in time, not by the weight.")
    low_gain_db: float = Field(120.0, gt=0, le=400, description="robust: l_g, gain of W_S at low frequency [dB].")
    smallest_high_gain_db: float = Field(-50.0, lt=-0.5, ge=-400, description="robust: least h_g [dB].")
    lowest_critical_frequency: float | None = Field(None, gt=0, le=1e12, description="robust: least ω_c [rad/s].")
    epsilon: float = Field(0.05, ge=0.005, le=0.5, description="ε of the number of plants drawn.")
    zeta: float = Field(0.05, ge=1e-6, le=0.5, description="ζ of the number of plants drawn.")
    rule: Literal["chernoff", "worst-case"] = Field("chernoff", description="What ε and ζ promise.")
    weight_order: int = Field(2, ge=0, le=8, description="Order of W_T.")
    points: int = Field(600, ge=50, le=5000, description="Frequencies of the grid.")
    lowest: float | None = Field(None, gt=0, le=1e12, description="Lowest frequency of the grid [rad/s].")
    lower: Limit = None
    upper: Limit = None
    seed: int = Field(0, ge=0, le=2**32 - 1, description="Of the random plants.")

    @model_validator(mode="after")
    def _ordered(self) -> ControlView:
        if self.lower is not None and self.upper is not None and self.lower >= self.upper:
            raise ValueError("the lower limit must be below the upper")
        return self


@router.post("/control-designs/views", status_code=202, response_model=JobAnswer)
def view(running: Running, asked: ControlView) -> Response:
    """Controllers along the front of what is possible: bounds, open loop, step responses of drawn plants, code to download."""
    contents = [_content(running, each) for each in asked.models]
    wishes = asked.model_dump(
        include={"aim", "overshoot", "settling_time", "slack", "only", "in_time"}
        | {"low_gain_db", "smallest_high_gain_db", "lowest_critical_frequency"}
    )
    weight = WeightChoice(asked.epsilon, asked.zeta, asked.rule, asked.weight_order, asked.points, asked.lowest)
    arguments = (contents, asked.structure, wishes, (asked.lower, asked.upper), asked.seed, weight)
    return accepted(running.jobs.submit("control-view", view_control_design, *arguments))


def _content(running: Services, asked: ModelVersion) -> bytes:
    found = running.store.model_versions(asked.model)[0].kind
    if found != "identified":
        raise Conflict(f"model {asked.model!r}: is a {found} model; this needs an identified one")
    return running.store.model_content(asked.model, asked.version)
