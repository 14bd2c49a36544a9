"""How far a plant may be from its identified model: errors of drawn models, what lies above them,
and its certificate.
"""
