"""Frictions and drags."""
