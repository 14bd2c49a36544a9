"""What a model leaves: its size, its noise, its structure, and where it lies."""
