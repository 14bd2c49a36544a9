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
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

from residuum.identification.errors import BadModel
from residuum.identification.physics.effects.base import Parameter
from residuum.identification.physics.fmu.description import Description, describe
from residuum.identification.physics.fmu.fmu_model import exchange_model
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
from residuum.identification.physics.foreign import Foreign
from residuum.identification.physics.model import EffectUse, PhysicalModel
from residuum.identification.physics.simulate.differences import Step

LARGEST = 64 << 20
"""Bytes of an FMU that a baseline holds: more is data, or libraries for platforms that no machine
of the plant has.
"""


def exchanged_model(
    described: Description,
    parameters: Mapping[str, Parameter],
    effects: Sequence[EffectUse] = (),
) -> PhysicalModel:
    """The model of an FMU with model exchange, of which these parameters can be moved."""
    free = tuple(name for name, parameter in parameters.items() if not parameter.fixed)
    library = library_of(instance_of(described), free)
    physical = exchange_model(library, parameters)
    return replace(physical, effects=tuple(effects), foreign=ExchangedParameters(library))


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
        size = foreign.file.stat().st_size
        if size > LARGEST:
            raise BadModel(
                f"model {foreign.description.path!r}: has {size >> 20} MiB; a baseline holds its"
                f" FMU, of at most {LARGEST >> 20} MiB: export it without data and sources, for"
                " the platforms that judge"
            )
        return cls(foreign.file.read_bytes(), foreign.steps)

    @property
    def said(self) -> dict[str, Any]:
        """What is written of it beside its bytes."""
        steps = {name: [step.relative, step.size, step.error] for name, step in self.steps.items()}
        return {"sha256": hashlib.sha256(self.content).hexdigest(), "steps": steps}

    @classmethod
    def read(cls, content: bytes, said: Mapping[str, Any], source: str) -> WatchedFmu:
        """As it was stored in the file `source`; nothing of it is run. BadModel where it is not the
        one that was stored.
        """
        if hashlib.sha256(content).hexdigest() != said["sha256"]:
            raise BadModel(f"{source}: the FMU in it is not the one that it was trained with")
        steps = {name: Step(*map(float, step)) for name, step in said["steps"].items()}
        return cls(content, steps)

    def model(self, written: str, source: str) -> PhysicalModel:
        """The model that a text makes of it: loads its library."""
        file = _folder() / f"{hashlib.sha256(self.content).hexdigest()[:16]}.fmu"
        if not file.exists():
            file.write_bytes(self.content)
        physical = watched_model(named_in(written, source, describe(file)))
        foreign: Any = physical.foreign
        foreign.steps = self.steps
        return physical


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
