"""Effects of electric circuits."""
