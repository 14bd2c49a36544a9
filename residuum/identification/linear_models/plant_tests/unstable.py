"""Is the plant unstable? Whether A(q) of the long autoregression has a root outside the unit circle by more than chance.

An unstable plant can be recorded only while a controller holds it, and the record stays bounded then. The long autoregression
is right in the loop, too, so that the root is the plant's: noise alone cannot grow in a record that does not. Under a root at one
the estimate errs to the stable side, which leaves integrators out.

Fails where the loop answers without noise or set point, so that A cannot be told from the controller's answer.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from residuum.identification.linear_models.plant_tests.long_autoregression import LongAutoregression

_OUTSIDE = 5.0
"""Standard deviations outside the unit circle."""
_GROWTH = 3.0
"""e-folds within the record that a root at least means: a slower one is as good as an integrator's."""


@dataclass(frozen=True)
class UnstableTest:
    """The root of largest size, the standard deviation of its size, and the e-folds that it grows in the record."""

    pole: complex
    spread: float
    growth: float

    @property
    def unstable(self) -> bool:
        """Whether the plant is."""
        return abs(self.pole) - 1 > _OUTSIDE * self.spread and self.growth > _GROWTH

    def says(self, sample_time: float) -> str:
        """The pole, in z and as a rate.

        >>> UnstableTest(1.1618 + 0j, 0.003, 300.0).says(0.005)
        'pole at 1.162 ± 0.003, which grows e-fold in 0.0333 s'
        """
        real = abs(self.pole.imag) < 1e-9 * abs(self.pole)
        at = f"{self.pole.real:.4g}" if real else f"{self.pole.real:.4g} ± {abs(self.pole.imag):.4g}i (size {abs(self.pole):.4g})"
        return f"pole at {at} ± {self.spread:.1g}, which grows e-fold in {sample_time / np.log(abs(self.pole)):.3g} s"


def unstable_test(found: LongAutoregression) -> UnstableTest | None:
    """The test on a long autoregression; None where noise is too small to tell.

    >>> from residuum.identification.linear_models.plant_tests.long_autoregression import long_autoregression
    >>> from residuum.identification.record import Record
    >>> rng, y, u = np.random.default_rng(0), np.zeros(1000), np.zeros(1000)
    >>> e, r = rng.standard_normal((2, 1000))
    >>> for t in range(1, 1000):
    ...     y[t] = 1.1 * y[t - 1] + u[t - 1] + 0.1 * e[t]
    ...     u[t] = 0.5 * (r[t] - y[t])
    >>> unstable_test(long_autoregression([Record({"u": u, "y": y}, {"u": "", "y": ""}, 1.0)], "u", "y")).unstable
    True
    """
    if not found.resolved:
        return None
    A = np.r_[1.0, -found.output_weights]
    roots = np.roots(A)
    pole = complex(roots[np.argmax(np.abs(roots))])
    slope = np.polyval(np.polyder(A), pole)
    if abs(pole) <= 1 or slope == 0:
        return UnstableTest(pole, float("inf"), 0.0)
    by_weight = pole ** np.arange(len(A) - 2, -1, -1.0) / slope  # dλ/dα_i, from A(λ) = 0
    by_size = np.real(np.conj(pole) / abs(pole) * by_weight)
    samples = sum(len(u) for u in found.inputs) / len(found.inputs)
    return UnstableTest(pole, found.spread(by_size, np.zeros_like(found.input_weights)), float(np.log(abs(pole)) * samples))
