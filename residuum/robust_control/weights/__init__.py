"""Performance weights and reference models."""
