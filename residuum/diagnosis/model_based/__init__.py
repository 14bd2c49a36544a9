"""Watching any machine that has a model: what is healthy, whether a window differs, from which cause and by how much."""
