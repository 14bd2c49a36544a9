"""How far is a structure climbed, and which structures are too far behind?"""

from residuum.identification.physics import Settings

HARDEST_DAMPING = 1e4
"""Levenberg–Marquardt damping at which no step is sought any further."""
CLIMBED = 0.02
"""[nat] A climb ends where a step gains less than this, or promises half of it. Chosen."""
SMALL_STEP = 0.01
"""[nat a innovation] A step that promises less moves none far, and weights stay. Chosen."""
SAME_WAY = 0.9
"""Cosine of the angle between two steps from which on they point the same way. Chosen."""
MOST_STRETCHED = 16.0
"""The most by which a step is stretched along a ridge. Chosen."""
OPTIMISM = 3.0
"""Promised steps by which a climb may lie behind its rival, besides `CLOSE`, to be followed further. Chosen."""
CLOSE = 20.0
"""[nat] Log-likelihood within which structures are close: each may be the likeliest once it is climbed to its top. Chosen."""
FAR_BEHIND = 20.0
"""[nat] Below the base's, after its first-order step, from which on an effect is hopeless beside noise alone. Chosen."""
HOPELESS_NOISE = 100.0
"""[nat] Below the base's, under its noise, from which on no other noise is tried. Chosen."""
SAME = 0.5
"""[nat] Within which two structures are as likely. Chosen."""
HIGHER = 2.0
"""[nat] By which another top, or another order of the effects on a path, is higher. Chosen."""
LOWER_TOP = 100.0
"""[nat] By which a lower top of what sticks and slides can lie behind. Chosen."""
CLIMB_STEPS = 30
"""Steps of a climb at most. Chosen."""
POLISHES = 3
"""Times that a structure is climbed again, while it gains `POLISH_GAIN`. Chosen."""
POLISH_GAIN = 1.0
"""[nat] For which it is. Chosen."""
MUCH_WORSE = 4.0
"""A mean square simulation error that is not promised to come within this factor of its rival's is not followed further.
Chosen."""

VISIBLE_SUBSTEPS = 16
"""[a sample] An effect that asks for more integration steps acts within a tenth of a sample, and cannot be seen in the record."""
COARSER = 2
"""Factor by which an integration may be coarser where it serves a first look alone (a Runge–Kutta step errs by 3e-4)."""
TOKEN_BOUND = 1e-9
"""Positive lower bounds up to which they only keep a parameter from zero."""
NEAR_A_TOKEN = 1e3
"""Times such a bound up to which a parameter lies on it. Chosen."""
FLAT_DIRECTION = 1e-11
"""Directions whose scaled curvature is below this fraction of the largest are left alone: rounding."""
FREE_TERM_RIDGE = 1e-5
"""The same of a free term, up to which it is what the parameters do (a voltage linear in the current, a resistance): their
responses differ by how they are computed alone."""

ROUGH = Settings(iterations=15, tolerance=1e-5)
"""How the model as it is is estimated before its noise is looked at. Chosen."""
STATES_ALONE = Settings(iterations=20, tolerance=1e-4)
"""How first states are estimated on data kept aside. Chosen."""
LEAST_ERROR = Settings(iterations=20, tolerance=1e-4)
"""How the least simulation error is sought whose structure is asked for. Chosen."""
SECOND_START = Settings(iterations=8, tolerance=1e-3, blocks=True)
"""How the second beginning of a climb is sought. Chosen."""
GLIMPSE_STEPS = 4
"""Steps after which a candidate's promise is seen. Chosen."""
AGAIN_STEPS = 4
"""Steps in which a structure is estimated again without the data kept aside. Chosen."""
