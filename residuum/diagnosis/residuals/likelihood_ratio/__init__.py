"""Generalised likelihood ratio over windows of a residual."""
