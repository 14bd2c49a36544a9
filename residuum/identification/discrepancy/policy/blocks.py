"""What does an effect take away on blocks kept aside, and is it real?"""

from residuum.identification.physics import Settings

MOST_BLOCKS, FEWEST_BLOCKS = 24, 6
"""Of a whole run; stretches are as many at least. Chosen."""
PIECES = 4
"""Of a block, taken in turn to estimate and to judge, so that both halves see what the record shows. Chosen."""
SHORTEST_PIECE = 4
"""[samples] Of those. Chosen."""
FIRST_SAMPLES = 5
"""[samples] At a run's beginning that always estimate: where the run began is not what is judged. Chosen."""
FOLLOWS = 0.8
"""Error of a run, in standard deviations of an output, up to which the model follows the records. Chosen."""
STRETCHES = (60, 30, 15)
"""That the records are cut into: fewer, hence longer, where the shorter ones do not show the model's error. Chosen."""
SHORTEST_STRETCH, LONGEST_STRETCH = 20, 600
"""[samples] Of them. Chosen."""
THINNED_FROM = 30
"""Stretches from which on some are left out, in pairs, where their samples are too many. Chosen."""
MOST_STRETCH_SAMPLES, FIRST_LOOK_SAMPLES = 6_000, 3_000
"""[samples] Of all stretches, and of those on which a start is looked at. Chosen."""
SHOWN = 10.0
"""Times the measurement noise that an error over a stretch has to stand to be judged. Chosen."""
DOMINANT = 0.5
"""Part of an output's power that one block may hold. Chosen."""
ESTIMATED = Settings(iterations=30, tolerance=1e-3)
"""How a candidate that is judged is estimated. Chosen."""
LOOKED_AT = Settings(iterations=10, tolerance=1e-3)
"""The same of one of its starts. Chosen."""
ESTIMATED_ON_ALL = Settings(iterations=30, tolerance=1e-5)
"""And of what is returned. Chosen."""

REAL = 0.01
"""Probability that chance alone makes an effect real: all candidates counted (Bonferroni), or of one candidate where the error
stands so far above the noise that something is missing for certain. Chosen."""
LEAST_SHARE = 0.05
"""Share of what is left that an effect has to take away to be worth its name. Chosen."""
TOLD_APART = 2.0
"""[standard errors] Within which two candidates cannot be told apart: 95 %."""
AS_GOOD = 1.0
"""[standard errors] Within which a simpler candidate leads: the rule of Breiman et al. (1984), section 3.4.3."""
COMPARABLE_SHARE, NEARLY_THE_SHARE = 0.5, 0.9
"""Parts of the leading one's share that another has to take away to stand for it, and to lead in its place. Chosen."""
TRIFLE = 0.3
"""Part of the mean power of a block below which it matters little how small it is: blocks where little happens decide nothing.
Chosen."""
PROMISED_FALL = 0.02
"""Part of the sum of squares that an effect has to take away where it was estimated to be tried on blocks kept aside. Chosen."""
FOLLOWED_STARTS = 2
"""Starts of a candidate that are followed: the second where the first goes astray on half of the data. Chosen."""
PAIR_LEADS = 2
"""Candidates beside which others are tried where nothing alone is real. Chosen."""
RESAMPLES = 400
"""Draws of the blocks with replacement that say how often a candidate leads. Chosen."""
MOST_STEPS = 4
"""Effects that join one after the other. Chosen."""
SHARE_WORK = 400_000_000
"""[samples] Of a search by share. Chosen."""
