"""Structured residual set: residuals of several outputs, each blind to known disturbances and to some of the faults."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from residuum.diagnosis.systems import balanced_truncation, co_outer_factor, h_infinity_norm
from residuum.identification.errors import BadModel
from residuum.identification.linear_models.state_space import FloatArray, StateSpace
from residuum.identification.linear_models.transfer_function import TransferFunction

Column = Sequence[TransferFunction]  # from one signal to every output
_DECOUPLED = 1e-7
_SEEN = 1e-3


@dataclass(frozen=True, eq=False)
class StructuredResidual:
    """One scalar residual r = V y − V G_u u of the set.

    `filter` has the inputs [y; u]. `sees` holds the largest gain from each fault; `blind_to` the faults it was made blind to.
    `leak` is the largest gain left from the disturbances and these faults, relative to ‖V‖_∞, computed anew on a grid.
    """

    filter: StateSpace
    sees: Mapping[str, float]
    blind_to: tuple[str, ...]
    leak: float


def structured_residuals(
    inputs: Sequence[Column],
    disturbances: Sequence[Column],
    faults: Mapping[str, Column],
    noise: Sequence[float],
    *,
    gamma: float = 1.0,
    isolate: int = 1,
) -> list[StructuredResidual]:
    """The bank for isolation: every residual decouples all disturbances and one set of `isolate` faults exactly.

    For columns G to be decoupled the left annihilator V (V G = 0) is formed from the signed minors of any
    (number of columns + 1) outputs, brought over a stable common denominator; then V is divided by the co-outer factor
    of V diag(noise), so that the noise reaches the residual with gain γ at every frequency (AFDP with known disturbances).
    A fault is isolated by the pattern of the residuals it moves. Plants with unstable paths are refused here.

    Parameters
    ----------
    inputs, disturbances : sequences of columns
        Each column holds the transfer functions from that signal to each of the p outputs.
    faults : mapping of name to column
    noise : p numbers
        Standard deviation of the measurement noise of each output.
    isolate : int
        Faults each residual is blind to; 0 gives detection only.

    Raises
    ------
    BadModel
        Too few outputs: p must exceed the number of disturbances plus `isolate`. Unstable or continuous-time paths.
    """
    p = len(noise)
    _check(p, [*inputs, *disturbances, *faults.values()])
    if p <= len(disturbances) + isolate:
        raise BadModel(
            f"structured residuals: {p} outputs cannot decouple {len(disturbances)} disturbances and {isolate} faults; "
            f"{len(disturbances) + isolate + 1} outputs are needed"
        )
    found = []
    for blind in combinations(faults, isolate):
        columns = [*disturbances, *(faults[name] for name in blind)]
        for rows in combinations(range(p), len(columns) + 1):
            row = _annihilator(columns, rows, p)
            found.append(_residual(row, inputs, columns, faults, blind, noise, gamma))
    return found


def _check(p: int, columns: Sequence[Column]) -> None:
    for column in columns:
        if len(column) != p:
            raise BadModel(
                f"structured residuals: a column has {len(column)} entries for {p} outputs; one each is needed"
            )
        if any(
            entry.sample_time is None or not entry.is_stable or not entry.is_proper
            for entry in column
        ):
            raise BadModel(
                "structured residuals: every path must be discrete-time, proper and stable"
            )


def _annihilator(columns: Sequence[Column], rows: Sequence[int], p: int) -> list[TransferFunction]:
    """Row V, p entries, with V G = 0: cofactors of the chosen rows over z^k, so it is FIR, stable and proper."""
    Ts = _sample_time(columns)
    if not columns:
        return [TransferFunction(np.array([float(k == rows[0])]), np.ones(1), Ts) for k in range(p)]
    # A column may be multiplied by its common denominator: that changes no left annihilator and leaves polynomials.
    numerators = [_over_common_denominator([column[k] for k in rows]) for column in columns]
    minors = [
        _determinant([[column[i] for i in range(len(rows)) if i != left] for column in numerators])
        for left in range(len(rows))
    ]
    degree = max(len(minor) for minor in minors)
    scale = max(float(np.abs(minor).max()) for minor in minors)
    if scale == 0.0:
        raise BadModel(
            f"structured residuals: outputs {tuple(rows)} see the signals to be decoupled in one direction only"
        )
    row = [TransferFunction(np.zeros(1), np.ones(1), Ts)] * p
    delay = np.eye(1, degree)[0]
    for sign, (k, minor) in enumerate(zip(rows, minors, strict=True)):
        row[k] = TransferFunction((-1.0) ** sign * minor / scale, delay, Ts)
    return row


def _sample_time(columns: Sequence[Column]) -> float:
    return next(
        (entry.sample_time for column in columns for entry in column if entry.sample_time), 1.0
    )


def _over_common_denominator(entries: Sequence[TransferFunction]) -> list[FloatArray]:
    """Numerators over the product of the different denominators."""
    different: list[FloatArray] = []
    for entry in entries:
        if not any(entry.den.shape == d.shape and np.allclose(entry.den, d) for d in different):
            different.append(entry.den)
    result = []
    for entry in entries:
        numerator = entry.num
        for d in different:
            if not (entry.den.shape == d.shape and np.allclose(entry.den, d)):
                numerator = np.convolve(numerator, d)
        result.append(numerator)
    return result


def _determinant(matrix: list[list[FloatArray]]) -> FloatArray:
    """Determinant of a square matrix of polynomials, by expansion along the first row."""
    if len(matrix) == 1:
        return matrix[0][0]
    total: FloatArray = np.zeros(1)
    for k, entry in enumerate(matrix[0]):
        minor = _determinant([[row[j] for j in range(len(row)) if j != k] for row in matrix[1:]])
        total = np.polyadd(total, (-1.0) ** k * np.convolve(entry, minor)).astype(float)
    return total


def _residual(
    row: list[TransferFunction],
    inputs: Sequence[Column],
    columns: Sequence[Column],
    faults: Mapping[str, Column],
    blind: tuple[str, ...],
    noise: Sequence[float],
    gamma: float,
) -> StructuredResidual:
    Ts = row[0].sample_time or _sample_time([*inputs, *columns])
    V = _row_system([TransferFunction(entry.num, entry.den, Ts) for entry in row])
    weighted = V @ StateSpace.gain(np.diag(noise), Ts)
    size = h_infinity_norm(weighted)[0]
    Q = co_outer_factor(balanced_truncation(weighted, 1e-10 * size).system).inverse() * gamma
    full = balanced_truncation(Q @ V, 1e-8 * h_infinity_norm(Q @ V)[0]).system
    through = full
    for column in inputs:
        through = through.beside((full @ _column_system(column)) * -1.0)
    through = balanced_truncation(through, 1e-9 * h_infinity_norm(through)[0]).system
    omega = np.linspace(1e-3, np.pi / Ts, 400)
    response, size = full.frequency_response(omega)[:, 0], h_infinity_norm(full)[0]

    def gain(column: Column) -> float:
        path = np.stack([entry.frequency_response(omega) for entry in column], axis=1)
        return float(np.abs(np.sum(response * path, axis=1)).max())

    leak = max((gain(column) for column in columns), default=0.0) / size
    if leak > _DECOUPLED:
        raise BadModel(
            f"structured residuals: a gain of {leak:.1g} is left from what should be decoupled; the paths are ill-conditioned"
        )
    sees = {name: gain(column) for name, column in faults.items()}
    return StructuredResidual(
        through,
        {name: value if value > _SEEN * size else 0.0 for name, value in sees.items()},
        blind,
        leak,
    )


def _row_system(row: Sequence[TransferFunction]) -> StateSpace:
    system = StateSpace.from_transfer_function(row[0])
    for entry in row[1:]:
        system = system.beside(StateSpace.from_transfer_function(entry))
    return system


def _column_system(column: Column) -> StateSpace:
    parts = [StateSpace.from_transfer_function(entry) for entry in column]
    A = np.zeros((0, 0))
    for part in parts:
        A = np.block(
            [[A, np.zeros((len(A), part.order))], [np.zeros((part.order, len(A))), part.A]]
        )
    B = np.vstack([part.B for part in parts])
    C = np.zeros((len(parts), len(A)))
    start = 0
    for k, part in enumerate(parts):
        C[k, start : start + part.order] = part.C
        start += part.order
    return StateSpace(A, B, C, np.vstack([part.D for part in parts]), parts[0].sample_time)
