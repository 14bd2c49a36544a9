"""A test's p-value in words."""

from __future__ import annotations

SMALLEST = 1e-300
"""Below which a number of double precision cannot tell one chance from another, or from none."""


def chance(p: float) -> str:
    """`p = 0.03`; no chance is nothing.

    >>> chance(0.0), chance(0.0312)
    ('p < 1e-300', 'p = 0.031')
    """
    return f"p < {SMALLEST:g}" if p < SMALLEST else f"p = {p:.2g}"
