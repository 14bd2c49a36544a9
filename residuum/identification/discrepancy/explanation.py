"""What `explain` answers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from residuum.identification.discrepancy.estimated_values import EstimatedValue
from residuum.identification.physics import Key
from residuum.identification.unseen_blocks.advice import Undetectable
from residuum.identification.unseen_blocks.free_term import BlockTerm
from residuum.identification.unseen_blocks.next_experiment import HeldValue, NextExperiment
from residuum.identification.unseen_blocks.tried import Search
from residuum.identification.unseen_blocks.verdict import BlockErrors, Candidate, Remaining
from residuum.identification.work import Work


@dataclass(frozen=True, eq=False)
class Explanation:
    """The answer.

    Attributes
    ----------
    verdict : str
        `missing-effect`, `adequate` or `unknown-effect`.
    candidates : tuple of Candidate
        The accepted effects first, the verdict's before all; probabilities of one step sum with
        those of "nothing" and "unknown" to at most one.
    probability_none, probability_unknown : float
    unexplained_share : float
        Part of what could be explained that no candidate explains.
    free : BlockTerm or None
        The smooth term that best explains the rest.
    undetectable, next_experiment
        What this experiment cannot show, and what would.
    accepted, timing : tuple of Key
        The effects that joined, and shifts in time by less than a sample: how the record was taken.
    drifting : bool
        Whether an unknown load or offset that drifts is taken to be there, whatever else is.
    left : mapping of output
        What the model with the accepted effects leaves of each measured output: RMS error, its
        unit, and how often that is what its own past cannot predict (`SLOW` and more: something
        slow is missing, or drifts).
    values : tuple of EstimatedValue
        The model's own free parameters, estimated with the accepted effects, beside the file's.
    held : tuple of HeldValue
        Parameters that the model holds fixed and that were freed, for another value does more than
        any effect.
    remaining : Remaining
        What that model leaves on unseen blocks.
    blocks : BlockErrors
        Errors block by block before and after, and with each candidate alone.
    work : Work
        Samples simulated, fits made, and what was not tried, since the work or the user's seconds
        were over.
    found : Search
        What was tried.
    """

    verdict: str
    candidates: tuple[Candidate, ...]
    probability_none: float
    probability_unknown: float
    unexplained_share: float
    free: BlockTerm | None
    undetectable: tuple[Undetectable, ...]
    next_experiment: tuple[NextExperiment, ...]
    accepted: tuple[Key, ...]
    timing: tuple[Key, ...]
    drifting: bool
    left: Mapping[str, tuple[float, str, float]]
    values: tuple[EstimatedValue, ...]
    held: tuple[HeldValue, ...]
    remaining: Remaining
    blocks: BlockErrors
    work: Work
    seconds: float
    found: Search

    @property
    def by_share(self) -> bool:
        """Whether effects were named by the share that they take away: what they leave is more than
        its own noise.
        """
        return not self.found.court.scale.nats
