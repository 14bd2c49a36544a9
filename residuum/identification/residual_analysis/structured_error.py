"""Is a model's error structured, or only (coloured) noise?

A whiteness test answers another question: real noise is coloured, and a correct model then fails
it. Here the error may have any colour; it is called structured when functions of the model's own
signals predict it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from operator import itemgetter

import numpy as np
import numpy.typing as npt
from scipy.special import gammaincc

from residuum.array_types import FloatArray
from residuum.identification.errors import BadInput
from residuum.identification.residual_analysis.noise import (
    ColouredNoise,
    fit_coloured_noise,
    forgetting,
    longest_memory,
    stretches,
)
from residuum.identification.residual_analysis.policy import (
    MOST_STRUCTURE_DRAWS,
    NOISE_ORDER,
    NOISE_PASSES,
    ORDINARY_DRAW,
    RARE_DRAW,
    STRUCTURE_DRAWS,
    STRUCTURE_LEVEL,
)


@dataclass(frozen=True, eq=False)
class StructuredError:
    """Outcome of the test on one output.

    `present` at the chosen level, `p_value` under "the error is noise of some colour", `share` =
    part of the error's power that the model's signals predict, `noise_rms` = what remains (unit of
    the output), `predicted` = the structured part, one array a record, `noise` = the colour of what
    remains.
    """

    present: bool
    p_value: float
    share: float
    noise_rms: float
    predicted: tuple[FloatArray, ...]
    noise: ColouredNoise


def test_structured_error(
    residuals: Sequence[FloatArray],
    features: Sequence[FloatArray],
    *,
    level: float = STRUCTURE_LEVEL,
    n_bootstrap: int = MOST_STRUCTURE_DRAWS,
    seed: int = 0,
    drifting: bool = True,
) -> StructuredError:
    """Test whether `features` predict `residuals` beyond what coloured noise would allow.

    Likelihood ratio of two regressions, e = v and e = X c + v, v autoregressive with its own
    coefficients in each, T = N log(σ₀²/σ₁²). The null distribution is that of T on noise drawn from
    the fitted AR model (parametric bootstrap), summarised by a gamma distribution of the same two
    moments, because the χ² approximation is too light-tailed when the noise is nearly integrated;
    at most `n_bootstrap` draws, fewer where a few of them decide.

    Parameters
    ----------
    residuals : sequence of arrays, shapes (n_r,)
        Measured minus modelled output, one array a record; NaN where the measurement is missing.
    features : sequence of arrays, shapes (n_r, q)
        Functions of the model's noise-free signals (inputs, simulated states, time profiles).
    level : float
        False-alarm probability of `present`.
    drifting : bool
        Whether noise may be integrated. It then explains every slow error; otherwise it forgets
        within the data.

    Raises
    ------
    BadInput
        Fewer than 4 (q + p) samples, p the order of the noise.

    Notes
    -----
    Fails (cries wolf) when the features are made from the measured, noisy output, and when a
    disturbance is synchronous with the input. Power is lost when the structured error is itself
    smooth and broadband.

    References
    ----------
    Cochrane & Orcutt, J. Am. Stat. Assoc. 44 (1949); Efron & Tibshirani, *An Introduction to the
    Bootstrap*, ch. 16.
    """
    q = features[0].shape[1]
    segments, designs = _complete(residuals, features)
    n = sum(map(len, segments))
    if n < 4 * (q + NOISE_ORDER):
        raise BadInput(
            f"structured-error test: has {n} samples; {q} features with noise of order {NOISE_ORDER} need"
            f" {4 * (q + NOISE_ORDER)}"
        )
    designs = _orthonormal(designs)
    null = _noise(segments, NOISE_ORDER, drifting)
    statistic, coefficients, noise = _likelihood_ratio(segments, designs, null, drifting)
    predicted = [design @ coefficients for design in designs]
    total = sum(float(segment @ segment) for segment in segments)
    pairs = zip(segments, predicted, strict=True)
    left_power = sum(float(np.sum((segment - part) ** 2)) for segment, part in pairs)
    share = max(0.0, 1.0 - left_power / total) if total > 0 else 0.0
    lengths = list(map(len, segments))
    rng = np.random.default_rng(seed)
    draws, p_value = np.zeros(0), np.nan
    # a few at a time, until more of them would not change the answer
    while draws.size < n_bootstrap and not (p_value < RARE_DRAW * level or p_value > ORDINARY_DRAW):
        more = [
            _null_draw(null, lengths, designs, drifting, rng)
            for _ in range(min(STRUCTURE_DRAWS, n_bootstrap))
        ]
        draws = np.r_[draws, more]
        p_value = _tail(statistic, draws, designs[0].shape[1])
    # without what pure noise would also have given
    share *= max(statistic - float(draws.mean()), 0.0) / max(statistic, 1e-300)
    return StructuredError(
        present=bool(p_value < level),
        p_value=p_value,
        share=float(share),
        noise_rms=float(np.sqrt((1.0 - share) * total / n)),
        predicted=_spread(residuals, features, predicted),
        noise=noise,
    )


test_structured_error.__test__ = False  # type: ignore[attr-defined]  # a statistical test, not one of pytest's


def lasting_noise(residuals: Sequence[FloatArray], order: int) -> ColouredNoise:
    """The colour of residuals (NaN where missing) as noise that forgets within them."""
    return _noise(
        [r[part] for r in residuals for part in stretches(np.isfinite(r))], order, drifting=False
    )


def _noise(segments: list[FloatArray], order: int, drifting: bool) -> ColouredNoise:
    """The colour of the segments, unless it may drift with no more memory than their length can
    show.
    """
    noise = fit_coloured_noise(segments, order)
    if drifting:
        return noise
    a = forgetting(noise.a, longest_memory(sum(map(len, segments)), max(map(len, segments))))
    if a is noise.a:
        return noise
    # poles that were moved leave other innovations
    limited = ColouredNoise(a, 1.0)
    e = np.concatenate([limited.whiten(segment) for segment in segments])
    return ColouredNoise(a, float(np.mean(e**2)))


def _complete(
    residuals: Sequence[FloatArray], features: Sequence[FloatArray]
) -> tuple[list[FloatArray], list[FloatArray]]:
    """Residuals and features on the stretches where both are present."""
    segments, designs = [], []
    for residual, feature in zip(residuals, features, strict=True):
        if feature.shape[0] != residual.shape[0]:
            raise BadInput(
                f"structured-error test: {residual.shape[0]} residuals but {feature.shape[0]}"
                " feature rows"
            )
        for part in stretches(_present(residual, feature)):
            segments.append(residual[part])
            designs.append(feature[part])
    return segments, designs


def _present(residual: FloatArray, feature: FloatArray) -> npt.NDArray[np.bool_]:
    return np.isfinite(residual) & np.isfinite(feature).all(axis=1)


def _spread(
    residuals: Sequence[FloatArray], features: Sequence[FloatArray], parts: list[FloatArray]
) -> tuple[FloatArray, ...]:
    """The predicted parts back on the records' samples, NaN where nothing could be predicted."""
    remaining = iter(parts)
    spread = []
    for residual, feature in zip(residuals, features, strict=True):
        whole = np.full(residual.shape, np.nan)
        for part in stretches(_present(residual, feature)):
            whole[part] = next(remaining)
        spread.append(whole)
    return tuple(spread)


def _orthonormal(designs: list[FloatArray]) -> list[FloatArray]:
    """The same column space with well-conditioned columns (dependent ones dropped)."""
    # T is the same for every basis of the column space; a well-conditioned one keeps its digits
    stacked = np.concatenate(designs)
    scale = np.linalg.norm(stacked, axis=0)
    stacked = stacked[:, scale > 0] / scale[scale > 0]
    u, s, _ = np.linalg.svd(stacked, full_matrices=False)
    basis = u[:, s > 1e-9 * s[0]] if s.size else u
    bounds = np.cumsum([len(design) for design in designs])[:-1]
    return [np.ascontiguousarray(part) for part in np.split(basis, bounds)]


def _likelihood_ratio(
    segments: list[FloatArray], designs: list[FloatArray], null: ColouredNoise, drifting: bool
) -> tuple[float, FloatArray, ColouredNoise]:
    """(T, regression coefficients, noise of the alternative).

    The likelihood has two basins when noise and features are both slow: noise nearly integrated
    with free coefficients, or noise less coloured with small ones. Generalised least squares runs
    from both ends. Coefficients and noise that belong together are given where they are likelier
    than the null; T counts the null's own noise too.
    """
    n = sum(max(len(segment) - null.order, 0) for segment in segments)
    before = _innovation_power(segments, null)
    best = least = (before, np.zeros(designs[0].shape[1]), null)
    white = ColouredNoise(np.zeros(0), 1.0)
    for noise in (white, null):
        for _ in range(NOISE_PASSES):
            coefficients = _generalised_least_squares(segments, designs, noise)
            residuals = [
                segment - design @ coefficients
                for segment, design in zip(segments, designs, strict=True)
            ]
            beside, noise = noise, _noise(residuals, null.order, drifting)
            after = _innovation_power(residuals, noise)
            if after < best[0]:
                best = (after, coefficients, noise)
            # Burg's noise of the rest is not always likelier than that before it
            if beside.order == null.order:
                same = _innovation_power(residuals, beside)
                least = min(least, (same, coefficients, beside), key=itemgetter(0))
    _, coefficients, noise = best if best[0] < before else least
    # T = N log(σ₀²/σ₁²), σ² by the sums of squared innovations
    after = min(least[0], best[0])
    statistic = n * float(np.log(max(before, 1e-300) / max(after, 1e-300)))
    return statistic, coefficients, noise


def _innovation_power(segments: Sequence[FloatArray], noise: ColouredNoise) -> float:
    """Sum of the squared innovations of segments whitened by a noise."""
    return sum(float(np.sum(noise.whiten(segment) ** 2)) for segment in segments)


def _generalised_least_squares(
    segments: list[FloatArray], designs: list[FloatArray], noise: ColouredNoise
) -> FloatArray:
    y = np.concatenate([noise.whiten(segment) for segment in segments])
    x = np.concatenate([noise.whiten(design) for design in designs])
    gram = x.T @ x
    ridge = 1e-10 * np.trace(gram) / max(gram.shape[0], 1)
    return np.asarray(np.linalg.solve(gram + ridge * np.eye(gram.shape[0]), x.T @ y), dtype=float)


def _null_draw(
    null: ColouredNoise,
    lengths: list[int],
    designs: list[FloatArray],
    drifting: bool,
    rng: np.random.Generator,
) -> float:
    # with noise fitted to the draw itself, as it was to the residuals
    segments = [null.simulate(n, rng) for n in lengths]
    refitted = _noise(segments, null.order, drifting)
    return _likelihood_ratio(segments, designs, refitted, drifting)[0]


def _tail(statistic: float, draws: FloatArray, q: int) -> float:
    """Chance of at least this statistic under a gamma distribution of the draws' two moments, at
    least those of χ²(q).

    χ² is what the ratio has where noise is hardly coloured; few draws that happen to lie close
    together would tell a tail far below it.
    """
    # gamma of shape k = m²/v and scale v/m: P(T ≥ t) = Γ(k, t m/v)/Γ(k)
    mean, variance = max(float(draws.mean()), float(q)), max(float(draws.var(ddof=1)), 2.0 * q)
    return float(gammaincc(mean**2 / variance, max(statistic, 0.0) * mean / variance))
