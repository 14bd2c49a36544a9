"""How much of the typical shaft turn looks like a notch in the gear, and not like the tooth errors of a healthy one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.ndimage import uniform_filter1d

from residuum.array_types import ComplexArray
from residuum.diagnosis.vibration.rotation import POINTS_OF_A_TURN
from residuum.identification.errors import NotIdentifiable

Signal = npt.NDArray[np.float64]
_WIDTHS = (0.6, 0.8, 1.0, 1.25)  # standard deviations of the bump in pitches of the gear: about the two teeth that spread
_SMOOTHING = 3  # orders; over more, the steep power of the lowest orders leaks into the next


@dataclass(frozen=True, eq=False)
class NotchMatch:
    r"""Matched filter for one bump of the transmission error a shaft turn, in the coloured pattern of healthy teeth.

    A notch lets the teeth beside it spread: the transmission error e(φ) has a bump g(φ), about one gear pitch wide, once a
    turn. It accelerates the gate, and the drive's first-order lag T passes it on to the speed, so its spectrum at order k is S_k.
    (A gear that binds at one place loads the drive there: a pulse, which `periodic_pulse` of the movement's features looks for.)

    .. math:: S_k \propto \frac{s_k^2}{1 + s_k T} \, e^{-(k \sigma)^2 / 2}, \qquad s_k = j k \omega_M / N

    Healthy teeth make the typical turn a random pattern with power P_k (mean over healthy turns, smoothed over three orders).
    With z the largest whitened correlation over all places and widths, z = max |Σ 2 Re(S̄_k X_k e^{jkφ}/P_k)| / √(2 Σ|S_k|²/P_k),
    and v² what the turn scatters besides, as a multiple of what healthy turns do, the statistic is z / √max(1, v): z alone
    mistakes a gear that is worse all round for a notch, z / v a gear that is very good but for one tooth.

    Fails for a bump of another width than about 0.5 … 1.5 pitches, and for two notches.

    Attributes
    ----------
    power : array, shape (gear_teeth − 1,)
        P_k of the orders 1 … gear_teeth − 1 of the typical turn [(rad/s)²].
    gear_teeth : int
        N.
    """

    power: Signal
    gear_teeth: int

    @classmethod
    def of(cls, typical_turns: Sequence[Signal], gear_teeth: int) -> NotchMatch:
        """From the typical turns of healthy movements, each of shape (POINTS_OF_A_TURN,); NotIdentifiable without any."""
        if len(typical_turns) == 0:
            raise NotIdentifiable("notch match: no healthy turn to learn the tooth errors from")
        power = np.mean([np.abs(_spectrum(turn, gear_teeth)) ** 2 for turn in typical_turns], axis=0)
        smooth = np.exp(uniform_filter1d(np.log(power + np.finfo(float).tiny), _SMOOTHING, mode="nearest"))
        return cls(np.asarray(smooth), gear_teeth)

    def statistic(self, typical_turn: Signal, motor_speed: float, time_constant: float) -> float:
        """z / √max(1, v) of one typical turn [standard deviations]; ω_M [rad/s], T [s]. About 3 for healthy gears."""
        X = self.spectrum(typical_turn)
        z, _ = self.largest_bump(X, motor_speed, time_constant)
        energy = 2.0 * float(np.sum(np.abs(X) ** 2 / self.power))
        rest = (energy - z**2) / (2 * len(self.power) - 1)
        return z / max(rest, 1.0) ** 0.25

    @property
    def orders(self) -> npt.NDArray[np.int64]:
        """Orders k = 1 … gear_teeth − 1 of the shaft, shape (gear_teeth − 1,)."""
        return np.arange(1, self.gear_teeth)

    def spectrum(self, typical_turn: Signal) -> ComplexArray:
        """X_k, the Fourier coefficients of a turn at these orders [unit of the turn], shape (gear_teeth − 1,)."""
        return _spectrum(typical_turn, self.gear_teeth)

    def largest_bump(self, X: ComplexArray, motor_speed: float, time_constant: float) -> tuple[float, ComplexArray]:
        """z of the bump that X_k matches best, and that bump, fitted, shape (gear_teeth − 1,)."""
        best, bump = 0.0, np.zeros_like(X)
        for S in self._bumps(motor_speed, time_constant):
            energy = 2.0 * float(np.sum(np.abs(S) ** 2 / self.power))
            correlation = self._correlation(X, S)
            place = int(np.argmax(np.abs(correlation)))
            z = float(np.abs(correlation[place])) / np.sqrt(energy)
            if z > best:
                turned = S * np.exp(-2j * np.pi * self.orders * place / POINTS_OF_A_TURN)
                best, bump = z, correlation[place] / energy * turned
        return best, bump

    def _bumps(self, motor_speed: float, T: float) -> list[ComplexArray]:
        k = self.orders
        s = 1j * k * motor_speed / self.gear_teeth
        return [s**2 / (1.0 + s * T) * np.exp(-0.5 * (k * width * 2 * np.pi / self.gear_teeth) ** 2) for width in _WIDTHS]

    def _correlation(self, X: ComplexArray, S: ComplexArray) -> Signal:
        """Whitened correlation with the bump at each of POINTS_OF_A_TURN places, shape (POINTS_OF_A_TURN,)."""
        weighted = np.zeros(POINTS_OF_A_TURN, dtype=complex)
        weighted[1 : self.gear_teeth] = np.conj(S) * X / self.power
        return np.asarray(2.0 * POINTS_OF_A_TURN * np.real(np.fft.ifft(weighted)))


def _spectrum(typical_turn: Signal, gear_teeth: int) -> ComplexArray:
    """Fourier coefficients of the orders 1 … gear_teeth − 1."""
    return np.asarray(np.fft.rfft(typical_turn)[1:gear_teeth] / POINTS_OF_A_TURN)
