"""Synthesis of controllers of fixed and full order."""
