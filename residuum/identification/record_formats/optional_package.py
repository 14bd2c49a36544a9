"""Packages of the extra `formats`, imported when a file needs them."""

from importlib import import_module
from pathlib import Path
from typing import Any

from residuum.identification.errors import BadRecord


def need(package: str, path: str | Path) -> Any:
    """The imported `package`; BadRecord says how to get it when it is absent."""
    try:
        return import_module(package)
    except ImportError:
        raise BadRecord(
            f"{path}: this format needs {package!r}: pip install 'residuum[formats]'"
        ) from None
