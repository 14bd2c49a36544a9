"""SymPy, imported when the first equation is put together.

A kernel that is on disk needs no equations, and the import takes a fifth of a second: effects,
whose parameters are always asked for, write `from residuum.identification.physics.compile import
symbolic as sp`.
"""

from importlib import import_module
from typing import Any


def __getattr__(name: str) -> Any:
    return getattr(import_module("sympy"), name)
