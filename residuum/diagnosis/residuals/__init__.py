"""Residuals: their generators, their statistics, and what a fault in them looks like."""
