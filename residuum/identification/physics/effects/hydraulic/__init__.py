"""Effects of liquid volumes."""
