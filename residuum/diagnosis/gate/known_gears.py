"""Gears whose healthy tooth errors are on record: what is new in a turn of one of them says more than the turn itself."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from residuum.array_types import ComplexArray
from residuum.diagnosis.gate.notch_match import NotchMatch, Signal

_GRID = 4096  # places a turn at which two patterns are laid over each other: a fortieth of the finest order's period
_COARSE_GRID = 512  # enough to choose the nearest among many: twelve places a period of the finest order
_SAME_TRAINED = 0.15  # share of a pattern's power that a pattern of the same gear may leave
_SAME = 0.3  # the same when a notch may have come
_CANDIDATES = 2
_ROUNDS = 3  # of laying over and taking the notch out


@dataclass(frozen=True)
class KnownTurn:
    """A turn explained by a known gear: its match with a *new* notch, and the share of its power that stays unexplained."""

    match: float
    unexplained: float


@dataclass(frozen=True, eq=False)
class KnownGears:
    r"""Healthy patterns by which a gear is recognised, and what has come since.

    Tooth errors are fixed in a gear, so its turns repeat within 1 % of their power while those of two gears share at
    most 45 %. A turn X is compared with each known pattern R, turned by ψ and scaled by a (wear), and one notch g:

    .. math:: \min_{R, a, \psi, g} \sum_k |X_k - a R_k e^{-j k \psi} - g_k|^2 / P_k

    P_k is the power of healthy tooth errors (`NotchMatch`). When less than 30 % stays unexplained it is that gear, and the
    matched filter looks at X − a R e^{−jkψ} alone: 1.2 at most in a healthy gear, six and more with a notch of 0.8.

    Fails for a notch that was there when the pattern was learned: it counts as part of the gear.

    Attributes
    ----------
    patterns : array, shape (n_patterns, gear_teeth − 1), complex
        R_k of the orders 1 … gear_teeth − 1; opening and closing give one each.
    movements : array, shape (n_patterns,)
        Healthy movements behind each.
    """

    patterns: ComplexArray
    movements: npt.NDArray[np.int64]

    @classmethod
    def of(cls, typical_turns: Sequence[Signal], notch: NotchMatch) -> KnownGears:
        """Group healthy typical turns, each of shape (POINTS,), by gear: a turn joins the pattern that explains it."""
        patterns: list[ComplexArray] = []
        movements: list[int] = []
        for turn in typical_turns:
            X = notch.spectrum(turn)
            laid = _laid_over(np.array(patterns), X, notch.power) if patterns else None
            nearest = int(np.argmin(laid.left)) if laid is not None else 0
            if laid is None or laid.left[nearest] > _SAME_TRAINED:
                patterns.append(X)
                movements.append(1)
            else:
                n, back = movements[nearest], np.exp(1j * notch.orders * laid.angle[nearest])
                patterns[nearest] = (n * patterns[nearest] + X * back) / (n + 1)
                movements[nearest] = n + 1
        return cls(np.array(patterns).reshape(len(patterns), len(notch.orders)), np.array(movements, dtype=np.int64))

    def joined(self, others: KnownGears) -> KnownGears:
        """These patterns and the others'."""
        return KnownGears(np.vstack([self.patterns, others.patterns]), np.append(self.movements, others.movements))

    def recognise(self, typical_turn: Signal, notch: NotchMatch, motor_speed: float, time_constant: float) -> KnownTurn | None:
        """The known gear that explains the turn best, or None; ω_M [rad/s], T [s]."""
        if len(self.patterns) == 0:
            return None
        X = notch.spectrum(typical_turn)
        nearest = np.argsort(_laid_over(self.patterns, X, notch.power, _COARSE_GRID).left)[:_CANDIDATES]
        found = [_explained(self.patterns[k], X, notch, motor_speed, time_constant) for k in nearest]
        best = min(found, key=lambda known: known.unexplained)
        return best if best.unexplained < _SAME else None


def _explained(R: ComplexArray, X: ComplexArray, notch: NotchMatch, motor_speed: float, T: float) -> KnownTurn:
    """Lay R over X and take the largest notch out of what is left, a few times over."""
    bump, match, new = np.zeros_like(X), 0.0, X
    for _ in range(_ROUNDS):
        laid = _laid_over(R[None], X - bump, notch.power)
        new = X - laid.scale[0] * R * np.exp(-1j * notch.orders * laid.angle[0])
        match, bump = notch.largest_bump(new, motor_speed, T)
    return KnownTurn(match, _power(new - bump, notch.power) / _power(X, notch.power))


@dataclass(frozen=True, eq=False)
class _LaidOver:
    """For each pattern: the angle and scale that bring it nearest to X, and the share of X's power that it leaves."""

    angle: Signal
    scale: Signal
    left: Signal


def _laid_over(R: ComplexArray, X: ComplexArray, power: Signal, grid: int = _GRID) -> _LaidOver:
    correlation = np.zeros((len(R), grid), dtype=complex)
    correlation[:, 1 : len(X) + 1] = X * np.conj(R) / power
    overlap = grid * np.real(np.fft.ifft(correlation))
    best = np.argmax(overlap, axis=1)
    own = np.sum(np.abs(R) ** 2 / power, axis=1)
    reached = overlap[np.arange(len(R)), best]
    return _LaidOver(2.0 * np.pi * best / grid, reached / own, 1.0 - reached**2 / (own * _power(X, power)))


def _power(X: ComplexArray, power: Signal) -> float:
    return float(np.sum(np.abs(X) ** 2 / power)) + np.finfo(float).tiny
