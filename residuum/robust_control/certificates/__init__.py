"""Certificates: norms and margins computed anew from the closed loop."""
