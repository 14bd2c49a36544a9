"""How far an identified model is to be trusted: its uncertainty weight over sampled models, and the
residual it allows.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, ClassVar

import numpy as np
from fastapi import APIRouter, Query, Response
from pydantic import BaseModel, Field

from residuum.library.questions import part_of
from residuum.library.questions.residual import DesignResidual, RunResidual
from residuum.library.questions.uncertainty import Uncertainty, weight_for
from residuum.service.api.analyses import RecordNumbers, content_of
from residuum.service.api.answers import PROBLEMS, JobAnswer
from residuum.service.api.parameters import ModelName
from residuum.service.api.responses import Json, StrictRoute, accepted
from residuum.service.services import Running
from residuum.service.views.signal_view import read_identified, view_residual
from residuum.service.work.worker_pool import parts_of

router = APIRouter(
    prefix="/models/{model}", tags=["models"], route_class=StrictRoute, responses=PROBLEMS
)

# Frequencies that are drawn.
_POINTS = 200
# The lowest of them, as a share of the Nyquist frequency. As of the frequency response, so that
# both can be laid over each other.
_LOWEST = 1e-3


class UncertaintyAnswer(BaseModel):
    """The error of sampled models in the form that was asked for, and the weight above them."""

    frequency: list[float] = Field(description="[Hz].")
    samples: list[list[float]] = Field(description="Error of every drawn model.")
    form: str = Field(
        description=(
            "`multiplicative` |G/Ĝ₀ − 1|, `additive` |G − Ĝ₀|, or `inverse-multiplicative` |Ĝ₀/G"
            " − 1|."
        )
    )
    sampled_frequency: list[float] = Field(description="Where the weight was fitted [Hz].")
    largest: list[float] = Field(
        description="Ω, the largest relative error of all models that the weight was made from."
    )
    weight: list[float] = Field(description="|W_T| at `frequency`.")
    critical_frequency: float | None = Field(
        description="From here on the weight is 1 or more [Hz]."
    )
    n_samples: int
    promise: str
    certified: bool = Field(
        description=(
            "Whether the weight is proven above all drawn models between the frequencies too."
        )
    )


class ResidualView(DesignResidual, RunResidual):
    """Which records a residual generator learns its noise from, and which one it runs on."""

    healthy: RecordNumbers
    record: int = Field(ge=1, le=2**53 - 1, description="Number of the record it runs on.")
    offset: float | None = Field(
        None, gt=0, description="Sensor offset of the characteristic; null: twice the noise."
    )
    version: int | None = Field(
        None, ge=1, le=10**9, description="Version of the model (default: the newest)."
    )


class StoredUncertainty(Uncertainty):
    """The question `uncertainty` of a stored model."""

    version: int | None = Field(None, ge=1, le=10**9, description="Version (default: the newest).")
    samples: int = Field(40, ge=1, le=200, description="Drawn models to show.")
    order: int | None = Field(
        None, ge=0, le=20, description="What `weight_order` was called.", deprecated=True
    )

    renamed: ClassVar[Mapping[str, str]] = {"order": "weight_order"}


@router.get("/uncertainty", response_model=UncertaintyAnswer)
def get_uncertainty(
    running: Running,
    model: ModelName,
    asked: Annotated[StoredUncertainty, Query()],
) -> Response:
    """The uncertainty weight of an identified model, above the models that its posterior allows."""
    identified = read_identified(content_of(running, model, "identified", asked.version))
    uncertainty = weight_for(identified, asked, asked.form, asked.seed)
    omega = 2 * np.pi * np.geomspace(_LOWEST, 1.0, _POINTS) * 0.5 / identified.sample_time
    # G(e^{iω Ts}) = Σ g_k e^{−iω Ts k}; the drawn responses reach further than the model's own.
    turn = np.exp(-1j * np.outer(omega * identified.sample_time, np.arange(identified.reach)))
    # The longer response, where there is one: a posterior of m coefficients knows nothing of those
    # after them, and a weight drawn from it lay below the true error. Seed 0: a page that is read
    # again shows the same curves.
    drawn = identified.sample_longer(asked.samples, 0) @ turn.T
    centre = turn[:, : identified.order] @ identified.impulse_response
    # What the error is relative to, by its form.
    below = {"multiplicative": centre, "additive": np.ones(1), "inverse-multiplicative": drawn}[
        asked.form
    ]
    errors = np.abs(drawn - centre) / np.maximum(np.abs(below), 1e-300)
    critical = uncertainty.critical_frequency
    answer = {
        "frequency": (omega / (2 * np.pi)).tolist(),
        "samples": errors.tolist(),
        "form": asked.form,
        "sampled_frequency": (uncertainty.omega / (2 * np.pi)).tolist(),
        "largest": uncertainty.magnitude.tolist(),
        "weight": np.abs(uncertainty.weight.frequency_response(omega)).tolist(),
        "critical_frequency": None if critical is None else critical / (2 * np.pi),
        "n_samples": uncertainty.n_samples,
        "promise": uncertainty.promise,
        "certified": uncertainty.certified,
    }
    return Json(answer)


@router.post("/residual-views", status_code=202, response_model=JobAnswer)
def view(running: Running, model: ModelName, asked: ResidualView) -> Response:
    """Design a residual generator and run it: residual, statistic and threshold over time, and its
    operating characteristic.
    """
    content = content_of(running, model, "identified", asked.version)
    healthy = [parts_of(running.store.record_samples(number)) for number in asked.healthy]
    record = parts_of(running.store.record_samples(asked.record))
    arguments = (
        content,
        healthy,
        record,
        asked.offset,
        part_of(asked, DesignResidual),
        part_of(asked, RunResidual),
    )
    return accepted(running.jobs.submit("residual-view", view_residual, *arguments))
