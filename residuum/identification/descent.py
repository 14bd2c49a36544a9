"""Damped Gauss–Newton descent (Levenberg and Marquardt): the one loop that estimates by least
squares walk down with.
"""

from __future__ import annotations

from enum import Enum
from typing import Generic, NamedTuple, Protocol, TypeVar

# With these SciPy's bounded `least_squares` takes 1.1 to 3.3 times as long to the same minima
# (docs/decisions/0017-one-descent.md).
FIRST_DAMPING, LEAST_DAMPING = 1e-3, 1e-12  # fractions of the diagonal of JᵀJ
HARDER, SOFTER = 6.0, 10.0  # factors of the damping after a refused and an accepted step
ATTEMPTS = 12
"""Dampings tried before nothing near a point is taken to be lower: the last shortens a step a
millionfold.
"""


class End(Enum):
    """Why a descent ended."""

    SETTLED = "a step gained next to nothing"
    STUCK = "no step, however short, gained anything"
    LEFT = "the landscape said that it is not worth while"
    TIRED = "as many steps as were allowed"


class Point(Protocol):
    """A place with its cost and whatever the next step needs; infinite cost where nothing can be
    evaluated.
    """

    @property
    def cost(self) -> float:
        """What is to fall."""


P = TypeVar("P", bound=Point)
T = TypeVar("T")


class Landscape(Protocol[P, T]):
    """What is walked down: `T` is what leads to a point (values), `P` the point with its slopes."""

    def trial(self, point: P, damping: float) -> T | None:
        """Where the Gauss–Newton step from a point leads when its matrix has a diagonal raised by
        the fraction `damping`.

        Bounds are the landscape's own: an active set, or clipped. None where the step promises too
        little to be looked at.
        """

    def cost(self, trial: T) -> float:
        """The cost there, without slopes."""

    def point(self, trial: T) -> P:
        """The point there, with slopes."""

    def ends(self, point: P) -> End | None:
        """Whether to go no further from a point, before a step is computed."""


class Descent(NamedTuple, Generic[P]):
    """Where a descent ended, after how many steps, and why."""

    point: P
    steps: int
    end: End


def descend(
    landscape: Landscape[P, T], point: P, *, steps: int, fall: float = 0.0, relative: float = 0.0
) -> Descent[P]:
    """Walk down until a step lowers the cost by less than `fall`, or than the fraction `relative`
    of it.

    A step that does not lower the cost is computed again with six times the damping, one that does
    leaves a tenth of it. Slopes are computed at once where steps are taken as they come; after one
    was refused the next one's cost is looked at first.

    Parameters
    ----------
    steps : int
        The most accepted steps.
    fall, relative : float
        Of the cost [its unit, -].

    Notes
    -----
    It ends in the nearest minimum: where it begins is the caller's business.

    References
    ----------
    J. J. Moré, *The Levenberg–Marquardt algorithm*, LNM 630 (1978): damping scaled by the diagonal
    of JᵀJ.
    """
    damping, refused = FIRST_DAMPING, False
    for step in range(steps):
        if end := landscape.ends(point):
            return Descent(point, step, end)
        lower, used = _lower(landscape, point, damping, refused)
        if lower is None:
            return Descent(point, step, End.STUCK)
        # of the cost before the step: the one after it may be zero
        enough = max(fall, relative * abs(point.cost))
        refused, fallen = used > damping, point.cost - lower.cost
        point, damping = lower, max(used / SOFTER, LEAST_DAMPING)
        if fallen < enough:
            return Descent(point, step + 1, End.SETTLED)
    return Descent(point, steps, End.TIRED)


def _lower(
    landscape: Landscape[P, T], point: P, damping: float, refused: bool
) -> tuple[P | None, float]:
    """A lower point and the damping that led there; None where no attempt does."""
    for _ in range(ATTEMPTS):
        trial = landscape.trial(point, damping)
        if trial is None:
            break
        # slopes cost more than a value: after a refusal the value decides whether they are needed
        if not refused or landscape.cost(trial) < point.cost:
            lower = landscape.point(trial)
            if lower.cost < point.cost:
                return lower, damping
        damping, refused = damping * HARDER, True
    return None, damping
