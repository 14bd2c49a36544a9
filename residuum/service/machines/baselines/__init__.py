"""Baselines of machines: trained on windows that were healthy, stored, accepted."""
