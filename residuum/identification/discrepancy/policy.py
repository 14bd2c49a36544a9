"""Every number that an answer is decided by beside the search: its unit in brackets (none: a ratio
or a count), its meaning, and what set it.
"""

OTHER_VALUE = 2.0
"""[standard errors] From which on a value is another than the file's. Chosen."""
KEPT_RISE = 1.002
"""Factor of the error on data kept aside above which an effect is not kept. Chosen."""
LEAST_TO_LEARN_FROM = 0.5
"""[of a record kept aside] Samples that the others have at least, for that record to be a test of
what they tell. Chosen.
"""
EXPLAINING_TIME = 0.5
"""Part of the seconds that a user gives an improvement which the search gets; the rest is for what
it names. Chosen.
"""
STATES_ITERATIONS = 20
"""Steps at most in which first states are estimated on data kept aside. Chosen."""
STATES_TOLERANCE = 1e-4
"""Relative fall of the cost at which their estimate ends. Chosen."""
