"""Transmissions: elasticity, play and stops."""
