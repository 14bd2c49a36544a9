"""Ways to state how far an identified model may be from the plant, other than the covariance of its own estimate.

A covariance that an estimate makes of itself knows variance, not bias: a model of too low an order looks certain. Here the
error G − Ĝ₀ is identified from residuals that the model leaves on records, and stated as the second moment Σ_e + ê êᵀ of the
error's impulse response, so that random models drawn about Ĝ₀ reach as far as it does. Weights, residuals and controllers then
use it as they use any covariance; section 1.4.3 and Remark 2.9 of the source.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from residuum.array_types import FloatArray
from residuum.identification.errors import BadInput, NotIdentifiable
from residuum.identification.linear_models.identified_model import IdentifiedModel
from residuum.identification.linear_models.set_membership import feasible_set
from residuum.identification.linear_models.stochastic_embedding import laguerre_basis, stochastic_embedding
from residuum.identification.linear_models.validation.model_error import model_error_model, residual_record
from residuum.identification.record import Record

_LAGS, _LEAST_LAGS = 100, 20
_SET_LAGS, _SET_ROWS = 20, 4000
_ROOM = 1.1
_POLES = (0.2, 0.4, 0.6, 0.75, 0.85, 0.92, 0.96)
_FUNCTIONS = 4


def with_model_error(model: IdentifiedModel, records: Sequence[Record], noise_bound: float | None = None) -> IdentifiedModel:
    """The model with a kernel model error model (1.125) from records: Σ_e + ê êᵀ of the error's impulse response.

    Raises BadInput when a noise bound is given: this way has none; and what `model_error_model` raises.
    """
    if noise_bound is not None:
        raise BadInput("uncertainty model-error: takes no noise bound; that belongs to set-membership")
    shortest = min(record.n for record in records)
    lags = max(_LEAST_LAGS, min(_LAGS, shortest // 4))
    found = model_error_model(model, records, order=lags)
    verdict = "falsified" if found.falsified else "not falsified"
    said = f"model error model: {verdict}, at {len(found.falsified_at)} of {len(found.omega)} frequencies"
    return _with_error(model, found.error.impulse_response, found.error.covariance, "model-error", said)


def with_set_membership(model: IdentifiedModel, records: Sequence[Record], noise_bound: float | None = None) -> IdentifiedModel:
    """The model with a set-membership model error model (1.127): all error responses that noise below a bound allows.

    Each coefficient is taken as evenly spread over its interval, centre c and half width r: second moment diag(r²/3) + c cᵀ.

    Parameters
    ----------
    noise_bound : float or None
        ν [output unit]; None: 1.1 times the smallest with which any error response is possible.

    Raises
    ------
    NotIdentifiable
        The bound is too small: no error response agrees with the records; says the smallest that does.
    """
    Phi, residual = _regression(model, records)
    smallest = feasible_set(Phi, residual, 1e-12 * float(np.abs(residual).max() or 1.0)).smallest_bound
    bound = _ROOM * smallest if noise_bound is None else noise_bound
    found = feasible_set(Phi, residual, bound)
    if found.empty:
        raise NotIdentifiable(
            f"uncertainty set-membership: with noise of at most {bound:.4g} {model.output_unit} no error response agrees with "
            f"the records; the smallest bound that leaves one is {smallest:.4g}".replace("  ", " ")
        )
    said = f"set membership: noise at most {bound:.4g} {model.output_unit}".rstrip()
    said += f", smallest possible {smallest:.4g}"
    return _with_error(model, found.centre, np.diag(found.radius**2 / 3.0), "set-membership", said)


def with_stochastic_embedding(
    model: IdentifiedModel, records: Sequence[Record], noise_bound: float | None = None
) -> IdentifiedModel:
    """Stochastic embedding (1.124) in the model's place: four Laguerre functions of the likeliest pole, and a random error.

    Raises BadInput when a noise bound is given, NotIdentifiable when the records do not excite the basis.
    """
    if noise_bound is not None:
        raise BadInput("uncertainty stochastic-embedding: takes no noise bound; that belongs to set-membership")
    return likeliest_embedding(records, model.input_name, model.output_name, delay=model.delay)


def likeliest_embedding(
    records: Sequence[Record], input: str, output: str, *, delay: int = 1, order: int | None = None, offset: bool = True
) -> IdentifiedModel:
    """The nominal model of `stochastic_embedding` on four Laguerre functions of the likeliest of seven poles.

    Assumes that what four functions leave over decays and swings about zero (kernel `dc`). Fails, with bands too narrow, where
    that error is large: a resonance beside a slow mode, of which one pole fits only one.

    Parameters
    ----------
    order : int or None
        Length of the impulse response; None: 100, at most a quarter of the shortest record.

    Raises
    ------
    NotIdentifiable
        The records do not excite the basis.
    """
    if order is None:
        order = max(_LEAST_LAGS, min(_LAGS, min(record.n for record in records) // 4))
    functions = min(_FUNCTIONS, order)
    tried = [
        stochastic_embedding(
            records, input, output, basis=laguerre_basis(pole, functions, order), delay=delay, offset=offset
        ).nominal
        for pole in _POLES
    ]
    best = int(np.argmin([one.negative_log_likelihood for one in tried]))
    said = f"stochastic embedding: {functions} Laguerre functions of pole {_POLES[best]:g}; the nominal model is theirs"
    return replace(tried[best], warnings=(*tried[best].warnings, said))


ERROR_MODELS: dict[str, Callable[[IdentifiedModel, Sequence[Record], float | None], IdentifiedModel]] = {
    "model-error": with_model_error,
    "set-membership": with_set_membership,
    "stochastic-embedding": with_stochastic_embedding,
}
"""Name of a choice of `identify --uncertainty` → what makes it; each takes the model, records and a noise bound or None."""


def _regression(model: IdentifiedModel, records: Sequence[Record]) -> tuple[FloatArray, FloatArray]:
    """Lagged inputs and what the model leaves of the output, about its mean; rows with anything missing are left out."""
    rows, targets = [], []
    for record in records:
        left = residual_record(model, record)
        u, e = left[model.input_name], left[model.output_name]
        lags = model.delay + np.arange(_SET_LAGS)
        first = int(lags[-1])
        Phi = np.stack([u[first - lag : len(u) - lag] for lag in lags], axis=1)
        good = np.isfinite(Phi).all(axis=1) & np.isfinite(e[first:])
        rows.append(Phi[good])
        targets.append(e[first:][good] - np.mean(e[first:][good]))
    Phi, target = np.concatenate(rows)[:_SET_ROWS], np.concatenate(targets)[:_SET_ROWS]
    if len(target) < 2 * _SET_LAGS:
        raise NotIdentifiable(f"uncertainty set-membership: {len(target)} complete rows; at least {2 * _SET_LAGS} are needed")
    return np.asarray(Phi, dtype=float), np.asarray(target, dtype=float)


def _with_error(model: IdentifiedModel, error: FloatArray, covariance: FloatArray, name: str, said: str) -> IdentifiedModel:
    """The nominal impulse response, with the second moment of the error about it as its covariance."""
    m = max(model.order, len(error))
    g, e, spread = np.zeros(m), np.zeros(m), np.zeros((m, m))
    g[: model.order], e[: len(error)] = model.impulse_response, error
    spread[: len(error), : len(error)] = covariance
    return IdentifiedModel(
        method=f"{model.method}+{name}",
        sample_time=model.sample_time,
        impulse_response=g,
        covariance=spread + np.outer(e, e),
        noise_variance=model.noise_variance,
        input_name=model.input_name,
        input_unit=model.input_unit,
        output_name=model.output_name,
        output_unit=model.output_unit,
        delay=model.delay,
        offset=model.offset,
        hyper_parameters=model.hyper_parameters,
        warnings=(*model.warnings, said),
        provenance=model.provenance,
    )
