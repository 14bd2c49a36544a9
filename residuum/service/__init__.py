"""The service: thin, no mathematics."""
