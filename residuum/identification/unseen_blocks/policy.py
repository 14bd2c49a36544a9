"""Every number that missing physics is judged by: its unit in brackets (none: a ratio or a count),
its meaning, and what set it.
"""

from collections.abc import Mapping

WINDOWS_A_RECORD = (27, 9, 3, 1)
"""Windows a record, from short horizons to the whole: long simulations lock in wrongly from a poor
start. Chosen.
"""
WINDOW_SAMPLES = 25
"""[samples] Of a window, and of the pieces over which corrections are summed. Chosen."""
FOLLOWED_ERROR = 0.1
"""[of the outputs' variance] Error up to which a horizon is followed. Chosen."""
BLOCKS, FOLDS = 20, 4
"""Blocks of all records, and of how many one is left out at a time. Chosen."""
BLOCK_SAMPLES, FEWEST_TO_JUDGE = 5, 40
"""[samples] Of a block at least, and of all records, eight blocks: with fewer an effect may follow
every sample. Chosen.
"""
DAMPING = 0.003
"""[of the curvature] Of the step to the values without the blocks left out: nearly undetermined
values would go anywhere. Fitted to refits with masked blocks.
"""
CLIPPED = 8.0
"""[robust spreads] As which a larger error counts: an event that nobody recorded. Chosen."""

FORGETS = 0.3
"""[of its peak] Effect of a first state that may be left at the end of a window. Chosen."""

STIFFEST, COARSE = 16, 2.0
"""Integration steps a sample at most, and times those that were taken from which on they were too
few. Chosen.
"""

STARTS_LOOKED_AT, SHAPES, FOLLOWED_STARTS = 6, 4, 2
"""First values of an effect that are known, those of unlike shape that are tried, and those
that take a step. Chosen.
"""
PROMISING = 0.1
"""[of the curvature] Damping of the step by whose promise first values are ranked: a whole one
promises shifts in time too much. Chosen.
"""
WALKS = (1.0, 1e-2, 1e-4)
"""[of the first guess] Variances of the walk that a balance's unknown term takes, in turn: one that
goes far may carry the states where the model has no value, as of a logarithm. Chosen.
"""
ROWS = 4000
"""[samples] Of the track on which effects are regressed. Chosen."""
RESEMBLES, TOLD_BY_OUTPUTS, COLUMNS_TRIED = 0.05, 0.98, 3
"""Part of what a balance lacks that a column has to explain; of a column that the outputs explain,
which makes it none of its own; and how many are tried. Chosen.
"""
CURVE_KNOTS, MOST_CURVES = 9, 3
"""Of the curves by which a signal is chosen, and how many are tried. Chosen."""

BEAM, DEEPEST = 3, 4
"""Structures that go on to the next level, and effects at most. Chosen."""
TURNS = 2
"""Of the input timing, where what was found suits the other one: the first may have been turned by
a wrong effect. Chosen.
"""
EXCHANGED, EXCHANGED_IN_NOISE = 3, 2
"""Effects from which on each is tried to be exchanged for another: of two, each was tried
alone, but not in nats. Chosen.
"""
FOLLOWED, FULLY_FITTED = 14, 8
"""Candidates of each kind of quick fit that take two further steps, and those that are fitted fully
after them at a level. Chosen.
"""
PAIRS_FITTED, EACH_IN_PAIRS = 6, 2
"""Pairs of effects that are fitted where none joins alone, and in how many of them an effect may
be. Chosen.
"""
PAIR_DAMPING = 1e-4
"""[of the curvature] Damping of the step by which pairs are ranked: what gains together only is
nearly collinear with what stood for it. Chosen.
"""
QUICKLY_FITTED, LONG_RECORDS = 2000, 6000
"""[samples] Of a quick fit on short windows, and of the records up to which they are taken whole,
too. Chosen.
"""
BLIND = 0.5
"""[of the mean over all windows] Of their errors above the least, below which windows chosen evenly
are not taken. Chosen.
"""
KEPT = 20
"""Candidates of the first level that are tried again beside others. Chosen."""
ABSURD = 100.0
"""Times all its first values at which a value is refused; small ones go a hundred times further.
Chosen.
"""
RAN_OFF = 1e4
"""Times its value as it was given at which a model's own value ran off. Chosen."""

USUAL_SHARE = 0.1
"""Share of the counted machines of a kind that lacked an effect from which on it is usual.
Chosen.
"""
OCCASIONAL, RARE = 0.5, 1.0
"""[parameters] For which an effect counts besides its own that few of the machines lacked, and one
that none did. Chosen.
"""

WEAKEST = 0.1
"""[of the largest] As what the error of an output counts at least: one that is followed well has a
vote. Chosen.
"""
MERITLESS = 0.02
"""[of a block's mean power] That is no merit of any structure. Chosen."""
SMALL, WORTH = 0.0004, 0.1
"""Shares of the first error's power that are nothing (2 % of its RMS: beside a first model far off,
more is little), and of what is left that an effect has to take away. Chosen.
"""
NEAR_NOISE = 100.0
"""[of the noise's power] Up to which of next to nothing that is left more is sought: all of it may
be noise. Chosen.
"""
REAL = 2.5
"""[standard errors over blocks] By which what an effect takes away stands above chance. Calibrated
on complete machines.
"""

NOISY, UNEVEN = 1.3, 7.0
"""Times its own noise that an error may be, and times the scatter of noise that its blocks may
have, to be noise. Chosen.
"""
SAME_NOISE = 0.1
"""Difference of whitening coefficients, and part of the weights, up to which two noises are one.
Chosen.
"""
WHITENING = 12
"""[coefficients] Of the whitening autoregression at most. Chosen."""
TIE = 3.0
"""[nat] That cannot tell two structures apart: odds of twenty. Chosen."""
ONE_PHYSICS = 0.9
"""[of what the general effect takes away] From which on its special case is told beside it: a loss
with and without a bend is one loss. Chosen.
"""
TWICE = 1.4
"""[standard errors] The same as the next where noise alone is left: an effect may show in two
places. Chosen.
"""
EVERYWHERE, PIECES = 2.0, 8
"""[standard errors] By which corrections go along with the errors over pieces: not in one place
alone; and the fewest pieces, for of four the largest number of standard errors is two. Chosen.
"""

KNOTS_BY_AXIS: Mapping[str, int] = {
    "velocity": 17,
    "position": 17,
    "current": 9,
    "temperature": 9,
    "level": 9,
    "time": 17,
}
"""Axes of the free term, and how many hat functions stand on each. Chosen."""

FORMULA_TERMS = 3
"""Functions that a formula of the free term has at most. Chosen."""

UNKNOWN_LEADS = 0.5
"""Probability of something without a name from which on the verdict is that."""
PLAINLY_A_PART = 0.7
"""[of what stood above the noise] Below which what effects take away is a part, where something
structured is left. Chosen.
"""
DOUBTED = 0.3
"""Probability of something without a name beside effects that took a part, or act when nobody
recorded. Chosen.
"""
MOST_RIVALS, LISTED = 40, 6
"""Structures, the best ones, among which a draw is decided, and candidates of a step that are told.
Chosen.
"""
DRAWS = 400
"""Of the blocks, by which probabilities are counted."""
MOST_EFFORT = 2_000_000_000
"""[samples] Of a search. Chosen."""

HELD_REACH = 0.3
"""[of its value] Within which a held parameter is sought. Chosen."""
FOREIGN_LOOKED_AT, FOREIGN_DOUBTED = 100, 3
"""Parameters of an FMU whose answers are simulated, the first of its description, and those that a
search may doubt. Chosen.
"""
ANSWER_STEP = 1e-3
"""[of its value] By which one of them is moved for its slopes. Chosen."""
SECANTS = 3
"""In turn, each over the step that the one before asks for. Chosen."""

SENSOR_NOISE = 0.01
"""[of its signal's RMS] Plausible noise of a sensor that is not there yet. Chosen."""
DISTINCTION_LEVEL = 0.01
"""Of the test that a proposed experiment is to pass. Chosen."""
WORTH_SEPARATING = 0.02
"""Probability from which on a candidate is worth an experiment against the leading one. Chosen."""
MOST_PROPOSALS = 4
"""Experiments that are proposed. Chosen."""
POWER_WANTED, MOST_TIMES = 0.9, 100
"""Power that more of the same data is to reach, and times as much of them at most that is proposed.
Chosen.
"""
