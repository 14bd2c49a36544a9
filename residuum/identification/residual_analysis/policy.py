"""Every number that residuals are analysed by; each with its unit, its meaning, and what set it."""

import math

import numpy as np

from residuum.identification.physics import Settings

# What is said of an error?

PREDICTED_SAMPLES = 2000
"""[samples] Of which errors of prediction are told. Chosen."""
HORIZONS = (1, 10, 100)
"""[samples] Ahead of which they are."""
LOCATION_BINS = 24
"""Of an axis along which an error is located. Chosen."""
FEWEST_IN_A_BIN = 12
"""[samples] Chosen."""
LOCATION_SCORE = 10.0
"""[2 nat] Likelihood ratio that a region has to exceed, beside twice the logarithm of the number of
bins. Chosen.
"""
WIDEST_REGION = 0.7
"""Part of the samples that a region may hold. Chosen."""
ONE_WAY = 4.0
"""Ratio of an error's power in the two directions of movement from which on it is one direction's.
Chosen.
"""
STANDSTILL_REGION = 0.2
"""Part of an axis's largest value within which a region around zero is a standstill's. Chosen."""
STANDSTILL_SPEED = 0.02
"""Part of the largest speed up to which there is no direction. Chosen."""
MOST_REGIONS = 8
"""Regions that are told. Chosen."""


# Is what a model leaves noise, and what noise?

NOISE_ORDER = 12
"""[coefficients] Of the autoregressive noise. Chosen."""
NOISE_REWEIGHTINGS = 3
"""Turns of iteratively reweighted least squares in which it is estimated. Chosen."""
DRIFT_MEMORY = 1e6
"""[samples] Over which drifting noise forgets: longer than any record, short enough to be
stable.
"""
MEMORY_OF_ALL, MEMORY_OF_THE_LONGEST = 30.0, 5.0
"""Noise remembers over one in so many of all samples, and of the longest record's, at most: what is
slower cannot be told from an error of the model. Chosen.
"""
SHORTEST_MEMORY = 2.0
"""[samples] Over which noise may remember, however short the records. Chosen."""
LARGEST_REFLECTION = 1.0 - 1e-12
"""Reflection coefficient of noise that is still stable."""

FREEDOM = 5.0
"""Degrees of freedom of the t-distributed innovations: loses 7 % of a normal noise's information.
This and the next five are compiled into `noise`, whose compiled files must be deleted where they
change: Numba does not see it.
"""
SCALINGS = 12
"""Turns in which the scale of innovations is sought at most."""
MEDIAN_SQUARE = 0.53
"""Median of e²/s² for t-distributed e of scale s."""
ZERO_INNOVATION = 1e-12
"""Part of their mean square up to which innovations are zero."""
LEAST_SPREAD = 1.0 / 30.0
"""Least part that their squared scale is of their mean square where most are zero, and of what
coarse steps hide. Chosen.
"""
INNOVATION_STRETCH = 1024
"""[samples] Whitened at a time, so that they stay in the cache."""
LOG_DENSITY_AT_ZERO = (
    math.lgamma((FREEDOM + 1.0) / 2.0)
    - math.lgamma(FREEDOM / 2.0)
    - 0.5 * math.log(FREEDOM * math.pi)
)
"""Log density of t-distributed innovations of scale one at zero."""
SLOW = 10.0
"""Times its innovations from which on an error is slow. Chosen."""

LOWEST_FREQUENCY = 0.02
"""[of the sampling rate] Below it an error is taken to be the model's. Chosen."""
UNDER_STRUCTURE = (LOWEST_FREQUENCY, 0.05, 0.1)
"""And where a structured error swings, and reaches further up: of 93 outputs of 62 models that lack
an effect 95 % have a floor within a quarter of the noise, 85 % with the first frequency alone.
"""
BEYOND_NOISE = 6.0
"""Times the noise of its fast part beyond which no error is noise of up to ρ = .995 (at most 5.3 in
600 trials).
"""
BEYOND_NOISE_CHANCE = 1 / 600
"""Bound on how often noise stands there: none in those trials."""
ABOVE_A_DRIFT = 0.05
"""[of the sampling rate] Above it a model's error is its drift's and its steps' tail, a power of
the frequency. Chosen.
"""
DRIFTS = np.concatenate([[0.0], np.geomspace(1e-5, 1e3, 33)])
"""Powers of that tail over the noise's that a spectrum is compared with."""
STILL_LIKELY = 6.0
"""Twice the log-likelihood by which a reading of a spectrum may lie under the best one and still be
believed (p = .014).
"""
AGREED = 1.25
"""Ratio of the largest to the least believed noise up to which it is told as a size. Chosen: the
middle is then within 12 %.
"""
SPECTRUM_SAMPLES, FEWEST_FOR_A_FLOOR = 1024, 64
"""[samples] Of a spectrum at most, and in a row at least. Chosen."""
QUIETEST, LOUDEST_QUIET = 0.1, 0.75
"""Quantiles of the windows' fast power that tell the quietest, and the loudest of the quieter ones.
Chosen.
"""
COLOURS = np.concatenate([np.linspace(0.0, 0.9, 46), 1.0 - np.geomspace(0.1, 0.002, 30)])
"""Correlation ρ of neighbours of the noises that a spectrum is compared with."""

STRUCTURE_LEVEL = 0.01
"""Probability of calling noise of some colour structured. Chosen."""
STRUCTURE_DRAWS = 10
"""Of the null distribution at a time. Chosen."""
MOST_STRUCTURE_DRAWS = 40
"""Of them in all. Chosen."""
RARE_DRAW, ORDINARY_DRAW = 1e-3, 0.2
"""Part of the level below which a p-value is small enough, and p-value above which it is large
enough: more draws would not change the answer.
"""
NOISE_PASSES = 2
"""Turns of least squares and noise beside it. Chosen."""
TEST_SAMPLES = 2000
"""[samples] Of the structured-error test, means over blocks where there are more. Chosen."""
SIGNAL_MEMORIES = (0.0, 0.8, 0.97)
"""Poles of first-order lags of a signal that may predict an error: an error inside a machine
reaches its outputs through the machine's own dynamics. Chosen.
"""
VALUES_ERR = 0.7
"""Ratio of the RMS errors after and before re-estimation below which the parameters' values err:
half of the power.
"""

BINS_OF_AN_AXIS = 20
"""Bins of an axis in which a local error is sought, each with as many samples. Chosen."""
LOCAL_LEVEL = 1e-4
"""False-alarm probability of an output, all axes and places counted (Bonferroni): one finding among
a thousand complete models stands for what noise that is not Gaussian adds.
"""
LOCAL_TIMES_NOISE = 3.0
"""Times the noise of the quiet half of the record at which an error in a bin is worth a word.
Chosen.
"""
FEWEST_FOR_A_PLACE = 200
"""[samples] Of a record below which no place is judged. Chosen."""
COUNTED_IN_A_PLACE = 0.25
"""Part of a bin's samples that count: heavy tails, and noise that a short autoregression does not
whiten, scatter more. Chosen.
"""
LOCAL_OUTLIER = 6.0
"""Standard deviations of the quiet half beyond which a sample counts no more. Chosen."""
REVALUED = Settings(iterations=15, tolerance=1e-4)
"""How it is asked whether the values err. Chosen."""


# Which samples are used, and how are records cut?

SHORTENED = 3
"""Times the innovations wanted from which on only the liveliest stretches of a record are used.
Chosen.
"""
NORMAL_MEDIAN = 0.6745
"""Median of |z| of a standard normal z: a spread that outliers do not move is the median over
this.
"""
OUTLYING_INNOVATION = 4.0
"""Spreads to which innovations are drawn in before an input is held against them. Chosen."""
ANSWER_LAGS = 3
"""[samples] After which a controller answers at most. Chosen."""
ANSWER_SAMPLES = 6_000
"""[samples] Of how many that is asked. Chosen."""
ANSWER_SHARE = 0.05
"""Share of an input's innovations that answers an output's from which on it is feedback. Chosen."""
ANSWER_CERTAIN = 30.0
"""That share times the number of samples (a χ² of one degree of freedom): p = 4e-8. Chosen."""

LASTING = 0.6
"""Part of the peak effect of a first state that is there at the end where a plant integrates; what
forgets within two records' length (a furnace) shows more as a whole. Chosen.
"""
WINDOWS = 25
"""Into which the record of a plant that integrates is cut. Chosen."""
SHORTEST_PREDICTED, LONGEST_PREDICTED = 80, 1200
"""[samples] Of those. Chosen."""
TRAINING_SHARE = 0.7
"""Part of a record that estimates; the rest is kept aside. Chosen."""
STANDS_STILL = 0.2
"""Part of a channel's standard deviation in the record under which it stands still in a part of it.
Chosen.
"""
COARSE_REPEATS = 0.5
"""Share of the samples that repeat the one before where an output is read in coarse steps.
Chosen.
"""
COARSE_EVENNESS = 1e-3
"""Part of a step by which a change may differ from a whole number of steps. Chosen."""

ENOUGH_SAMPLES, LOST = 5000, 1e-6
"""[samples] Of all records, above which a lower rate may do; and the part of the first error's
power that it may lose: next to nothing of what is left at the end. Chosen.
"""
FEWEST_AT_A_RATE = 100
"""[samples] That a lower rate leaves of each record. Chosen."""
