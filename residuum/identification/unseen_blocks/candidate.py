"""One effect that may be missing, and what is said of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from residuum.identification.physics import Key


@dataclass(frozen=True)
class Quantity:
    """A number with its standard deviation and unit."""

    value: float
    std: float
    unit: str


@dataclass(frozen=True)
class Candidate:
    """One effect that may be missing, with what speaks for it.

    `step` counts the effects that were accepted before it; `evidence` is its log odds against "nothing more is missing";
    the errors are RMS simulation errors of `output` before and after it was added, on data that were not used for the
    estimation where `held_out` says so; `share` is the part of the error's power that it takes away on blocks kept aside.
    """

    effect: str
    balance: str
    probability: float
    indistinguishable_from: tuple[str, ...]
    parameters: Mapping[str, Quantity]
    error_before: float
    error_after: float
    error_unit: str
    output: str
    within_bounds: bool
    evidence: float
    step: int = 0
    held_out: bool = False
    share: Quantity | None = None

    @property
    def key(self) -> Key:
        """The effect at its place."""
        return Key(self.effect, self.balance)
