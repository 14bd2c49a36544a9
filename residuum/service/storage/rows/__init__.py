"""Rows of the tables, a noun a file: how they are written, read and checked."""
