"""The unit in which errors are measured: power where an error stands out of its noise, nats of that
noise where it does not.

A whitened likelihood misleads on inexact machines: it believes that what is left is noise. Raw
power is deaf in noise. What the error looks like says which unit is right: one that stands far
above what its own past cannot predict, or is larger here than there, is no noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise, zip_longest
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from residuum.array_types import FloatArray
from residuum.identification.physics import noise_floor
from residuum.identification.residual_analysis.policy import NORMAL_MEDIAN
from residuum.identification.unseen_blocks.policy import CLIPPED, WEAKEST, WHITENING

if TYPE_CHECKING:
    from residuum.identification.unseen_blocks.data import Data, Horizon


@dataclass(frozen=True, eq=False)
class Scale:
    """Weights (outputs,) of errors, their whitening `filters`, and what counts as how much.

    `clip` (outputs,) is the largest weighted error that counts. In power `unit` (measured outputs,)
    is the first model's and `floor` the part of the cost that is noise; in `nats` a parameter costs
    `price`. `variance` is that of a weighted error which the model leaves, beside which priors
    count.
    """

    weights: FloatArray
    clip: FloatArray
    filters: tuple[FloatArray, ...] | None = None
    nats: bool = False
    unit: FloatArray | None = None
    floor: float = 0.0
    price: float = 0.0
    variance: float = 1.0

    def whitened(self, values: FloatArray, starts: Sequence[int]) -> FloatArray:
        """Weighted values (rows, outputs, …) of windows through the outputs' filters."""
        if self.filters is None:
            return values
        # imported late: it slows the start of every command, and searches in power need none of it
        from scipy.signal import lfilter  # noqa: PLC0415

        out = np.empty_like(values)
        # each window begins anew: the sample before its first one belongs to another window
        for begin, end in pairwise(starts):
            for o, a in enumerate(self.filters):
                out[begin:end, o] = lfilter(a, [1.0], values[begin:end, o], axis=0)
        return out

    def is_like(self, other: Scale, most: float) -> bool:
        """Whether weights, and coefficients of the filters, differ by no more than `most`."""
        known = self.weights > 0.0
        change = self.weights[known] / np.maximum(other.weights[known], 1e-300) - 1.0
        pairs = zip_longest(self.filters or (), other.filters or (), fillvalue=np.ones(1))
        apart = [abs(a - b) for one, two in pairs for a, b in zip_longest(one, two, fillvalue=0.0)]
        return float(np.abs(change).max(initial=0.0)) <= most and max(apart, default=0.0) <= most

    def cost(self, power: FloatArray, parameters: float) -> float:
        """Of power (blocks, measured outputs): nats with the parameters' price, or power in units
        of the first model's.
        """
        if self.nats:
            return float(0.5 * power.sum() + self.price * parameters)
        unit = 1.0 if self.unit is None else self.unit
        return float((power / unit).sum() / power.shape[1])

    def error(self, rms: FloatArray) -> float:
        """Of errors (outputs,) in the outputs' units, NaN where nothing was measured: their root
        mean square in the weights and the unit of the scale; infinite where nothing was.
        """
        unit = 1.0 if self.unit is None else self.unit
        power = (rms * self.weights)[self.weights > 0.0] ** 2 / unit
        known = power[~np.isnan(power)]
        return float(np.sqrt(known.mean())) if known.size else np.inf

    def by_block(self, power: FloatArray) -> FloatArray:
        """Cost of each block without prices, shape (blocks,)."""
        if self.nats:
            return np.asarray(0.5 * power.sum(axis=1))
        unit = 1.0 if self.unit is None else self.unit
        return np.asarray((power / unit).sum(axis=1) / power.shape[1])


def plain(data: Data) -> Scale:
    """Errors in units of the outputs' spread."""
    # an output that was not measured weighs nothing; nothing is clipped before a model was fitted,
    # for what stands out of its errors is not known yet
    weights = np.where(data.measured, 1.0 / data.spread, 0.0)
    return Scale(weights, np.full(len(weights), np.inf))


def clipped(scale: Scale, residuals: Sequence[FloatArray], horizon: Horizon) -> Scale:
    """The scale in which errors that stand out of these residuals count as no more than the
    limit.
    """
    errors = scale.whitened(np.concatenate(residuals) * scale.weights, horizon.starts.tolist())
    measured = scale.weights > 0.0
    spread = np.full(len(scale.weights), np.inf)
    # median absolute deviation: the events that are to be clipped must not widen the limit
    middle = np.nanmedian(errors[:, measured], axis=0)
    spread[measured] = np.nanmedian(np.abs(errors[:, measured] - middle), axis=0) / NORMAL_MEDIAN
    variance = float(np.mean(spread[measured] ** 2))
    # an output that is met exactly has no spread, and a limit of zero would count no error at all
    clip = np.where(measured, np.maximum(CLIPPED * spread, 1e-9), np.inf)
    return replace(scale, clip=clip, variance=variance)


def of_power(scale: Scale, data: Data, power: FloatArray) -> Scale:
    """Power in units of the first model's, which is `power` (blocks, measured outputs)."""
    total = power.sum(axis=0)
    # in units of its own error an output that is followed well would rule; in units of its spread
    # it would have no vote
    unit = np.maximum(np.maximum(total, WEAKEST * total.max()), 1e-300)
    Y = np.concatenate([e.Y for e in data.experiments])[:, data.measured]
    noise_rms = np.nan_to_num(noise_floor(Y)) * scale.weights[data.measured]
    noise_power = noise_rms**2 * np.isfinite(Y).sum(axis=0)
    # a floor that leaves nothing above itself would make every share a ratio of nothings
    return replace(scale, unit=unit, floor=float(np.minimum(noise_power / unit, 0.98).mean()))


def of_noise(
    residuals: Sequence[FloatArray], horizon: Horizon, measured: npt.NDArray[np.bool_]
) -> Scale:
    """Nats of noise that looks like the quieter half of these residuals' blocks: an effect may show
    in the others alone.

    A parameter's price is that of Schwarz's criterion, half the logarithm of the samples.
    """
    # imported late: it slows the start of every command, and searches in power need none of it
    from scipy.signal import lfilter  # noqa: PLC0415

    part_blocks = np.split(horizon.block, horizon.starts[1:-1])
    weights, filters = np.zeros(len(measured)), []
    for o, is_measured in enumerate(measured):
        filters.append(np.ones(1))
        if not is_measured:
            continue
        pieces = [
            residual[blocks == k, o]
            for residual, blocks in zip(residuals, part_blocks, strict=True)
            for k in np.unique(blocks)
        ]
        filters[o] = _whitening(pieces)
        white = [lfilter(filters[o], [1.0], np.nan_to_num(r[:, o])) for r in residuals]
        # over the median, so that outliers and the louder blocks do not set the noise
        middle = float(np.median(np.abs(np.concatenate(white))))
        weights[o] = NORMAL_MEDIAN / max(middle, 1e-300)
    samples = sum(int(np.isfinite(r).sum()) for r in residuals)
    return Scale(
        weights,
        np.full(len(measured), np.inf),
        tuple(filters),
        nats=True,
        price=0.5 * float(np.log(samples)),
    )


def _whitening(pieces: Sequence[FloatArray]) -> FloatArray:
    """Autoregression (1, a₁, …) of the quieter half of the pieces (Yule and Walker), its order by
    Akaike's criterion: n log(1 − φᵀρ) + 2 p is least.
    """
    # imported late, like the filter: most searches stay in power
    from scipy.linalg import solve_toeplitz  # noqa: PLC0415

    known = sorted(
        (np.nan_to_num(p) for p in pieces if np.isfinite(p).any()),
        key=lambda p: float(np.mean(p**2)),
    )
    quiet = known[: -(-len(known) // 2)]
    n = sum(map(len, quiet))
    total = np.zeros(WHITENING + 1)
    # autocorrelations by the power spectrum, padded so that the ends do not meet
    for piece in quiet:
        spectrum = np.abs(np.fft.rfft(piece, 2 * max(len(piece), WHITENING + 1))) ** 2
        total += np.fft.irfft(spectrum)[: WHITENING + 1]
    rho = total / max(float(total[0]), 1e-300)
    best, whitener = np.inf, np.ones(1)
    for order in range(WHITENING + 1):
        column = rho[:order].copy()
        column[:1] += 1e-9  # a pure sine leaves the Toeplitz matrix singular
        phi = solve_toeplitz(column, rho[1 : order + 1]) if order else np.zeros(0)
        left = max(float(1.0 - phi @ rho[1 : order + 1]), 1e-12)
        criterion = n * np.log(left) + 2 * order
        if criterion < best:
            best, whitener = criterion, np.concatenate([[1.0], -phi])
    return whitener


def innovations(signal: FloatArray) -> FloatArray:
    """What its own past does not predict of a signal."""
    from scipy.signal import lfilter  # noqa: PLC0415

    return np.asarray(lfilter(_whitening([signal]), [1.0], signal))
