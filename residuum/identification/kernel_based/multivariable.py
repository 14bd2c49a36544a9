"""Several inputs, several outputs: kernel identification with a block prior, one posterior for each output."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from residuum.identification.errors import BadInput
from residuum.identification.kernel_based.impulse_response import NoiseVariance, check_settings, fit_impulse_response, provenance
from residuum.identification.kernel_based.lagged_data import lagged_data
from residuum.identification.kernel_based.marginal_bands import PointwiseBands
from residuum.identification.linear_models.identified_model import IdentifiedModel
from residuum.identification.record import Record

FloatArray = npt.NDArray[np.float64]
ComplexArray = npt.NDArray[np.complex128]


@dataclass(frozen=True, eq=False)
class MultivariableModel:
    """A grid of identified models, and for each output the joint covariance of its responses to all inputs.

    Attributes
    ----------
    models : tuple of tuple of IdentifiedModel
        `models[i][j]` leads from input j to output i; each is a model of its own with its marginal covariance.
    covariances : tuple of array, shape (n_u·m, n_u·m)
        For every output, over the stacked impulse responses [g_1 … g_nu].
    """

    models: tuple[tuple[IdentifiedModel, ...], ...]
    covariances: tuple[FloatArray, ...]

    @property
    def inputs(self) -> tuple[str, ...]:
        """Input channels in their order."""
        return tuple(model.input_name for model in self.models[0])

    @property
    def outputs(self) -> tuple[str, ...]:
        """Output channels in their order."""
        return tuple(row[0].output_name for row in self.models)

    def frequency_response(self, omega: npt.ArrayLike) -> ComplexArray:
        """G(e^{jωTs}), shape (len(omega), n_y, n_u)."""
        omega = np.atleast_1d(np.asarray(omega, dtype=float))
        return np.stack([np.stack([model.frequency_response(omega) for model in row], axis=-1) for row in self.models], axis=-2)

    def simulate(self, record: Record) -> dict[str, FloatArray]:
        """Noise-free outputs by name, shape (n,), for the inputs of `record` from rest."""
        simulated = {}
        for row in self.models:
            level = np.full(record.n, row[0].offset)
            simulated[row[0].output_name] = sum((model.simulate(record[model.input_name]) - model.offset for model in row), level)
        return simulated

    def sample(self, n: int, seed: int | np.random.Generator) -> FloatArray:
        """Impulse responses of `n` random models, shape (n, n_y, n_u, m); responses to different inputs are drawn jointly."""
        rng, order = np.random.default_rng(seed), self.models[0][0].order
        drawn = []
        for row, covariance in zip(self.models, self.covariances, strict=True):
            mean = np.concatenate([model.impulse_response for model in row])
            eigenvalues, vectors = np.linalg.eigh(covariance)
            deviation = rng.standard_normal((n, len(mean))) @ (vectors * np.sqrt(np.maximum(eigenvalues, 0.0))).T
            drawn.append((mean + deviation).reshape(n, len(row), order))
        return np.stack(drawn, axis=1)


def identify_multivariable(
    records: Record | Sequence[Record],
    inputs: Sequence[str],
    outputs: Sequence[str],
    *,
    kernel: str = "tc",
    order: int = 100,
    delay: int = 1,
    noise_variance: NoiseVariance = "marginal",
    offset: bool = True,
) -> MultivariableModel:
    """Identify the impulse responses from every input to every output.

    Each output is a regression on the lags of all inputs with the block-diagonal prior diag(λ_1 K(η_1), …, λ_nu K(η_nu)): every
    path has hyper-parameters of its own, all found together by the marginal likelihood. Outputs are independent given
    the inputs (their noises may be correlated; that is not used). Parameters and refusals as in
    `identify_impulse_response`.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> a, b = rng.standard_normal((2, 500))
    >>> y = np.convolve(a, [0, 1.0, 0.5])[:500] - np.convolve(b, [0, 0.3, 0.3])[:500] + 0.05 * rng.standard_normal(500)
    >>> record = Record({"a": a, "b": b, "y": y}, {"a": "V", "b": "K", "y": "mm"}, 1.0)
    >>> model = identify_multivariable(record, ["a", "b"], ["y"], order=10)
    >>> [m.impulse_response[:2].round(1).tolist() for m in model.models[0]]
    [[1.0, 0.5], [-0.3, -0.3]]
    """
    check_settings(kernel, order, delay, noise_variance)
    if not inputs or not outputs:
        raise BadInput("multivariable identification: needs at least one input and one output")
    rows, covariances = [], []
    for output in outputs:
        started = time.perf_counter()
        data = lagged_data(records, inputs, output, order, delay, offset=offset)
        fit = fit_impulse_response(data.sums, kernel, len(inputs), noise_variance)
        covariances.append(fit.covariance)
        paths = []
        for j, name in enumerate(inputs):
            block = slice(j * order, (j + 1) * order)
            paths.append(
                IdentifiedModel(
                    method=f"kernel-{kernel}",
                    sample_time=data.sample_time,
                    impulse_response=fit.mean[block],
                    covariance=fit.covariance[block, block],
                    noise_variance=fit.noise_variance,
                    input_name=name,
                    input_unit=data.input_units[j],
                    output_name=output,
                    output_unit=data.output_unit,
                    delay=delay,
                    offset=data.offset(fit.mean),
                    hyper_parameters=fit.hyper_parameters[j],
                    negative_log_likelihood=fit.negative_log_likelihood,
                    warnings=fit.warnings,
                    provenance=provenance(data, noise_variance, started),
                    bands=None if fit.bands is None else PointwiseBands(fit.bands, block),
                )
            )
        rows.append(tuple(paths))
    return MultivariableModel(tuple(rows), tuple(covariances))
