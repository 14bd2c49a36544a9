"""Does an effect join?"""

import math

ACCEPT = 3.0
"""[nat] Evidence above the logarithm of the number of candidates at which an effect joins: odds of 20 to 1."""
ACCEPT_MORE = 6.0
"""[nat] The same of a second and third effect, which must not make up for what the first does not follow exactly: 400 to 1."""
ALIKE = 4.0
"""[nat] Structures whose log evidence differs by less cannot be told apart by the experiment: odds of 55 to 1."""
TEMPERING_BLOCKS = 100
"""Blocks of time over which the variance of a gain is measured. Chosen."""
OUT_OF_BOUNDS = math.log(100.0)
"""[nat] By which what is no estimate stands below the preferred one at least. Chosen."""

WORTH_A_LOOK = 1.02
"""Factor by which the outputs' errors may rise, in the mean of their logarithms, with an effect that is looked at. Chosen."""
FIRST_RISE = 1.005
"""The same with the first effect that joins. Chosen."""
LATER_FALL = 0.99
"""And factor to which they have to fall with a later one, or where they are slow; less is enough where the gain is plain.
Chosen."""
READING_FALL = 0.95
"""Factor to which the error has to fall at least with an effect of the reading alone, or where it is the reading's. Chosen."""
OF_THE_READING = 3.0
"""Times the mean square that the steps of a reading hide up to which a mean square error is the reading's. Chosen."""
PLAINLY_LESS = 0.7
"""Share of the held-out errors to which an effect that few moments speak for has to take them. Chosen."""
PLAIN_GAIN = 100.0
"""[nat] That it has to gain, and from which on a gain is plain. Chosen."""
EXCHANGES = 3
"""How often at most effects that were accepted one by one are exchanged for others that do more together. Chosen."""
DRIFT_SHARE = 0.2
"""Share of the error that is left by what was found to which an unknown load has to take it to be believed. Chosen."""

HELD_STANDARD_DEVIATIONS = 5.0
"""By which it has to be. Chosen."""
MOST_HELD = 2
"""Values that are doubted at most. Chosen."""

KEPT_RISE = 1.002
"""Factor of the held-out error above which an effect is not kept. Chosen."""
KEPT_SHIFT = 0.9
"""The same of a shift in time by less than a sample. Chosen."""
STRANGE = 1.25
"""Times the error of the rest above which, at any output, something happens on data kept aside that the rest does not know.
Chosen."""
PLAIN_SHIFT = 4.0
"""Standard deviations from zero at which a shift in time must lie to stay in a model. Chosen."""
MOST_TOGETHER = 8
"""Choices among effects that cannot be told apart that are tried together at most. Chosen."""
FAR_FROM_NOISE = 15.0
"""Times its innovations beyond which blocks are asked before an exact structure, for the error of the model as it is. Chosen."""
FAR_ABOVE_SENSORS = 10.0
"""Times the noise floor of the records from which on what an exact structure leaves is not all noise, and blocks kept aside are
asked. Chosen."""
EXACT_WORK = 400_000_000
"""[samples] In which an exact structure has to be found. Chosen."""
EXACT_TIME = 0.4
"""Part of the seconds that a user gives in which it has to be found. Chosen."""
EXPLAINING_TIME = 0.5
"""Part of the seconds that a user gives an improvement which `explain` gets; the rest is for estimating what it names. Chosen."""
