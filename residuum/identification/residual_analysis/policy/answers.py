"""What is said of an error?"""

PREDICTED_SAMPLES = 2000
"""[samples] Of which errors of prediction are told. Chosen."""
HORIZONS = (1, 10, 100)
"""[samples] Ahead of which they are."""
LOCATION_BINS = 24
"""Of an axis along which an error is located. Chosen."""
FEWEST_IN_A_BIN = 12
"""[samples] Chosen."""
LOCATION_SCORE = 10.0
"""[2 nat] Likelihood ratio that a region has to exceed, beside twice the logarithm of the number of bins. Chosen."""
WIDEST_REGION = 0.7
"""Part of the samples that a region may hold. Chosen."""
ONE_WAY = 4.0
"""Ratio of an error's power in the two directions of movement from which on it is one direction's. Chosen."""
STANDSTILL_REGION = 0.2
"""Part of an axis's largest value within which a region around zero is a standstill's. Chosen."""
STANDSTILL_SPEED = 0.02
"""Part of the largest speed up to which there is no direction. Chosen."""
MOST_REGIONS = 8
"""Regions that are told. Chosen."""
