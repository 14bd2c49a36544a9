"""Vibration: bands, envelopes, orders and fault lines."""
