"""What turns with the shaft: speed, angle, rounds, and clocks brought together."""
