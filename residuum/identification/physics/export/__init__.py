"""Models as source code for other tools: one file a target; `EXPORTS` lists them."""

from collections.abc import Callable, Mapping
from types import MappingProxyType

from residuum.identification.physics.export.c_source import c_source
from residuum.identification.physics.export.explicit_model import ExplicitModel, explicit
from residuum.identification.physics.export.matlab_source import matlab_source
from residuum.identification.physics.export.modelica_source import modelica_source
from residuum.identification.physics.export.python_source import python_source

EXPORTS: Mapping[str, Callable[[ExplicitModel], str]] = MappingProxyType(
    {"c": c_source, "python": python_source, "matlab": matlab_source, "modelica": modelica_source}
)
"""Target → the text that holds the model there."""

__all__ = ["EXPORTS", "ExplicitModel", "explicit"]
