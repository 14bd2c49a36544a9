"""Residuals of plants with several inputs and outputs."""
