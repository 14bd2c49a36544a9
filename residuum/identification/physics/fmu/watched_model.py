"""An FMU as the model that a machine is watched by: its parameters can be moved, and it travels in a
baseline, its bytes and a text that names it.

Whoever reads such a baseline runs its code: `permission` says where that is allowed.
"""

from __future__ import annotations

import atexit
import hashlib
import shutil
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass, replace
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import Any

from residuum.identification.errors import BadModel
from residuum.identification.physics.effects.base import Parameter
from residuum.identification.physics.fmu.description import Description, describe
from residuum.identification.physics.fmu.fmu_model import exchange_model, names_of
from residuum.identification.physics.fmu.instance import instance_of
from residuum.identification.physics.fmu.loaded_library import library_of
from residuum.identification.physics.fmu.parameter_file import (
    Named,
    named_in,
    parameter_of,
    settable,
    text,
)
from residuum.identification.physics.fmu.parameters import ExchangedParameters
from residuum.identification.physics.fmu.permission import check_size
from residuum.identification.physics.foreign import Foreign
from residuum.identification.physics.model import EffectUse, PhysicalModel
from residuum.identification.physics.simulate.differences import Step


def exchanged_model(
    described: Description,
    parameters: Mapping[str, Parameter],
    effects: Sequence[EffectUse] = (),
    held: Mapping[str, float] = MappingProxyType({}),
) -> PhysicalModel:
    """The model of an FMU with model exchange, of which these parameters can be moved; others are
    `held` at values.
    """
    free = tuple(name for name, parameter in parameters.items() if not parameter.fixed)
    library = library_of(instance_of(described), free)
    physical = exchange_model(library, parameters)
    foreign = ExchangedParameters(library, frozenset(parameters), held)
    return replace(physical, effects=tuple(effects), foreign=foreign)


def watched_model(named: Named) -> PhysicalModel:
    """The model that a machine is watched by: an FMU with the values that it was given and effects,
    of which those are followed from window to window that are not fixed.

    Raises
    ------
    BadModel
        An FMU that can only simulate itself.
    """
    described = named.described
    if not described.is_exchangeable:
        raise BadModel(
            f"model {described.path!r}: this FMU can only simulate itself, from its own start"
            " (co-simulation alone, or events): a window begins anywhere; export it for model"
            " exchange and without events, or watch by a model file"
        )
    return named.with_effects(exchanged_model(described, named.parameters))


def declaring(model: PhysicalModel, names: Sequence[str]) -> PhysicalModel:
    """The model of an FMU with these parameters of it among its own; BadInput for one that it has
    not.
    """
    assert model.foreign is not None
    described = model.foreign.description
    new = [name for name in names if name not in model.all_parameters]
    own = {name: parameter_of(settable(described, name)) for name in new}
    return exchanged_model(described, {**model.parameters, **own}, model.effects)


@dataclass(frozen=True)
class WatchedFmu:
    """An FMU as a baseline holds it.

    Attributes
    ----------
    content : bytes
        The whole file, with the libraries of all its platforms.
    steps : mapping of name to Step
        With which slopes by its parameters are differences.
    """

    content: bytes
    steps: Mapping[str, Step]

    @classmethod
    def of(cls, foreign: Foreign[Any]) -> WatchedFmu:
        """That of a model; BadModel where it is too large."""
        check_size(foreign.file, foreign.description.path)
        return cls(foreign.file.read_bytes(), foreign.steps)

    @property
    def said(self) -> dict[str, Any]:
        """What is written of it beside its bytes."""
        steps = {name: list(astuple(step)) for name, step in self.steps.items()}
        return {"sha256": hashlib.sha256(self.content).hexdigest(), "steps": steps}

    @classmethod
    def read(cls, content: bytes, said: Mapping[str, Any], source: str) -> WatchedFmu:
        """As it was stored in the file `source`; nothing of it is run. BadModel where it is not the
        one that was stored.
        """
        if hashlib.sha256(content).hexdigest() != said["sha256"]:
            raise BadModel(f"{source}: the FMU in it is not the one that it was trained with")
        steps = {
            name: Step(float(relative), float(size), float(error), bool(one_sided))
            for name, (relative, size, error, one_sided) in said["steps"].items()
        }
        return cls(content, steps)

    def model(self, written: str, source: str) -> PhysicalModel:
        """The model that a text makes of it: loads its library."""
        physical = watched_model(named_in(written, source, describe(_at_hand(self.content))))
        foreign: Any = physical.foreign
        foreign.steps = self.steps
        return physical


def watched_content(content: bytes, name: str) -> PhysicalModel:
    """The model that a machine is watched by, of an FMU that is stored by this name; its library is
    loaded. BadModel as `watched_model`.
    """
    described = replace(describe(_at_hand(content)), name=name)
    return replace(watched_model(Named(described)), name=name)


def signals_of(content: bytes) -> tuple[str, ...]:
    """Names of the inputs and outputs of an FMU that is stored; nothing of it is loaded."""
    _, inputs, outputs = names_of(describe(_at_hand(content)))
    return (*inputs, *outputs)


def _at_hand(content: bytes) -> Path:
    """A file with it, while this process lives."""
    file = _folder() / f"{hashlib.sha256(content).hexdigest()[:16]}.fmu"
    if not file.exists():
        file.write_bytes(content)
    return file


@cache
def _folder() -> Path:
    """Where FMUs of baselines lie while this process lives."""
    folder = tempfile.mkdtemp(prefix="residuum-watched-")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return Path(folder)


def written(model: PhysicalModel) -> str:
    """The text of a model file of a watched FMU, its values and effects."""
    assert model.foreign is not None
    described = model.foreign.description
    return text(described, model.parameters, model, Path(described.path).parent)
