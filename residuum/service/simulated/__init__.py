"""The simulated machines as devices on real buses."""
