"""Kernels: the compiled form of a model's structure, kept on disk so that only the first use of a
structure compiles.

The key of a kernel is a digest of the model's structure (balances, effects, paths; not parameter
values, bounds or units), of this package's own sources and of the processor. Its names are written
once to the cache folder (`$RESIDUUM_CACHE`, else `~/.cache/residuum`); a warm start therefore
neither composes symbolically nor compiles. Machine code is kept beside them by its text, which
names nothing of a model: structures share what is alike in them.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from threading import Lock
from typing import TYPE_CHECKING, Any

import numpy as np

from residuum.code_digest import code_digest
from residuum.code_folder import code_folder
from residuum.identification.physics.compile import machine_code
from residuum.identification.physics.compile.machine_code import FUNCTIONS, STEPPING
from residuum.identification.physics.simulate.integration import System

if TYPE_CHECKING:
    from residuum.identification.physics.model import PhysicalModel

_LOADED = (*FUNCTIONS, *STEPPING)
_MADE_BY = "residuum.identification.physics"
_MAKING = Lock()
EXTERNAL_TEXT = "external_{library}_{k}({arguments})"
"""How the text of an expression writes value k of a library."""
_CALLED = re.compile(r"\bexternal_([0-9a-f]+)_\d+\(")
_COUNTED = ("sizes", "surfaces", "delays", "own", "remembered")


@dataclass(frozen=True, eq=False)
class Kernel:
    """A structure's compiled equations and the names of what they are about, in their order."""

    states: tuple[str, ...]
    parameters: tuple[str, ...]
    outputs: tuple[str, ...]
    signals: tuple[str, ...]
    deviating: tuple[str, ...]
    system: System


def kernel_of(model: PhysicalModel) -> Kernel:
    """The compiled kernel of the model's structure, from memory, from disk, or newly generated."""
    return kernel_of_structure(_structure(model), _Deferred(model))


def cache_folder() -> Path:
    """Where generated kernels are kept: in `$RESIDUUM_CACHE`, else `~/.cache/residuum`; this user's
    alone.
    """
    return code_folder("kernels", "RESIDUUM_CACHE")


class _Deferred:
    """A model that does not take part in a cache's key (the structure does)."""

    def __init__(self, model: PhysicalModel) -> None:
        self.model = model

    def __hash__(self) -> int:
        return 0

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Deferred)


@lru_cache(maxsize=256)
def kernel_of_structure(structure: str, deferred: _Deferred) -> Kernel:
    """The kernel of a structure, of which `deferred` is one model."""
    # A structure of this process first (`lru_cache`), then one on disk, then a new one.
    path = _place("kernel", structure)
    with _MAKING:  # what several threads ask for at once is made once
        manifest = _manifest_on_disk(path) or _new_manifest(path, deferred.model)
    code = [(path.parent / part).read_bytes() for part in manifest["parts"]]
    # Linked for this process: machine code knows no addresses until then.
    functions: Mapping[str, Any] = dict(
        zip(_LOADED, machine_code.loaded(code, _LOADED, _imported(structure)), strict=True)
    )
    numbers: Mapping[str, Any] = {key: np.array(manifest[key], dtype=np.int64) for key in _COUNTED}
    names = {
        key: tuple(manifest[key])
        for key in ("states", "parameters", "outputs", "signals", "deviating")
    }
    return Kernel(**names, system=System(**functions, **numbers))


def _imported(structure: str) -> Mapping[str, int]:
    """Functions of the library that a structure calls: code on disk names only their symbols."""
    called = _CALLED.search(structure)
    return {} if called is None else machine_code.LIBRARIES[called[1]]


def _place(kind: str, content: str) -> Path:
    """Where what is made of `content` is kept."""
    # Code made by other sources, or for another processor, must not be found.
    key = content + machine_code.target() + code_digest(_MADE_BY)
    return cache_folder() / f"{kind}_{hashlib.sha256(key.encode()).hexdigest()[:24]}"


def _manifest_on_disk(path: Path) -> dict[str, Any] | None:
    """What a kernel's file says; None where it, or code that it names, is not on disk."""
    if not path.exists():
        return None
    manifest: dict[str, Any] = json.loads(path.read_bytes())
    # A cleaner of caches may have taken some of the files.
    return manifest if all((path.parent / part).exists() for part in manifest["parts"]) else None


def _new_manifest(path: Path, model: PhysicalModel) -> dict[str, Any]:
    """A kernel's file and its code, written. SymPy is imported here: where all kernels are on disk
    it is not needed.
    """
    from residuum.identification.physics.compile.code_generation import (  # noqa: PLC0415
        generate,
        names_of,
    )
    from residuum.identification.physics.compile.composition import compose  # noqa: PLC0415

    equations = compose(model)
    manifest = names_of(equations) | {"parts": [_compiled(text) for text in generate(equations)]}
    _write(path, json.dumps(manifest).encode())
    return manifest


def _compiled(assembly: str) -> str:
    """The name of the file of a module's machine code, which is compiled where it is not on
    disk.
    """
    path = _place("code", assembly)
    if not path.exists():
        _write(path, machine_code.compiled(assembly))
    return path.name


def _structure(model: PhysicalModel) -> str:
    balances = []
    for b in model.balances.values():
        terms = [(name, term.text) for name, term in b.terms.items()]
        variables = sorted(b.variables.items())
        balances.append((b.name, b.kind, b.storage.text, b.start, terms, variables))
    effects = [(use.id, use.target, use.instance, use.fingerprint) for use in model.effects]
    inputs = [
        # A default matters where it stands in the equations: where the input is absent, or a clock.
        (i.name, (i.absent or i.is_clock) and i.default, i.unit)
        for i in model.inputs.values()
    ]
    states = [(s.name, s.rate, s.unit) for s in model.states.values()]
    outputs = [(o.name, o.value.text) for o in model.outputs.values()]
    defined = sorted((name, definition.text) for name, definition in model.definitions.items())
    return repr((inputs, states, list(model.parameters), balances, outputs, effects, defined))


def _write(path: Path, content: bytes) -> None:
    """Write so that another process sees the whole file or none."""
    handle, name = tempfile.mkstemp(dir=path.parent, suffix=".part")
    with os.fdopen(handle, "wb") as file:
        file.write(content)
    # Atomic within a folder: a reader finds the old file, or the whole new one.
    os.replace(name, path)
