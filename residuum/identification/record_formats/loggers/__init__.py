"""Text files of data loggers: what is understood of them, and the mapping that says it."""
