"""Several inputs, several outputs: kernel identification with a block prior, one posterior for each
output.
"""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from residuum.array_types import ComplexArray, FloatArray
from residuum.identification.errors import BadInput, BadModel
from residuum.identification.kernel_based.impulse_response import (
    NoiseVariance,
    check_settings,
    fit_impulse_response,
    provenance,
    uncovered,
)
from residuum.identification.kernel_based.lagged_data import lagged_data
from residuum.identification.kernel_based.marginal_bands import PointwiseBands
from residuum.identification.kernel_based.outlasting import Longer, longer_response
from residuum.identification.linear_models.identified_model import IdentifiedModel
from residuum.identification.linear_models.identified_model_file import (
    identified_from,
    identified_object,
    read_json,
)
from residuum.identification.record import Record


@dataclass(frozen=True, eq=False)
class MultivariableModel:
    """A grid of identified models, and for each output the joint covariance of its responses to all
    inputs.

    Attributes
    ----------
    models : tuple of tuple of IdentifiedModel
        `models[i][j]` leads from input j to output i; each is a model of its own with its marginal
        covariance.
    covariances : tuple of array, shape (n_u·m, n_u·m)
        For every output, over the stacked impulse responses [g_1 … g_nu].
    longer : tuple of Longer or None
        For every output the stacked longer responses, where those of the models cut something off;
        random models that bounds on the error are made from come from them.
    """

    models: tuple[tuple[IdentifiedModel, ...], ...]
    covariances: tuple[FloatArray, ...]
    longer: tuple[Longer | None, ...] = ()

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
        return np.stack(
            [
                np.stack([model.frequency_response(omega) for model in row], axis=-1)
                for row in self.models
            ],
            axis=-2,
        )

    def simulate(self, record: Record) -> dict[str, FloatArray]:
        """Noise-free outputs by name, shape (n,), for the inputs of `record` from rest."""
        simulated = {}
        for row in self.models:
            # Each path carries the level of its output, which counts once.
            level = np.full(record.n, row[0].offset)
            simulated[row[0].output_name] = sum(
                (model.simulate(record[model.input_name]) - model.offset for model in row), level
            )
        return simulated

    def sample(self, n: int, seed: int | np.random.Generator) -> FloatArray:
        """Impulse responses of `n` random models, shape (n, n_y, n_u, m); responses to different
        inputs are drawn jointly.
        """
        rng = np.random.default_rng(seed)
        return np.stack(
            [_drawn(n, *self._posterior(i), rng, len(row)) for i, row in enumerate(self.models)],
            axis=1,
        )

    def sample_longer(self, n: int, seed: int | np.random.Generator) -> FloatArray:
        """The same as long as the data can tell, shape (n, n_y, n_u, M); zeros behind those that
        have decayed earlier.
        """
        rng, drawn = np.random.default_rng(seed), []
        for i, row in enumerate(self.models):
            longer = self.longer[i] if self.longer else None
            mean, covariance = (
                self._posterior(i) if longer is None else (longer.mean, longer.covariance)
            )
            drawn.append(_drawn(n, mean, covariance, rng, len(row)))
        M = max(draw.shape[2] for draw in drawn)
        return np.stack(
            [np.pad(draw, ((0, 0), (0, 0), (0, M - draw.shape[2]))) for draw in drawn], axis=1
        )

    def _posterior(self, i: int) -> tuple[FloatArray, FloatArray]:
        return (
            np.concatenate([model.impulse_response for model in self.models[i]]),
            self.covariances[i],
        )


def _drawn(
    n: int, mean: FloatArray, covariance: FloatArray, rng: np.random.Generator, n_inputs: int
) -> FloatArray:
    """`n` stacked responses, shape (n, n_inputs, length)."""
    # a root by eigenvalues, for a covariance that is singular but for rounding
    eigenvalues, vectors = np.linalg.eigh(covariance)
    deviation = (
        rng.standard_normal((n, len(mean))) @ (vectors * np.sqrt(np.maximum(eigenvalues, 0.0))).T
    )
    return np.asarray((mean + deviation).reshape(n, n_inputs, -1))


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
    cover_cut: bool = True,
) -> MultivariableModel:
    """Identify the impulse responses from every input to every output.

    Each output is a regression on the lags of all inputs with the block-diagonal prior diag(λ_1
    K(η_1), …, λ_nu K(η_nu)): every path has hyper-parameters of its own, all found together by the
    marginal likelihood. Outputs are independent given the inputs (their noises may be correlated;
    that is not used). Parameters and refusals as in `identify_impulse_response`; `cover_cut` makes
    the `longer` responses of an output together, for its paths trade off.

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
    rows, covariances, longest = [], [], []
    for output in outputs:
        started = time.perf_counter()
        data = lagged_data(records, inputs, output, order, delay, offset=offset)
        fit = fit_impulse_response(data.sums, kernel, len(inputs), noise_variance)
        covariances.append(fit.covariance)
        longer = None
        if cover_cut:
            # As a default, for a closure would see the output of the loop's last turn.
            def refit(length: int, output: str = output) -> tuple[FloatArray, FloatArray]:
                sums = lagged_data(records, inputs, output, length, delay, offset=offset).sums
                again = fit_impulse_response(sums, kernel, len(inputs), noise_variance)
                return again.mean, again.covariance

            longer = longer_response(
                (fit.mean, fit.covariance), order, data.sums.rows, refit, len(inputs)
            )
        longest.append(longer)
        paths = []
        for j, name in enumerate(inputs):
            block = slice(j * order, (j + 1) * order)
            # of a path its part of the stacked longer responses
            M = 0 if longer is None else len(longer.mean) // len(inputs)
            long = slice(j * M, (j + 1) * M)
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
                    warnings=(*fit.warnings, *uncovered(longer, delay, len(inputs))),
                    longer_response=None if longer is None else longer.mean[long],
                    longer_covariance=None if longer is None else longer.covariance[long, long],
                    provenance=provenance(data, noise_variance, started),
                    bands=None if fit.bands is None else PointwiseBands(fit.bands, block),
                )
            )
        rows.append(tuple(paths))
    return MultivariableModel(tuple(rows), tuple(covariances), tuple(longest))


# The JSON file of a model with several inputs or outputs: its paths as identified models, and
# each output's joint covariance.

FORMAT, VERSION = "residuum-multivariable-model", 1


def multivariable_text(model: MultivariableModel) -> str:
    """The file's text; `read_multivariable` reads it back to the same numbers."""
    content = {
        "format": FORMAT,
        "version": VERSION,
        "models": [[identified_object(path) for path in row] for row in model.models],
        "covariances": [covariance.tolist() for covariance in model.covariances],
        "longer": [_longer_object(response) for response in model.longer],
    }
    return json.dumps(content)


def is_multivariable(path: str | Path) -> bool:
    """Whether a file calls itself a multivariable model; False for what cannot be read at all."""
    try:
        content = json.loads(Path(path).read_text(encoding="utf-8"))
    # JSON may be nested deeper than Python recurses.
    except (OSError, UnicodeDecodeError, json.JSONDecodeError, RecursionError):
        return False
    return isinstance(content, dict) and content.get("format") == FORMAT


def load_multivariable(path: str | Path) -> MultivariableModel:
    """Read the file of a MultivariableModel.

    Raises BadModel, naming the file and the rule, when it is not one, or a path or a covariance
    does not fit.
    """
    path = Path(path)
    content = read_json(path)
    if (
        not isinstance(content, dict)
        or content.get("format") != FORMAT
        or content.get("version") != VERSION
    ):
        raise BadModel(
            f"{path}: is not the file of a multivariable model ('format' must be {FORMAT!r},"
            f" 'version' {VERSION})"
        )
    try:
        return multivariable_from(content, path)
    except (KeyError, TypeError, ValueError) as error:
        raise BadModel(f"{path}: {error}") from None


def multivariable_from(content: dict[str, Any], path: Path) -> MultivariableModel:
    """The model of a file's content; `path` names the file in what is refused."""
    models = tuple(
        tuple(identified_from(encoded, path) for encoded in row) for row in content["models"]
    )
    covariances = tuple(np.asarray(encoded, dtype=float) for encoded in content["covariances"])
    _check_grid(models, covariances, path)
    # files of older versions have none
    longer = tuple(_longer_from(encoded, path) for encoded in content.get("longer", []))
    _check_longer(models, longer, path)
    return MultivariableModel(models, covariances, longer)


def _check_grid(
    models: Sequence[Sequence[IdentifiedModel]], covariances: Sequence[FloatArray], path: Path
) -> None:
    if not models or len({len(row) for row in models}) != 1 or len(covariances) != len(models):
        raise BadModel(f"{path}: models must be a full grid, with one covariance an output")
    for row, covariance in zip(models, covariances, strict=True):
        size = sum(model.order for model in row)
        if covariance.shape != (size, size):
            raise BadModel(
                f"{path}: covariance of {row[0].output_name!r} has shape {covariance.shape}; must"
                f" be ({size}, {size})"
            )


def _check_longer(
    models: Sequence[Sequence[IdentifiedModel]], longer: Sequence[Longer | None], path: Path
) -> None:
    if not longer:
        return
    if len(longer) != len(models):
        raise BadModel(f"{path}: longer must have an entry an output")
    for row, response in zip(models, longer, strict=True):
        if response is None:
            continue
        size = len(response.mean)
        if size % len(row) or response.covariance.shape != (size, size):
            raise BadModel(
                f"{path}: longer responses of {row[0].output_name!r} do not fit {len(row)} inputs"
                " and their covariance"
            )


def _longer_object(longer: Longer | None) -> dict[str, Any] | None:
    if longer is None:
        return None
    return {
        "mean": longer.mean.tolist(),
        "covariance": longer.covariance.tolist(),
        "negligible": longer.negligible,
    }


def _longer_from(content: dict[str, Any] | None, path: Path) -> Longer | None:
    if content is None:
        return None
    mean, covariance = (np.asarray(content[name], dtype=float) for name in ("mean", "covariance"))
    if mean.ndim != 1 or not (np.isfinite(mean).all() and np.isfinite(covariance).all()):
        raise BadModel(f"{path}: longer responses must be finite numbers")
    return Longer(mean, covariance, bool(content["negligible"]))
