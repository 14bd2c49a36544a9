"""Watched machines: from buses to stored findings."""
