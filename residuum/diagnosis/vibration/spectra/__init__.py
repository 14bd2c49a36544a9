"""Spectra, bands and envelopes of a vibration."""
