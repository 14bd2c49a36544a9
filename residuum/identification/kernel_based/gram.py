"""Sums of a lagged regression, y(t) = Σ_j Σ_i g_ji u_j(t − delay − i): all that a Gaussian
likelihood needs of the data.

The Gram matrix of lagged signals is Toeplitz up to its edges: the first row and column are
correlations (blocks of FFTs, memory independent of n), every other entry follows along its diagonal
by one product that enters and one that leaves. Rows with a missing sample are left out, so gaps cut
a record into runs, and runs, records and streamed blocks simply add up; no row spans a seam.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import fft

from residuum.array_types import FloatArray
from residuum.identification.errors import BadRecord, NotIdentifiable

# both bound the memory, whatever the length of the record
_BLOCKS_AT_ONCE = 64  # of one transform each
_ROWS_AT_ONCE = 1 << 18


@dataclass(frozen=True, eq=False)
class RegressionSums:
    """ΦᵀΦ, Φᵀy, yᵀy, Φᵀ1, 1ᵀy over `rows` complete rows; columns are ordered input by input, lag by
    lag.

    `fitted_offsets` counts the constants that `centred` has already removed (each takes one degree
    of freedom).
    """

    gram: FloatArray
    cross: FloatArray
    energy: float
    rows: int
    regressor_sum: FloatArray
    output_sum: float
    fitted_offsets: int = 0

    @classmethod
    def zero(cls, columns: int) -> RegressionSums:
        """The sums over no row."""
        return cls(np.zeros((columns, columns)), np.zeros(columns), 0.0, 0, np.zeros(columns), 0.0)

    @property
    def degrees_of_freedom(self) -> int:
        """Rows less the constants already removed."""
        return self.rows - self.fitted_offsets

    def __add__(self, other: RegressionSums) -> RegressionSums:
        return RegressionSums(
            self.gram + other.gram,
            self.cross + other.cross,
            self.energy + other.energy,
            self.rows + other.rows,
            self.regressor_sum + other.regressor_sum,
            self.output_sum + other.output_sum,
            self.fitted_offsets + other.fitted_offsets,
        )

    def centred(self) -> RegressionSums:
        """The sums after an unknown constant was eliminated from these rows (regression on
        deviations from the mean).
        """
        if self.rows == 0:
            return self
        mean = self.regressor_sum / self.rows
        return RegressionSums(
            self.gram - np.outer(self.regressor_sum, mean),
            self.cross - mean * self.output_sum,
            self.energy - self.output_sum**2 / self.rows,
            self.rows,
            self.regressor_sum,
            self.output_sum,
            self.fitted_offsets + 1,
        )

    def columns(self, chosen: npt.NDArray[np.intp]) -> RegressionSums:
        """The same rows with some of the columns."""
        return RegressionSums(
            self.gram[np.ix_(chosen, chosen)],
            self.cross[chosen],
            self.energy,
            self.rows,
            self.regressor_sum[chosen],
            self.output_sum,
            self.fitted_offsets,
        )


def regression_sums(
    inputs: Sequence[npt.ArrayLike],
    output: npt.ArrayLike,
    order: int,
    delay: int = 1,
    *,
    orders: Sequence[int] | None = None,
    input_levels: Sequence[float] | None = None,
    output_level: float = 0.0,
) -> RegressionSums:
    """Sums over the complete rows of one record, shape (sum(orders), …).

    Parameters
    ----------
    inputs : sequence of arrays, shape (n,)
        NaN marks a missing sample.
    output : array, shape (n,)
    order, delay : int
        Lags delay … delay + order − 1 of every input.
    orders : sequence of int, none above `order`
        How many of these lags each input has; None: all. A row begins where the longest does.
    input_levels, output_level : float
        Subtracted from the signals first, block by block.

    Raises
    ------
    BadRecord
        Lengths differ.
    NotIdentifiable
        No row is complete.

    Examples
    --------
    >>> regression_sums([[1.0, 2.0, 3.0, 4.0]], [0.0, 0.0, 1.0, 1.0], order=2).gram.tolist()
    [[13.0, 8.0], [8.0, 5.0]]
    """
    signals = [np.asarray(signal) for signal in inputs]
    y = np.asarray(output)
    if any(signal.shape != y.shape for signal in signals):
        raise BadRecord(
            f"inputs of {[len(signal) for signal in signals]} samples and an output of {len(y)}:"
            " lengths must be equal"
        )
    reach = delay + order - 1  # samples of the past that a row needs
    levels = [0.0] * len(signals) if input_levels is None else input_levels
    lags = [order] * len(signals) if orders is None else list(orders)
    total = RegressionSums.zero(len(signals) * order)
    for start, stop in _complete_runs(signals, lags, y, order, delay):
        for k in range(start, stop, _ROWS_AT_ONCE):
            end = min(k + _ROWS_AT_ONCE, stop)
            past = [
                _stretch(signal[k - reach : end - delay], level, complete=own == order)
                for signal, level, own in zip(signals, levels, lags, strict=True)
            ]
            total = total + _run_sums(past, np.subtract(y[k:end], output_level, dtype=float), order)
    if total.rows == 0:
        raise NotIdentifiable(
            f"record of {len(y)} samples: order {order} with delay {delay} needs {reach + 1}"
            " samples in a row without a gap; record longer, or take a smaller order"
        )
    if orders is None:
        return total
    return total.columns(np.concatenate([j * order + np.arange(own) for j, own in enumerate(lags)]))


def _stretch(signal: FloatArray, level: float, *, complete: bool) -> FloatArray:
    """A signal about its level; zero where it is missing, which only beyond its own lags it may be:
    what stands there is in columns that are left out.
    """
    stretch = np.subtract(signal, level, dtype=float)
    return stretch if complete else np.nan_to_num(stretch)


def _complete_runs(
    inputs: Sequence[FloatArray], lags: Sequence[int], y: FloatArray, order: int, delay: int
) -> list[tuple[int, int]]:
    """Runs [start, stop) of output samples whose own value and whose whole past, `lags` of each
    input, are there.
    """
    n, reach = len(y), delay + order - 1
    if n <= reach:
        return []
    # a sum tells a NaN in one pass, without an array of flags
    if not any(np.isnan(signal.sum()) for signal in (*inputs, y)):
        return [(reach, n)]
    complete = ~np.isnan(y)
    complete[:reach] = False
    for signal, own in zip(inputs, lags, strict=True):
        # a window without a missing sample: the count at its end is that at its begin
        missing = np.concatenate([[0], np.cumsum(np.isnan(signal))])
        first = order - own
        complete[reach:] &= missing[order : n - delay + 1] == missing[first : first + n - reach]
    edges = np.flatnonzero(np.diff(np.concatenate([[0], complete.astype(np.int8), [0]])))
    # one edge up and one down a run
    return [(int(start), int(stop)) for start, stop in edges.reshape(-1, 2)]


def _run_sums(x: list[FloatArray], y: FloatArray, order: int) -> RegressionSums:
    """Sums of one run: y (L,), each x (L + order − 1,), row k holding x[k + order − 1 − i] for lag
    i.
    """
    gram, cross = (_direct_products if len(y) < order else _toeplitz_products)(x, y, order)
    sums = np.concatenate([_regressor_sum(signal, len(y), order) for signal in x])
    return RegressionSums(gram, cross, float(y @ y), len(y), sums, float(y.sum()))


def _regressor_sum(x: FloatArray, rows: int, order: int) -> FloatArray:
    """Σ_k x[k + order − 1 − i] for every lag i, shape (order,)."""
    entering, leaving = _edges(x, rows, order)
    return np.concatenate([[0.0], np.cumsum(entering - leaving)]) + x[order - 1 :].sum()


def _edges(x: FloatArray, rows: int, order: int) -> tuple[FloatArray, FloatArray]:
    """From one lag to the next, the sample that enters a sum over the rows and the one that leaves
    it, shapes (order − 1,).
    """
    return x[order - 2 :: -1][: order - 1], x[: rows - 1 : -1]


def _direct_products(
    x: list[FloatArray], y: FloatArray, order: int
) -> tuple[FloatArray, FloatArray]:
    """ΦᵀΦ and Φᵀy of a run shorter than the order, where the structure saves nothing."""
    Phi = np.hstack(
        [np.lib.stride_tricks.sliding_window_view(signal, order)[:, ::-1] for signal in x]
    )
    return Phi.T @ Phi, Phi.T @ y


def _toeplitz_products(
    x: list[FloatArray], y: FloatArray, order: int
) -> tuple[FloatArray, FloatArray]:
    """ΦᵀΦ and Φᵀy from the correlations and the two edges of the run."""
    products = _lagged_products([*(signal[order - 1 :] for signal in x), y], x, order)
    gram = np.empty((len(x) * order, len(x) * order))
    for j, first in enumerate(x):
        for k, second in enumerate(x[j:], start=j):
            block = _along_diagonals(first, second, products[k, j], products[j, k], len(y))
            gram[j * order : (j + 1) * order, k * order : (k + 1) * order] = block
            gram[k * order : (k + 1) * order, j * order : (j + 1) * order] = block.T
    return gram, products[-1].ravel()


def _along_diagonals(
    first: FloatArray, second: FloatArray, column: FloatArray, row: FloatArray, rows: int
) -> FloatArray:
    """R with R_{i+1,k+1} = R_{ik} + (the product that enters) − (the product that leaves)."""
    order = len(row)
    (entering, leaving), (entering_too, leaving_too) = (
        _edges(signal, rows, order) for signal in (first, second)
    )
    R = np.empty((order, order))
    R[0], R[1:, 0] = row, column[1:]
    R[1:, 1:] = np.outer(entering, entering_too) - np.outer(leaving, leaving_too)
    for i in range(order - 1):
        R[i + 1, 1:] += R[i, :-1]
    return R


def _lagged_products(signals: list[FloatArray], x: list[FloatArray], order: int) -> FloatArray:
    """Σ_k a[k] x_j[k + order − 1 − i], shape (len(signals), len(x), order), by overlap-save over
    blocks.
    """
    rows = len(signals[0])
    # blocks eight times as long as the overlap, so that an eighth of each transform is lost to it
    size = fft.next_fast_len(min(max(1024, 8 * order), rows + order - 1), real=True)
    step = size - order + 1
    spectrum = np.zeros((len(signals), len(x), size // 2 + 1), dtype=complex)
    for start in range(0, rows, step * _BLOCKS_AT_ONCE):
        stop = min(start + step * _BLOCKS_AT_ONCE, rows)
        blocks = -(-(stop - start) // step)
        X = [
            fft.rfft(_blocks(signal[start : stop + order - 1], blocks, size, step), axis=1)
            for signal in x
        ]
        for index, a in enumerate(signals):
            A = fft.rfft(_blocks(a[start:stop], blocks, step, step), n=size, axis=1).conj()
            for j, X_j in enumerate(X):
                spectrum[index, j] += np.einsum("bf,bf->f", A, X_j)
    return np.asarray(fft.irfft(spectrum, n=size, axis=-1)[..., :order][..., ::-1])


def _blocks(signal: FloatArray, blocks: int, size: int, step: int) -> FloatArray:
    """Overlapping blocks of `size` samples, `step` apart, the last one padded with zeros, shape
    (blocks, size).
    """
    padded = np.zeros((blocks - 1) * step + size)
    padded[: len(signal)] = signal
    return np.lib.stride_tricks.sliding_window_view(padded, size)[::step]
