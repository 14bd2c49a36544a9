"""Structures: a model with some effects, its likelihood, its estimate, and how two of them compare."""
