"""Every number that an answer is decided by beside the search: its unit in brackets (none: a ratio
or a count), its meaning, and what set it.
"""

from residuum.identification.physics import Settings

OTHER_VALUE = 2.0
"""[standard errors] From which on a value is another than the file's. Chosen."""
FORMULA_TERMS = 3
"""Functions that a formula of the free term has at most. Chosen."""
KEPT_RISE = 1.002
"""Factor of the error on data kept aside above which an effect is not kept. Chosen."""
EXPLAINING_TIME = 0.5
"""Part of the seconds that a user gives an improvement which the search gets; the rest is for what
it names. Chosen.
"""
STATES_ALONE = Settings(iterations=20, tolerance=1e-4)
"""How first states are estimated on data kept aside. Chosen."""
