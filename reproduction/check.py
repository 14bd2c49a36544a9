"""One number of the source beside the one measured here."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Check:
    """A measured value, what the source shows of it, and whether the two agree.

    `by_construction` marks what could not have come out otherwise (a design's own constraint): it is shown and is no agreement.
    """

    name: str
    source: str
    ours: str
    holds: bool
    difference: str = ""
    by_construction: bool = False

    @property
    def word(self) -> str:
        """What is said of it in one word or three."""
        if not self.holds:
            return "differs"
        return "holds by construction" if self.by_construction else "agrees"

    @property
    def sentence(self) -> str:
        """Name, value, the source's, and what is said of them."""
        beyond = f", {self.difference}" if self.difference else ""
        return f"{self.name} {self.ours} ({self.source}{beyond}: {self.word})"


def near(
    name: str,
    source: float,
    ours: float,
    tolerance: float,
    unit: str = "",
    *,
    by_construction: bool = False,
) -> Check:
    """Agrees when ours lies within a part `tolerance` of the source's value."""
    off = ours / source - 1.0
    holds = bool(np.isfinite(off) and abs(off) <= tolerance)
    beyond = f"{100 * off:+.3g} %, within {100 * tolerance:g} % allowed"
    return Check(name, _said(source, unit), _said(ours, unit), holds, beyond, by_construction)


def within(
    name: str,
    ours: float,
    low: float,
    high: float,
    unit: str = "",
    source: str | None = None,
    *,
    by_construction: bool = False,
) -> Check:
    """Agrees when ours lies between two limits; `source` says where these come from."""
    limits = f"{_said(low, '')} to {_said(high, unit)}"
    shown = limits if source is None else f"{source}: {limits}"
    beyond = max(low - ours, ours - high, 0.0)
    said = f"{_said(beyond, unit)} beyond" if beyond else ""
    return Check(name, shown, _said(ours, unit), bool(low <= ours <= high), said, by_construction)


def at_most(
    name: str,
    ours: float,
    limit: float,
    unit: str = "",
    *,
    source: str | None = None,
    by_construction: bool = False,
) -> Check:
    """Agrees when ours is no more than the limit."""
    shown = f"at most {_said(limit, unit)}"
    shown = shown if source is None else f"{source}: {shown}"
    beyond = f"{_said(ours - limit, unit)} beyond" if ours > limit else ""
    return Check(name, shown, _said(ours, unit), bool(ours <= limit), beyond, by_construction)


def at_least(
    name: str,
    ours: float,
    limit: float,
    unit: str = "",
    *,
    source: str | None = None,
    by_construction: bool = False,
) -> Check:
    """Agrees when ours is no less than the limit."""
    shown = f"at least {_said(limit, unit)}"
    shown = shown if source is None else f"{source}: {shown}"
    beyond = f"{_said(limit - ours, unit)} short" if not ours >= limit else ""
    return Check(name, shown, _said(ours, unit), bool(ours >= limit), beyond, by_construction)


def same(name: str, source: object, ours: object) -> Check:
    """Agrees when the two are equal."""
    return Check(name, str(source), str(ours), bool(source == ours))


def _said(value: float, unit: str) -> str:
    return f"{value:.4g} {unit}".strip()
