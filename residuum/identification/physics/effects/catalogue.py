"""EffectCatalogue: effects by id, those of the list and those that a user added."""

from __future__ import annotations

import hashlib
import inspect
import re
import uuid
from collections.abc import Iterator, Mapping
from contextvars import ContextVar
from types import MappingProxyType

from residuum.identification.errors import BadModel
from residuum.identification.physics.effects.base import Effect

_ID = re.compile(r"[a-z][a-z0-9]*(-[a-z0-9]+)*")
_DECLARED = ("title", "equation", "reference", "acts_on")


class EffectCatalogue(Mapping[str, Effect]):
    """Effects by id, in the order of the list; then those that were added, and those that a file
    defines for the work at hand.
    """

    def __init__(self, listed: Mapping[str, Effect]) -> None:
        self._listed, self._added = dict(listed), dict[str, Effect]()
        self._fingerprints: dict[str, str] = {}
        self._here: ContextVar[Mapping[str, Effect]] = ContextVar(
            "effects of this work", default=MappingProxyType({})
        )

    def __getitem__(self, id: str) -> Effect:
        if id in self._listed:
            return self._listed[id]
        local = self._here.get()
        return local[id] if id in local else self._added[id]

    def __iter__(self) -> Iterator[str]:
        yield from self._listed
        yield from {**self._added, **self._here.get()}

    def __len__(self) -> int:
        return len(self._listed) + len({**self._added, **self._here.get()})

    def use_here(self, *effects: Effect) -> None:
        """Put effects that a file defines into the catalogue of this context alone: of this
        command, request or job.

        Raises
        ------
        BadModel
            An id of the list.
        """
        if taken := [effect.id for effect in effects if effect.id in self._listed]:
            raise BadModel(f"effect {taken[0]!r}: the catalogue has one of this id; choose another")
        self._here.set(
            MappingProxyType({**self._here.get(), **{effect.id: effect for effect in effects}})
        )

    def add(self, effect: Effect) -> None:
        """Put an effect of a user's own into the catalogue; an added one of the same id is
        replaced.

        Raises
        ------
        BadModel
            What is no effect, an id of the list, one that is not of small letters, digits and `-`,
            or a class attribute that is missing.
        """
        if not isinstance(effect, Effect):
            raise BadModel(
                f"effect: is {type(effect).__name__}; must be an Effect, or a class of one"
            )
        id = getattr(effect, "id", "")
        if not _ID.fullmatch(id):
            raise BadModel(
                f"effect {type(effect).__name__}: id is {id!r}; must be small letters, digits"
                " and '-'"
            )
        if id in self._listed:
            raise BadModel(f"effect {id!r}: the catalogue has one of this id; choose another")
        if missing := [name for name in _DECLARED if not hasattr(effect, name)]:
            raise BadModel(f"effect {id!r}: class attribute {missing[0]!r} is missing")
        self._added[id], self._fingerprints[id] = effect, _digest(effect)

    def is_here(self, id: str) -> bool:
        """Whether a file defines the effect for the work at hand."""
        return id in self._here.get()

    def fingerprint(self, id: str) -> str:
        """What tells added effects of one id apart in kernels that are kept on disk; empty for
        those of the list.
        """
        local = self._here.get()
        return _digest(local[id]) if id in local else self._fingerprints.get(id, "")


def _digest(effect: Effect) -> str:
    """Of what a file defines, or of the class's source; another one in every process where the
    source cannot be seen.
    """
    if (definition := getattr(effect, "definition", None)) is not None:
        return hashlib.sha256(repr(definition).encode()).hexdigest()[:16]
    try:
        source = inspect.getsource(type(effect)) + repr(sorted(vars(effect).items()))
    except (OSError, TypeError):
        source = uuid.uuid4().hex
    return hashlib.sha256(source.encode()).hexdigest()[:16]
