"""Simulation, Kalman filter and smoother of compiled models."""
