"""The argument that names a model of balances."""

from typing import Annotated

import typer

ModelSource = Annotated[
    str, typer.Argument(metavar="MODEL", help="A built-in model or a model file.")
]
