"""API keys: who may call, and what. Keys are kept as SHA-256 hashes; a key is 256 random bits, so no salt is needed."""

from __future__ import annotations

import hashlib
import re
import secrets
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path

from residuum.service.settings import BadSettings

LONGEST_NAME = 64
"""Characters of a caller's name that journals and the audit trail keep."""


class Role(IntEnum):
    """What a caller may do; each role includes those before it. A monitor reads metrics and health alone."""

    MONITOR = 0
    VIEWER = 1
    OPERATOR = 2
    ENGINEER = 3
    ADMIN = 4


@dataclass(frozen=True)
class Caller:
    """Who called."""

    name: str
    role: Role
    sites: frozenset[str] | None = None
    """Sites whose assets the caller may see and handle: those called SITE or SITE.…; None: all, and all that is no asset's."""

    def may_see(self, asset: str) -> bool:
        """Whether an asset is of the caller's sites.

        >>> Caller("eva", Role.VIEWER, frozenset({"hall-1"})).may_see("hall-1.press")
        True
        """
        return self.sites is None or asset.split(".", maxsplit=1)[0] in self.sites


ANYBODY = Caller("local", Role.ADMIN)
"""The caller when no keys are configured: the service then listens on this machine alone."""


def new_key() -> tuple[str, str]:
    """A new key and its hash for the file."""
    key = secrets.token_urlsafe(32)
    return key, hashlib.sha256(key.encode()).hexdigest()


class ApiKeys:
    """The keys of a file with a line each: `name role sha256 [site,site…]`; `#` begins a comment.

    Without a file everybody may do everything, unless there are `tokens` to be shown instead.

    Raises BadSettings with the line that is malformed, or when the file cannot be read or has no key.
    """

    def __init__(self, path: Path | None, *, tokens: bool = False) -> None:
        self._callers: dict[str, Caller] | None = _read(path) if path is not None else {} if tokens else None

    @property
    def needed(self) -> bool:
        """Whether a caller has to show a key."""
        return self._callers is not None

    def caller(self, key: str | None) -> Caller | None:
        """Who has this key; None when nobody does. The lookup is by hash, so its time tells nothing about keys."""
        if self._callers is None:
            return ANYBODY
        return None if key is None else self._callers.get(hashlib.sha256(key.encode()).hexdigest())


def _read(path: Path) -> dict[str, Caller]:
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise BadSettings(f"setting api_keys: {path}: cannot be read: {error}") from None
    callers = {}
    for number, line in enumerate(lines, start=1):
        words = line.split("#")[0].split()
        if not words:
            continue
        if len(words) not in (3, 4) or words[1].upper() not in Role.__members__ or len(words[2]) != 64:
            rule = "must be 'name monitor|viewer|operator|engineer|admin sha256', and may name sites: 'hall-1,hall-2'"
            raise BadSettings(f"setting api_keys: {path}, line {number}: {rule}")
        if len(words[0]) > LONGEST_NAME:
            raise BadSettings(f"setting api_keys: {path}, line {number}: a name has at most {LONGEST_NAME} characters")
        callers[words[2].lower()] = Caller(words[0], Role[words[1].upper()], _sites(words, f"{path}, line {number}"))
    if not callers:
        raise BadSettings(f"setting api_keys: {path}: holds no key")
    return callers


def _sites(words: list[str], where: str) -> frozenset[str] | None:
    if len(words) == 3:
        return None
    try:
        return site_names(words[3].split(","))
    except BadSettings as error:
        raise BadSettings(f"setting api_keys: {where}: {error}") from None


def site_names(sites: Sequence[str]) -> frozenset[str]:
    """Names of sites; BadSettings when one cannot be."""
    for site in sites:
        if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_-]{0,62}", site):
            raise BadSettings(f"{site[:80]!r}: a site is letters, digits, '_' and '-'")
    return frozenset(sites)
