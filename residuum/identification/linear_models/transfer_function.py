"""Rational transfer function of one input and one output, in s or in z."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import signal

from residuum.array_types import ComplexArray, FloatArray
from residuum.identification.errors import BadModel


@dataclass(frozen=True, eq=False)
class TransferFunction:
    """G = num/den, polynomials in descending powers of s (`sample_time` None) or of z.

    Parameters
    ----------
    num, den : array, shapes (p,), (q,)
        Coefficients, highest power first; leading zeros are dropped.
    sample_time : float or None
        Sample time [s] of a discrete-time system, None for continuous time.

    Raises
    ------
    BadModel
        Zero denominator, non-finite coefficient, non-positive sample time.

    Examples
    --------
    >>> g = TransferFunction([0.6], [1.0, 0.4], sample_time=1.0)
    >>> bool(g.is_stable), g.frequency_response([0.0]).real.round(4).tolist()
    (True, [0.4286])
    """

    num: FloatArray
    den: FloatArray
    sample_time: float | None = None

    def __post_init__(self) -> None:
        for name in ("num", "den"):
            coefficients = np.atleast_1d(np.asarray(getattr(self, name), dtype=float))
            if coefficients.ndim != 1 or not np.isfinite(coefficients).all():
                raise BadModel(
                    f"TransferFunction, {name}: must be a one-dimensional list of finite"
                    " coefficients"
                )
            object.__setattr__(
                self, name, np.trim_zeros(coefficients, "f") if coefficients.any() else np.zeros(1)
            )
        if not self.den.any():
            raise BadModel("TransferFunction, den: must not be zero")
        if self.sample_time is not None and not self.sample_time > 0:
            raise BadModel(
                f"TransferFunction, sample_time: {self.sample_time!r}; must be positive or None"
            )

    @property
    def is_proper(self) -> bool:
        """Whether the numerator's degree does not exceed the denominator's."""
        return len(self.num) <= len(self.den)

    @property
    def poles(self) -> ComplexArray:
        """Roots of the denominator, shape (q−1,)."""
        return np.asarray(np.roots(self.den), dtype=complex)

    @property
    def zeros(self) -> ComplexArray:
        """Roots of the numerator, shape (p−1,)."""
        return np.asarray(np.roots(self.num), dtype=complex)

    @property
    def is_stable(self) -> bool:
        """All poles strictly inside the unit circle (z) or the left half plane (s)."""
        if self.sample_time is None:
            return bool(np.all(self.poles.real < 0))
        return bool(np.all(np.abs(self.poles) < 1))

    def frequency_response(self, omega: npt.ArrayLike) -> ComplexArray:
        """G(jω) or G(e^{jωTs}) at ω [rad/s], shape of `omega`."""
        omega = np.asarray(omega, dtype=float)
        x = 1j * omega if self.sample_time is None else np.exp(1j * omega * self.sample_time)
        return np.asarray(np.polyval(self.num, x) / np.polyval(self.den, x), dtype=complex)

    def simulate(self, u: npt.ArrayLike) -> FloatArray:
        """Output for input `u`, shape (n,), from rest. Discrete-time, proper systems only."""
        if self.sample_time is None or not self.is_proper:
            raise BadModel("TransferFunction.simulate: needs a proper discrete-time system")
        delayed = np.concatenate([np.zeros(len(self.den) - len(self.num)), self.num])
        return np.asarray(
            signal.lfilter(delayed, self.den, np.asarray(u, dtype=float)), dtype=float
        )

    def discretise(self, sample_time: float, method: str = "zoh") -> TransferFunction:
        """The sampled system (`zoh`, `bilinear`, …; scipy.signal.cont2discrete) of a continuous
        one.
        """
        if self.sample_time is not None:
            raise BadModel("TransferFunction.discretise: the system is already discrete-time")
        num, den, _ = signal.cont2discrete((self.num, self.den), sample_time, method=method)
        return TransferFunction(np.atleast_1d(np.squeeze(num)), den, sample_time)

    def to_control(self) -> Any:
        """The same system as a python-control `TransferFunction` (needs the package `control`)."""
        import control  # noqa: PLC0415  optional, only for users who have it

        return (
            control.tf(self.num, self.den)
            if self.sample_time is None
            else control.tf(self.num, self.den, self.sample_time)
        )
