"""A family of exchangeable parts by name, whose modules are imported when a part is asked for."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, MutableMapping
from importlib import import_module
from typing import Generic, TypeVar

T = TypeVar("T")


class LateMembers(MutableMapping[str, T], Generic[T]):
    """Name → member, as a dictionary; `places` names each one's module and what it defines there.

    A module is imported when its member is asked for, not when the family is listed: who scores a
    bearing need not wait for the search for missing physics that another diagnoser learns with.
    `others` gives the members that other packages add; it is called once, when a name that is not
    in `places`, or all names, are asked for.
    """

    def __init__(
        self, places: Mapping[str, tuple[str, str]], others: Callable[[], Mapping[str, T]] = dict
    ) -> None:
        self._places = dict(places)
        self._others: Callable[[], Mapping[str, T]] | None = others
        self._loaded: dict[str, T] = {}

    def __getitem__(self, name: str) -> T:
        if name not in self._loaded and name in self._places:
            module, attribute = self._places[name]
            self._loaded[name] = getattr(import_module(module), attribute)
        if name not in self._loaded:
            self._join_others()
        return self._loaded[name]

    def __setitem__(self, name: str, member: T) -> None:
        self._loaded[name] = member

    def __delitem__(self, name: str) -> None:
        if name not in self:
            raise KeyError(name)
        self._loaded.pop(name, None)
        # A member that was taken out must not be loaded again at the next question.
        self._places.pop(name, None)

    def __contains__(self, name: object) -> bool:
        if name in self._places or name in self._loaded:
            return True
        self._join_others()
        return name in self._loaded

    def __iter__(self) -> Iterator[str]:
        self._join_others()
        # the family's own order first: lists that users see do not depend on what was loaded when
        return iter(dict.fromkeys([*self._places, *self._loaded]))

    def __len__(self) -> int:
        return sum(1 for _ in self)

    def _join_others(self) -> None:
        if self._others is None:
            return
        join, self._others = self._others, None
        for name, member in join().items():
            if name not in self._places:  # what another package adds never replaces a part of ours
                self._loaded.setdefault(name, member)
