"""The post-filter that makes the residual of an identified multivariable model blind to inputs that are not measured."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from scipy import linalg

from residuum.diagnosis.residuals.generators.unknown_input_observer import unknown_input_observer
from residuum.diagnosis.systems.balanced_truncation import balanced_truncation
from residuum.diagnosis.systems.system_norms import h_infinity_norm
from residuum.identification.errors import BadModel
from residuum.identification.kernel_based.multivariable import MultivariableModel
from residuum.identification.linear_models.state_space import StateSpace

FloatArray = npt.NDArray[np.float64]
_NEGLIGIBLE = 1e-3  # of the paths' gain
_CERTAIN = 4.0
"""Standard deviations by which a first coefficient must differ from zero to be taken for the path's first."""


def unknown_input_decoupling(model: MultivariableModel, unknown: Sequence[str]) -> StateSpace:
    """Q with Q G_d = 0, G_d the paths from the unknown inputs to all outputs: p inputs, p − (number of unknown) outputs.

    Q is the unknown input observer's path from y to its residual, taken in the directions that d does not reach in one step.
    Samples by which all paths are late say nothing of Q, since Q z⁻ᵏ G_d = 0 is the same condition; they are left out, and the
    lags before the first coefficient that is surely not zero count as such. What the model's own error leaves of d in the
    residual is not known beforehand: healthy records in which d moves teach it as noise.

    Raises
    ------
    BadModel
        As many unknown inputs as outputs, paths that cannot be told apart, or an unstable zero common to all of them.
    """
    columns = [model.inputs.index(name) for name in unknown]
    if len(columns) >= len(model.models):
        raise BadModel(
            f"unknown input observer: {len(columns)} unknown inputs use up all {len(model.models)} outputs; no residual is left"
        )
    paths = [[row[j] for j in columns] for row in model.models]
    late = [min(_first(row[k].impulse_response, row[k].std) for row in paths) for k in range(len(columns))]
    system = _realised(
        [[path.impulse_response[late[k] :] for k, path in enumerate(row)] for row in paths], paths[0][0].sample_time
    )
    small = balanced_truncation(system, _NEGLIGIBLE * h_infinity_norm(system)[0]).system
    observer = unknown_input_observer(
        StateSpace(small.A, np.zeros((small.order, 0)), small.C, np.zeros((len(paths), 0)), small.sample_time), small.B
    )
    free = linalg.null_space((small.C @ small.B).T).T
    made = observer.filter
    return StateSpace(made.A, made.B, free @ made.C, free @ made.D, made.sample_time)


def _first(g: FloatArray, std: FloatArray) -> int:
    sure = np.flatnonzero(np.abs(g) > _CERTAIN * std)
    return int(sure[0]) if len(sure) else 0


def _realised(taps: Sequence[Sequence[FloatArray]], sample_time: float) -> StateSpace:
    """Impulse responses from lag 1 on, rows outputs, columns inputs, as a chain of delays an input."""
    lengths = [max(len(row[k]) for row in taps) for k in range(len(taps[0]))]
    C = [np.concatenate([np.r_[g, np.zeros(lengths[k] - len(g))] for k, g in enumerate(row)]) for row in taps]
    A = linalg.block_diag(*[np.eye(length, k=-1) for length in lengths])
    B = linalg.block_diag(*[np.eye(length, 1) for length in lengths])
    return StateSpace(A, B, np.array(C), np.zeros((len(taps), len(lengths))), sample_time)
