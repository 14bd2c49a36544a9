"""Limits, each with the false-alarm rate that it promises."""
