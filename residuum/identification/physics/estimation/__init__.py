"""Parameters from records."""
