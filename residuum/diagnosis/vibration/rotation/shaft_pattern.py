"""What a signal does once a turn of the shaft, and what it does at one place only."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Signal = npt.NDArray[np.float64]
POINTS_OF_A_TURN = 256  # a turn; orders up to 128


@dataclass(frozen=True, eq=False)
class ShaftPattern:
    """A signal cut into whole turns of the shaft.

    Parameters
    ----------
    turns : array, shape (n_turns, POINTS_OF_A_TURN)
        The signal on an even grid of shaft angle: order tracking, so a speed that is not constant does not smear orders.
    """

    turns: Signal

    @property
    def typical(self) -> Signal:
        """Median over the turns, shape (POINTS_OF_A_TURN,): an average in which an event in one turn alone leaves no trace."""
        return np.asarray(np.median(self.turns, axis=0))

    @property
    def single(self) -> Signal:
        """What the turns do not share: each minus the typical turn, shape (n_turns, POINTS_OF_A_TURN)."""
        return np.asarray(self.turns - self.typical)

    def orders(self) -> Signal:
        """Amplitude of each order of the typical turn [unit of the signal], shape (POINTS_OF_A_TURN/2 + 1,)."""
        return np.asarray(np.abs(np.fft.rfft(self.typical)) * 2.0 / POINTS_OF_A_TURN)

    def band(self, low: int, high: int) -> npt.NDArray[np.complex128]:
        """Analytic signal of the typical turn with the orders low … high alone, shape (POINTS_OF_A_TURN,), complex.

        Its real part is the band-limited turn, its magnitude the envelope (McFadden 1986).
        """
        coefficients = np.fft.fft(self.typical)[: POINTS_OF_A_TURN // 2 + 1]
        order = np.arange(coefficients.shape[0])
        kept = np.where((order >= low) & (order <= high), coefficients, 0.0)
        return np.asarray(2.0 * np.fft.ifft(kept, POINTS_OF_A_TURN))


def shaft_pattern(x: Signal, shaft_turns: Signal) -> ShaftPattern:
    """Cut x into whole turns.

    Parameters
    ----------
    x : array, shape (n,)
    shaft_turns : array, shape (n,)
        Turns of the shaft since any moment, increasing, at each sample.

    >>> angle = np.linspace(0, 5.2, 4000) ** 1.02
    >>> pattern = shaft_pattern(3.0 * np.cos(2 * np.pi * 4 * angle), angle)
    >>> pattern.turns.shape, np.round(pattern.orders()[[3, 4, 5]], 2).tolist()
    ((5, 256), [0.0, 3.0, 0.0])
    """
    start = float(shaft_turns[0])
    whole = int(np.floor(shaft_turns[-1] - start))
    grid = start + np.arange(whole * POINTS_OF_A_TURN) / POINTS_OF_A_TURN
    return ShaftPattern(np.interp(grid, shaft_turns, x).reshape(whole, POINTS_OF_A_TURN))
