"""Which effects are tried, and from where?"""

MOST_EFFECTS = 3
"""Effects that a search for an exact structure accepts. Chosen."""
FEWEST_REFITS = 6
"""Candidates, the most promising to first order, that are estimated in full at each step. Chosen."""
PROMISING_GAIN = 2.0
"""[nat] Gain to first order, or after a glimpse, from which on a candidate promises something. Chosen."""
WORTH_A_PASS = 2.0
"""[nat] Gain or loss from which on a second pass, with the noise of the first, may matter. Chosen."""
FRACTIONS_OF_A_START = (1.0, 0.3, 0.1, 0.03)
"""Of an effect's first size at which it is looked at where it is not smooth at zero. Chosen."""
MOVED_AT_REST = 1e-6
"""Part of the errors by which an effect at rest may change the outputs, by rounding."""
FALLEN = 0.98
"""Share of the base's errors to which a step in white noise has to take them to be followed. Chosen."""
MOST_STARTS = 3
"""Starts of a candidate that are estimated in full, by their first-order gain. Chosen."""
BASE_STEP, SHAPE_STEP = 3.0, 5.0
"""Factors by which a first-order step may move a value of the base, and a start of an effect without a zero. Chosen."""
SMALL_START = 0.01
"""Part of its start at which a size begins that the first-order step put at or below nothing. Chosen."""

MOST_GLIMPSES = 3
"""Candidates with a negative first-order gain that are glimpsed. Chosen."""
SECOND_LOOKS = 2
"""Of them those that are estimated in full. Chosen."""
STARTS_WITH_STATES = 2
"""Starts of an effect with states of its own that are glimpsed. Chosen."""
GENERALISED_SHARE = 0.01
"""Share of the likeliest effect's gain from which on an effect fits well enough to be generalised. Chosen."""

NEAR = 3.0
"""Factor from its nominal value within which a parameter is near. Chosen."""
STRAYED = 20.0
"""Factor from its nominal value beyond which a parameter has strayed too far to go on from there. Chosen."""
HALF_THE_ERROR = 0.5
"""Share of its error that the base is left with at most, where a search begins with what lowers it most. Chosen."""
NEARLY_ALL = 0.1
"""Share of the way to white noise, in logarithms of the error, up to which one effect or two may leave it and end the search.
Chosen."""

PROMISING_PAIRS = 3
"""Pairs of effects that are estimated in full. Chosen."""
PAIR_GAIN = 5.0
"""[nat] By which a pair has to promise more than a single effect that it would replace. Chosen."""

SHOT_LENGTHS = (40, 100, 250, 600)
"""[block means] Of the stretches: the first for the choice of effects, all for following them. Chosen."""
SHOT_SAMPLES = 12_000
"""[samples] Simulated in one shot; of longer records stretches are left out evenly. Chosen."""
SHOT_LEADERS = 3
"""Effects that a second one is tried beside. Chosen."""
SHOT_FOLLOWED = 2
"""Effects, or pairs, that are followed over longer stretches. Chosen."""
SHOT_PRICE = 0.01
"""Fall of an error's logarithm that a parameter must be worth over stretches. Chosen."""
SHOT_SPECIAL_CASE = 0.05
"""The same by which a special case may lie behind. Chosen."""
SHOT_TOLERANCE = 1e-2
"""Relative fall of the cost at which a shot ends. Chosen."""
SHOT_BASE_STEPS, SHOT_TRIAL_STEPS, SHOT_FOLLOWING_STEPS = 8, 4, 15
"""Steps of the model without an effect, of each trial, and of what is followed. Chosen."""
