"""From identified models to a controller with a guarantee."""
