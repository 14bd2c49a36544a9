"""Every number that windows are judged by: its unit in brackets (none: a ratio or a count), its
meaning, and what set it.
"""

FEWEST_WINDOWS, CUT_INTO = 6, 20
"""Healthy windows at least, and windows that few long records are cut into. Chosen."""
FEWEST_IN_A_WINDOW = 60
"""[samples] Of a healthy window. Chosen."""
OPEN = 0.3
"""[of its value] Standard deviation over all healthy windows from which on a value is undetermined.
Chosen.
"""
WIDE = 0.5
"""[of its value] Standard deviation of the prior on a value that a window is asked for by itself.
Chosen.
"""
RIDGES = (256.0, 64.0, 16.0, 4.0, 1.0, 0.1)
"""How little a value depends on the kind of run, the least dependence first; chosen by evidence."""
EVIDENT = 1.0
"""[nat] By which the evidence has to rise for more dependence. Chosen."""
EM_STEPS = 200
"""Of the mean and scatter of values that windows tell unequally well. Chosen."""
STILL = 0.05
"""[of its size] As what the spread of a feature counts at least, and below which a signal stands.
Chosen.
"""

SEARCHED, CALIBRATED = 1, 8
"""Healthy windows in which missing physics is sought, and in which every hypothesis is tried.
Chosen.
"""
SEARCH = 1e9
"""[samples] Of work in one such search. Chosen."""
NO_ERROR = 1e-3
"""[of the error over all windows] An error in one of them that is none. Chosen."""
ALWAYS = 3.0
"""[standard errors over windows] By which the error has to fall in them for an effect to be missing
physics. Chosen.
"""

SCREENING_STEPS, FIT_STEPS = 2, 8
"""Gauss-Newton steps by which a hypothesis is screened, and of a fit. Chosen."""
HYPOTHESES_FITTED = 14
"""Hypotheses that are fitted after screening. Chosen."""
PAIRED, PAIR_STEPS, FITTED_PAIRS = 6, 5, 4
"""Likeliest hypotheses of which pairs are looked at where one alone leaves too much, Gauss-Newton
steps by which a pair is screened, and pairs that are fitted. Chosen.
"""
SHAPES_LOOKED_AT = 4
"""First shapes of an effect that are looked at. Chosen."""
FIRST_SIZE = 0.1
"""[of the catalogue's first size] With which an effect begins: the fit finds its size. Chosen."""
NO_MERIT = 0.05
"""[of healthy power] Error power in a block less than which is no merit. Chosen."""
SETTLED = 1e-4
"""[of the cost] Fall of a step at which a descent ends. Chosen."""
KNOTS = 6
"""Of an unknown load that changes slowly over a window. Chosen."""

GRID, PARTS, ONSETS_FOLLOWED, WINDOW_PARTS = 16, 4, 4, 100
"""Beginnings of what sticks; coarse beginnings of all else, how many are followed further, and the
parts of a window at the end. Chosen.
"""
UNEXPLAINED = 4.0
"""[standard deviations] Of error power above the usual from which on one cause is not enough.
Chosen.
"""
LEAST_UNKNOWN = 0.1
"""Probability of `unknown` at least where error is left. Chosen."""

LOST_READING = 8.0
"""[robust spreads] Of an error from which on a reading may have been lost. Chosen."""
LEAST_EXCITED = 0.03
"""[of a healthy window's] Information on some value that a window needs. Chosen."""
SHORTEST = 0.25
"""[of a healthy window] Length under which a window is too short. Chosen."""
COMPLETE = 0.5
"""[of a healthy window] Length beyond which the longest stretch without a hole stands for a window
with holes. Chosen.
"""
CAUSES_LISTED = 12
"""Causes that an answer lists at most. Chosen."""
VISIBLE_POWER = 0.9
"""Probability with which the smallest visible change of a baseline is found. Chosen."""
LEARNED_FALSELY = 0.01
"""Probability with which healthy windows are refused as a new baseline. Chosen."""
APART = 1e-3
"""Probability, over all windows, with which a healthy window is said to stand apart from the
others. Chosen.
"""
