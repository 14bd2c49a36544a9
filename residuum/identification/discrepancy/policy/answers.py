"""What is said?"""

from collections.abc import Mapping

FEWEST_TO_JUDGE = 40
"""[samples] Of all records together, two in each block; with fewer an effect may follow every one. Chosen."""
NEGLIGIBLE_REST, LARGE_REST = 0.03, 0.30
"""Shares of the explainable gain that a free term may take before the candidates lose probability, and lose all of it. Chosen."""
REFUTED = 0.9
"""How probable something else is where what the likelihood wanted failed, or nothing follows the error. Chosen."""
DOUBTED = 0.3
"""How probable it is where more is left than the right effects leave. Chosen."""
UNKNOWN_FROM = 0.5
"""Probability of something else from which on the verdict is that."""
MUCH_ABOVE_NOISE = 3.0
"""Times the noise floor that no error keeps with the right effect added (at most 2)."""
NAMELESS_ABOVE_NOISE = 100.0
"""Times the noise floor beyond which no name stands. Chosen."""
MOST_OF_THE_EXCESS = 0.8
"""Share of what stands above the noise that the right effect takes away at least, where more than noise is left. Chosen."""
STANDS_COMPLETE_OR_NOT = 0.7
"""Share of its error to which an output's fell where what was found stands, complete or not. Chosen."""
OWN_SIGNALS_LEVEL = 1e-4
"""Level of the test from which on a model errs by its own signals. Chosen."""
OWN_SIGNALS_SHARE = 0.2
"""And share of the error's power. Chosen."""
OTHER_VALUE = 2.0
"""[standard deviations] From which on a value is another than the file's. Chosen."""


FREE_TERM_KNOTS: Mapping[str, tuple[int, ...]] = {
    "velocity": (9, 25),
    "position": (9, 33),
    "current": (9,),
    "temperature": (9,),
    "level": (9,),
    "time": (17,),
}
"""Axes of the free term, and how many hat functions are tried on each. Chosen."""
FACTOR_KNOTS = 5
"""Hat functions by which an effect that was found may change. Chosen."""
FORMULA_TERMS = 3
"""Functions that a formula of the free term has at most. Chosen."""
