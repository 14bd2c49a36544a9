"""A stored identified model over frequency, with its confidence, and in the plane of z."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from fastapi import APIRouter, Query, Response
from pydantic import BaseModel, Field

from residuum.array_types import FloatArray
from residuum.identification.linear_models.identified_model import IdentifiedModel
from residuum.service.api.analyses import content_of
from residuum.service.api.answers import PROBLEMS
from residuum.service.api.parameters import ModelName
from residuum.service.api.responses import Json, StrictRoute
from residuum.service.services import Running, Services
from residuum.service.views.signal_view import read_identified

router = APIRouter(prefix="/models", tags=["models"], route_class=StrictRoute, responses=PROBLEMS)

# The lowest frequency, as a share of the Nyquist frequency. A response of m samples changes over
# frequencies of 1/(m Ts): below this share that of some hundred coefficients is its static gain.
_LOWEST = 1e-3


class FrequencyResponseAnswer(BaseModel):
    """Bode points; `magnitude_std` and `phase_std` are first-order standard deviations."""

    frequency: list[float] = Field(description="[Hz], logarithmic up to the Nyquist frequency.")
    magnitude: list[float] = Field(description="[output unit / input unit].")
    magnitude_std: list[float]
    phase: list[float] = Field(description="Unwrapped [degree].")
    phase_std: list[float] = Field(description="[degree].")


@router.get("/{model}/frequency-response", response_model=FrequencyResponseAnswer)
def get_frequency_response(
    running: Running,
    model: ModelName,
    version: Annotated[
        int | None, Query(description="Version (default: the newest).", ge=1, le=10**9)
    ] = None,
    points: Annotated[int, Query(description="Frequencies.", ge=2, le=2000)] = 300,
) -> Response:
    """Magnitude and phase over frequency with their standard deviations."""
    return Json(frequency_response(_identified(running, model, version), points))


class Root(BaseModel):
    """A root of a polynomial in z."""

    real: float
    imaginary: float
    magnitude: float


class PolesAndZerosAnswer(BaseModel):
    """Roots of the denominator and the numerator of G(z); null for a model that is an impulse
    response.
    """

    poles: list[Root] | None
    zeros: list[Root] | None


@router.get("/{model}/poles-and-zeros", response_model=PolesAndZerosAnswer)
def get_poles_and_zeros(
    running: Running,
    model: ModelName,
    version: Annotated[
        int | None, Query(description="Version (default: the newest).", ge=1, le=10**9)
    ] = None,
) -> Response:
    """Poles and zeros of G(z), those that its dead time puts at the origin among them."""
    identified = _identified(running, model, version)
    return Json({"poles": _roots(identified.denominator), "zeros": _roots(identified.numerator)})


def _roots(polynomial: FloatArray | None) -> list[dict[str, float]] | None:
    if polynomial is None:
        return None
    return [
        {"real": z.real, "imaginary": z.imag, "magnitude": abs(z)}
        for z in np.roots(polynomial).tolist()
    ]


def _identified(running: Services, model: str, version: int | None) -> IdentifiedModel:
    """The stored model of this name; Conflict for one of another kind."""
    return read_identified(content_of(running, model, "identified", version))


def frequency_response(model: IdentifiedModel, points: int) -> dict[str, list[float]]:
    """Bode points with first-order deviations: the parts of the covariance of (Re G, Im G) along
    and across G.
    """
    nyquist = 0.5 / model.sample_time
    frequency = np.geomspace(_LOWEST * nyquist, nyquist, points)
    G = model.frequency_response(2 * np.pi * frequency)
    covariance = model.frequency_covariance(2 * np.pi * frequency)
    magnitude = np.abs(G)
    # The unit vector of G in the plane of (Re G, Im G), and the one across it: to first order the
    # magnitude moves along the one, the phase along the other by σ/|G|.
    along = np.stack([G.real, G.imag], axis=1) / np.maximum(magnitude, 1e-300)[:, None]
    across = np.stack([-along[:, 1], along[:, 0]], axis=1)
    radial, tangential = (
        np.sqrt(np.maximum(np.einsum("ni,nij,nj->n", d, covariance, d), 0.0))
        for d in (along, across)
    )
    return {
        "frequency": frequency.tolist(),
        "magnitude": magnitude.tolist(),
        "magnitude_std": radial.tolist(),
        "phase": np.degrees(np.unwrap(np.angle(G))).tolist(),
        "phase_std": np.degrees(tangential / np.maximum(magnitude, 1e-300)).tolist(),
    }
