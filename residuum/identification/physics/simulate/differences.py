"""Slopes of simulations by a parameter that no equation names, as differences, and the step that
they are taken with.

∂y/∂θ ≈ (y(θ + h) − y(θ − h)) / 2h, h = ρ·max(|θ|, s) with s the parameter's usual size. Too large a
ρ errs by the curvature (∝ h²), too small a one by the noise of the solver, whose own steps change
with θ (∝ 1/h). Where two neighbours of a ladder of ρ agree best both are small: their difference is
told as the slopes' error. At a bound the difference is taken on the side that is left. Where a
solver has next to no noise, as one of steps that do not depend on θ, a tiny step to one side, (y(θ
+ h) − y(θ)) / h, is as good: it costs one simulation, not two.

Reference: J. Nocedal, S. J. Wright, *Numerical Optimization*, 2006, 8.1; J. J. Moré, S. M. Wild,
*Estimating derivatives of noisy simulations*, ACM Trans. Math. Softw. 38 (2012).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from residuum.array_types import FloatArray

Run = Callable[[float], FloatArray]
"""Outputs at a value of the parameter, shape (n, outputs)."""

_FIRST = (1e-3, 1e-4)
_LADDER = (1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7)
_ENOUGH = 1e-4
"""Error of slopes at which no other step is tried: steps of a descent do not feel it."""
_TO_ONE_SIDE = 1e-6
"""The step to one side, which errs in proportion to h."""


@dataclass(frozen=True)
class Step:
    """How far a parameter is moved: `relative` times its value, or times its usual `size` where
    that is larger; `error` is the part by which slopes at two such steps differed. `one_sided`: it
    is moved to one side alone.
    """

    relative: float
    size: float
    error: float = np.nan
    one_sided: bool = False

    def of(self, value: float) -> float:
        """The step from a value, in its unit."""
        return self.relative * max(abs(value), self.size)

    def slope(
        self, run: Run, value: float, here: FloatArray, bounds: tuple[float, float]
    ) -> FloatArray:
        """The slope of a run at a value, where it gives `here`."""
        if self.one_sided:
            return to_one_side(run, value, here, self.of(value), bounds)
        return central(run, value, self.of(value), bounds)


def to_one_side(
    run: Run, value: float, here: FloatArray, step: float, bounds: tuple[float, float]
) -> FloatArray:
    """The slope of a run at a value, where it gives `here`, by a step up, or down where there is no
    room above or nothing can be simulated there.

    Examples
    --------
    >>> import numpy as np
    >>> square = lambda v: np.array([[v**2]])
    >>> to_one_side(square, 3.0, square(3.0), 1e-7, (0.0, 9.0)).round(5)
    array([[6.]])
    """
    up = value + step
    moved = run(up) if up <= bounds[1] else np.full_like(here, np.nan)
    at = up
    if not np.isfinite(moved).all():
        at = value - step
        moved = run(at)
    return _slope(moved, here, at - value)


def central(run: Run, value: float, step: float, bounds: tuple[float, float]) -> FloatArray:
    """The slope of a run at a value, between bounds; NaN where neither side can be simulated.

    Parameters
    ----------
    step : float
        To each side [the parameter's unit].

    Examples
    --------
    >>> import numpy as np
    >>> central(lambda v: np.array([[v**2]]), 3.0, 1e-3, (0.0, 9.0)).round(9)
    array([[6.]])
    >>> central(lambda v: np.array([[np.inf, 2.0 * v]]), 3.0, 1e-3, (0.0, 9.0)).round(9)
    array([[nan,  2.]])
    """
    low = max(value - step, bounds[0])
    high = min(value + step, bounds[1])
    below = run(low)
    above = run(high)
    # Where the model does not exist on one side the slope is that of the other, first order only.
    if not np.isfinite(below).all():
        low = value
        below = run(value)
    elif not np.isfinite(above).all():
        high = value
        above = run(value)
    return _slope(above, below, high - low)


def _slope(above: FloatArray, below: FloatArray, apart: float) -> FloatArray:
    """What runs to infinity on both sides, or has no side left, has no slope (NaN)."""
    known = np.isfinite(above) & np.isfinite(below) & (apart != 0.0)
    slope = np.full(above.shape, np.nan)
    with np.errstate(over="ignore"):  # where it runs away between the two the slope is infinite
        slope[known] = (above[known] - below[known]) / apart
    return slope


def chosen_step(run: Run, value: float, size: float, bounds: tuple[float, float]) -> Step:
    """The step at which slopes differ least from those at a tenth of it; a tiny one to one side where
    slopes by that hardly differ from those.

    Examples
    --------
    >>> import numpy as np
    >>> rough = lambda v: np.array([[np.sin(v) + 1e-7 * np.sin(1e9 * v)]])
    >>> step = chosen_step(rough, 1.0, 1.0, (-9.0, 9.0))
    >>> step.relative > 1e-4, step.error < 1e-3
    (True, True)
    """
    here = run(value)
    scale = _spread(here)
    slopes: dict[float, FloatArray] = {}

    def error(relative: float, finer: float) -> float:
        for ratio in (relative, finer):
            if ratio not in slopes:
                h = Step(ratio, size).of(value)
                slopes[ratio] = central(run, value, h, bounds) / scale
        return _apart(slopes[relative], slopes[finer])

    # Each slope is two simulations: where the usual step is good enough no other one is tried.
    first = error(*_FIRST)
    if first <= _ENOUGH:
        tiny = Step(_TO_ONE_SIDE, size, one_sided=True)
        apart = _apart(slopes[_FIRST[1]], tiny.slope(run, value, here, bounds) / scale)
        return replace(tiny, error=apart) if apart <= _ENOUGH else Step(_FIRST[0], size, first)
    errors = {relative: error(relative, finer) for relative, finer in pairwise(_LADDER)}
    # A step whose simulations failed has no error: it is the last choice.
    best = min(errors, key=lambda relative: np.nan_to_num(errors[relative], nan=np.inf))
    return Step(best, size, errors[best])


def _spread(Y: FloatArray) -> FloatArray:
    """What changes of each output are measured by: its standard deviation, or its size where it
    does not move.
    """
    spread = np.std(Y, axis=0)
    # A constant output is measured by its size.
    spread = np.where(spread > 0.0, spread, np.max(np.abs(Y), axis=0))
    return np.where(spread > 0.0, spread, 1.0)


def _apart(a: FloatArray, b: FloatArray) -> float:
    """Part by which two slopes differ; 0 where both are nothing."""
    size = float(np.linalg.norm(a))
    apart = float(np.linalg.norm(a - b))
    return apart / size if size > 0.0 else apart
