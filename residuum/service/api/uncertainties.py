"""How far an identified model is to be trusted: its uncertainty weight over sampled models, and the residual it allows."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from fastapi import APIRouter, Query, Response
from pydantic import BaseModel, Field

from residuum.identification.linear_models.error_bounds.error_grid import asked_grid
from residuum.identification.linear_models.uncertainty import WEIGHT_ORDER, design_uncertainty_weight
from residuum.service.api.analyses import RecordNumbers
from residuum.service.api.answers import PROBLEMS, JobAnswer
from residuum.service.api.jobs import accepted
from residuum.service.api.json_response import Json, StrictRoute
from residuum.service.api.parameters import ModelName
from residuum.service.services import Running, Services
from residuum.service.store import Conflict
from residuum.service.views.residual_view import read_identified, view_residual
from residuum.service.work.record_parts import parts_of

router = APIRouter(prefix="/models/{model}", tags=["models"], route_class=StrictRoute, responses=PROBLEMS)

Version = Annotated[int | None, Query(description="Version (default: the newest).", ge=1, le=10**9)]
_POINTS = 200
_LOWEST = 1e-3  # of the Nyquist frequency


class UncertaintyAnswer(BaseModel):
    """The error of sampled models in the form that was asked for, and the weight above them."""

    frequency: list[float] = Field(description="[Hz].")
    samples: list[list[float]] = Field(description="Error of every drawn model.")
    form: str = Field(description="`multiplicative` |G/Ĝ₀ − 1|, `additive` |G − Ĝ₀|, or `inverse-multiplicative` |Ĝ₀/G − 1|.")
    sampled_frequency: list[float] = Field(description="Where the weight was fitted [Hz].")
    largest: list[float] = Field(description="Ω, the largest relative error of all models that the weight was made from.")
    weight: list[float] = Field(description="|W_T| at `frequency`.")
    critical_frequency: float | None = Field(description="From here on the weight is 1 or more [Hz].")
    n_samples: int
    promise: str
    certified: bool = Field(description="Whether the weight is proven above all drawn models between the frequencies too.")


class ResidualView(BaseModel, extra="forbid"):
    """Which records a residual generator learns its noise from, and which one it runs on."""

    healthy: RecordNumbers
    record: int = Field(ge=1, le=2**53 - 1, description="Number of the record it runs on.")
    offset: float | None = Field(None, gt=0, description="Sensor offset of the characteristic; null: twice the noise.")
    false_alarms_per_day: float = Field(1.0, gt=0, le=86400, description="Of the posterior threshold.")
    version: int | None = Field(None, ge=1, le=10**9, description="Version of the model (default: the newest).")


@router.get("/uncertainty", response_model=UncertaintyAnswer)
def get_uncertainty(
    running: Running,
    model: ModelName,
    version: Version = None,
    shown: Annotated[int, Query(alias="samples", description="Drawn models to show.", ge=1, le=200)] = 40,
    epsilon: Annotated[float, Query(description="ε of the number of models drawn.", ge=0.005, le=0.5)] = 0.05,
    zeta: Annotated[float, Query(description="ζ of the number of models drawn.", ge=1e-6, le=0.5)] = 0.05,
    rule: Annotated[Literal["chernoff", "worst-case"], Query(description="What ε and ζ promise.")] = "chernoff",
    order: Annotated[int, Query(description="Order of the weight.", ge=0, le=8)] = WEIGHT_ORDER,
    form: Annotated[
        Literal["multiplicative", "additive", "inverse-multiplicative"], Query(description="Form of the error that is bounded.")
    ] = "multiplicative",
    points: Annotated[int | None, Query(description="Frequencies that the grid begins with.", ge=2, le=5000)] = None,
    lowest: Annotated[float | None, Query(description="Lowest of these frequencies [rad/s].", gt=0, le=1e12)] = None,
) -> Response:
    """The uncertainty weight of an identified model, above the models that its posterior allows."""
    identified = read_identified(_content(running, model, version))
    grid = asked_grid(identified.sample_time, points, lowest)
    made = design_uncertainty_weight(
        identified, omega=grid, accuracy=epsilon, confidence=1 - zeta, rule=rule, form=form, order=order
    )
    omega = 2 * np.pi * np.geomspace(_LOWEST, 1.0, _POINTS) * 0.5 / identified.sample_time
    turn = np.exp(-1j * np.outer(omega * identified.sample_time, np.arange(identified.reach)))
    drawn = identified.sample_longer(shown, 0) @ turn.T
    centre = turn[:, : identified.order] @ identified.impulse_response
    below = {"multiplicative": centre, "additive": np.ones(1), "inverse-multiplicative": drawn}[form]
    errors = np.abs(drawn - centre) / np.maximum(np.abs(below), 1e-300)
    critical = made.critical_frequency
    answer = {
        "frequency": (omega / (2 * np.pi)).tolist(),
        "samples": errors.tolist(),
        "form": form,
        "sampled_frequency": (made.omega / (2 * np.pi)).tolist(),
        "largest": made.magnitude.tolist(),
        "weight": np.abs(made.weight.frequency_response(omega)).tolist(),
        "critical_frequency": None if critical is None else critical / (2 * np.pi),
        "n_samples": made.n_samples,
        "promise": made.promise,
        "certified": made.certified,
    }
    return Json(answer)


@router.post("/residual-views", status_code=202, response_model=JobAnswer)
def view(running: Running, model: ModelName, asked: ResidualView) -> Response:
    """Design a residual generator and run it: residual, statistic and threshold over time, and its operating characteristic."""
    content = _content(running, model, asked.version)
    healthy = [parts_of(running.store.record_samples(number)) for number in asked.healthy]
    record = parts_of(running.store.record_samples(asked.record))
    arguments = (content, healthy, record, asked.offset, asked.false_alarms_per_day)
    return accepted(running.jobs.submit("residual-view", view_residual, *arguments))


def _content(running: Services, model: str, version: int | None) -> bytes:
    found = running.store.model_versions(model)[0].kind
    if found != "identified":
        raise Conflict(f"model {model!r}: is a {found} model; this needs an identified one")
    return running.store.model_content(model, version)
