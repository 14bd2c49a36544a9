"""Residuum: condition monitoring for machines that have a model."""
