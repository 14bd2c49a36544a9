"""What the residuals of a model say against it: are they white, are they free of the input, where does the input explain more.

Prediction errors ε = H⁻¹ (y − G u) of a method with a noise model, simulation errors y − G u of the others. Three questions with
their levels: whiteness (Ljung–Box; only a noise model claims it), cross-correlation with past inputs, and the kernel model error
model of (1.125), whose simultaneous band says at which frequencies the model is falsified.

Assumes data that the model was not estimated from: on its own data a model with many coefficients looks better than it is, and
the levels do not hold. Fails to see what the input does not excite, and takes a drift for a lack of whiteness.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import signal

from residuum.array_types import FloatArray
from residuum.identification.errors import BadInput, NotIdentifiable
from residuum.identification.linear_models.identified_model import IdentifiedModel
from residuum.identification.linear_models.validation.fit import simulated_beside
from residuum.identification.linear_models.validation.model_error import ModelErrorModel, model_error_model
from residuum.identification.linear_models.validation.residual_tests import ResidualTest, input_correlation_test, whiteness_test
from residuum.identification.record import Record

LEVEL = 0.01
"""Share of right models that one of the tests speaks against."""
_LAGS, _SAMPLES_A_LAG = 25, 10
_MOST_OF_A_RESPONSE, _BEYOND = 50, 10
_SETTLED = 1e-3


@dataclass(frozen=True, eq=False)
class ResidualCheck:
    """The tests of one part; None where it is too short for a test, or the model has no answer to it.

    Attributes
    ----------
    whiteness : ResidualTest or None
        None as well for a method without a noise model, whose residuals need not be white.
    input : ResidualTest or None
        Cross-correlation with past inputs.
    model_error : ModelErrorModel or None
        None as well for a model that integrates.
    samples : int
        Residuals that were tested.
    """

    whiteness: ResidualTest | None
    input: ResidualTest | None
    model_error: ModelErrorModel | None
    samples: int

    @property
    def passed(self) -> bool:
        """Whether no test speaks against the model."""
        tests = [test for test in (self.whiteness, self.input) if test is not None]
        return all(test.passed for test in tests) and not (self.model_error is not None and self.model_error.falsified)


def residual_check(model: IdentifiedModel, record: Record, first: int = 0, level: float = LEVEL) -> ResidualCheck:
    """Test a model on the samples of `record` from `first` on; those before only give the input its past.

    Raises
    ------
    BadInput
        A level outside (0, 1).
    BadRecord
        No sample has its whole past in the record, or the output does not move.
    """
    if not 0 < level < 1:
        raise BadInput(f"residual check, level: is {level}; must lie between 0 and 1")
    e = prediction_errors(model, record)[first:]
    u = np.asarray(record[model.input_name], dtype=float)[first:]
    n = int(np.isfinite(e).sum())
    longest = max(2, n // _SAMPLES_A_LAG)
    lags = min(_LAGS, longest)
    reached = (
        model.delay + min(model.order, _MOST_OF_A_RESPONSE) + _BEYOND
    )  # an input that a cut response leaves out acts behind it
    white: ResidualTest | None
    free: ResidualTest | None
    wrong: ModelErrorModel | None
    try:
        white = whiteness_test(e, lags=lags, level=level) if model.noise_numerator is not None else None
    except BadInput:
        white = None
    try:
        free = input_correlation_test(e, u, lags=min(max(lags, reached), longest), first_lag=min(model.delay, 1), level=level)
    except BadInput:
        free = None
    try:
        wrong = None if model.integrates else model_error_model(model, record.window(first, record.n), level=level)
    except BadInput:
        wrong = None
    return ResidualCheck(white, free, wrong, n)


def prediction_errors(model: IdentifiedModel, record: Record) -> FloatArray:
    """ε about its mean, shape (n,): H⁻¹ (y − G u), H = 1 where there is no noise model; NaN where the past is not whole.

    H⁻¹ begins anew behind every gap, and its first samples, until an unknown past has faded to a thousandth, are left out.

    Raises BadRecord as `simulated_beside` does, NotIdentifiable for a model whose simulation diverges.
    """
    _, residual = simulated_beside(model, record)
    if not np.isfinite(residual[~np.isnan(residual)]).all():
        raise NotIdentifiable(
            f"model {model.method}: its simulation diverges, so its residuals tell nothing; take another order or method"
        )
    residual = residual - np.nanmean(residual)
    if model.noise_numerator is None or model.noise_denominator is None:
        return np.asarray(residual)
    memory = _memory(model.noise_numerator)
    e = np.full(len(residual), np.nan)
    known = np.flatnonzero(np.isfinite(residual))
    for run in np.split(known, np.flatnonzero(np.diff(known) > 1) + 1):
        filtered = signal.lfilter(model.noise_denominator, model.noise_numerator, residual[run])
        skipped = max(memory, len(model.noise_denominator) - 1)
        e[run[skipped:]] = filtered[skipped:]
    return e


def _memory(numerator: FloatArray) -> int:
    """Samples until 1/C has forgotten its beginning to a thousandth."""
    largest = float(np.abs(np.roots(numerator)).max(initial=0.0))
    return 0 if largest < _SETTLED else int(np.ceil(np.log(_SETTLED) / np.log(min(largest, 0.999))))
