"""Controllers for the target: difference equation, IEC 61131-3 structured text and C, each with its self-test."""

from collections.abc import Callable

from residuum.robust_control.controller_export.c_source import c_source
from residuum.robust_control.controller_export.difference_equation import DifferenceEquation
from residuum.robust_control.controller_export.structured_text import structured_text

__all__ = ["LANGUAGES", "DifferenceEquation", "c_source", "structured_text"]

LANGUAGES: dict[str, Callable[[DifferenceEquation], str]] = {"c": c_source, "st": structured_text}
"""Name on the command line → source text of a difference equation."""
