"""Kernel-based identification: impulse responses with honest uncertainty."""
