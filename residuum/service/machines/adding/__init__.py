"""Machines that somebody adds: what their buses say, what is kept of their settings."""
