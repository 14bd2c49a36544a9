"""Model or signal → Finding."""
