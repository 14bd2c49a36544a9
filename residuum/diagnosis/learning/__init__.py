"""Classifiers and trends: validation, calibration, storage."""
