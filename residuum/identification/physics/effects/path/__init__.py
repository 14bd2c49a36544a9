"""Effects on input and output paths."""
