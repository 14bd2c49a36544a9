"""Loads, springs and position-dependent forces."""
