"""The question `compare`."""

from __future__ import annotations

from residuum.identification.residual_analysis.policy import STRUCTURE_LEVEL
from residuum.library.questions import Question, field


class Compare(Question):
    """How large is a model's error, is it structured, and where does it lie? Its parameters stay as
    they are.
    """

    level: float = field(
        STRUCTURE_LEVEL,
        "Probability that an error which is nothing but noise is called structured.",
        ge=0.002,
        le=0.2,
    )
    """Within what is decided by: `BEYOND_NOISE_CHANCE` below, `ORDINARY_DRAW` above."""
    seed: int = field(0, "Seed of the noise that is drawn to tell so.", ge=0, le=2**32 - 1)
