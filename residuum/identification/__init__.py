"""Data → model, and how far to trust it."""
