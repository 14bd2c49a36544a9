"""Packages that the library uses where they are there: Plotly, pandas, xarray, python-control."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from residuum.identification.errors import BadInput


# Both classes, for code that tries an import and for doors that print a refusal.
class MissingPackage(BadInput, ImportError):
    """An optional package is not installed; the message says what needs it and how to get it.

    >>> import residuum as rs
    >>> raise rs.MissingPackage("plotly: …")
    Traceback (most recent call last):
        ...
    residuum.library.optional_package.MissingPackage: plotly: …
    """


def need(package: str, purpose: str, extra: str = "notebook") -> Any:
    """The imported `package`, for `purpose`.

    Raises
    ------
    MissingPackage
        It is not installed.

    >>> need("no_such", "a picture")
    Traceback (most recent call last):
    residuum.library.optional_package.MissingPackage: a picture needs the package 'no_such': pip install 'residuum[notebook]'
    """
    try:
        return import_module(package)
    except ImportError:
        # Of `matplotlib.figure` the part that pip knows.
        name = package.split(".", maxsplit=1)[0]
        raise MissingPackage(
            f"{purpose} needs the package {name!r}: pip install 'residuum[{extra}]'"
        ) from None
