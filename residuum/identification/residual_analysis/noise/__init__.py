"""Noise of a channel: its floor, its colour, its innovations."""
