"""Model files: YAML text to a checked physical model."""
