"""Packages of extras, imported when a record needs them."""

from importlib import import_module
from pathlib import Path
from typing import Any

from residuum.identification.errors import BadRecord


def need(package: str, path: str | Path, extra: str = "formats") -> Any:
    """The imported `package`; BadRecord says how to get it when it is absent."""
    try:
        return import_module(package)
    except ImportError:
        raise BadRecord(
            f"{path}: this format needs {package!r}: pip install 'residuum[{extra}]'"
        ) from None
