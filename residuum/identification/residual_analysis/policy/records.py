"""Which samples are used, and how are records cut?"""

SHORTENED = 3
"""Times the innovations wanted from which on only the liveliest stretches of a record are used. Chosen."""
NORMAL_MEDIAN = 0.6745
"""Median of |z| of a standard normal z: a spread that outliers do not move is the median over this."""
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
"""Part of the peak effect of a first state that is there at the end where a plant integrates; what forgets within two records'
length (a furnace) shows more as a whole. Chosen."""
WINDOWS = 25
"""Into which the record of a plant that integrates is cut. Chosen."""
SHORTEST_PREDICTED, LONGEST_PREDICTED = 80, 1200
"""[samples] Of those. Chosen."""
TRAINING_SHARE = 0.7
"""Part of a record that estimates; the rest is kept aside. Chosen."""
STANDS_STILL = 0.2
"""Part of a channel's standard deviation in the record under which it stands still in a part of it. Chosen."""
COARSE_REPEATS = 0.5
"""Share of the samples that repeat the one before where an output is read in coarse steps. Chosen."""
COARSE_EVENNESS = 1e-3
"""Part of a step by which a change may differ from a whole number of steps. Chosen."""

ENOUGH_SAMPLES, LOST = 5000, 1e-6
"""[samples] Of all records, above which a lower rate may do; and the part of the first error's power that it may lose: next to
nothing of what is left at the end. Chosen."""
FEWEST_AT_A_RATE = 100
"""[samples] That a lower rate leaves of each record. Chosen."""
