"""Compare a model with measurements: where it fails, which effect is missing, what adding it
does.
"""
