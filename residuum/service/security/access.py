"""API keys: who may call, and what. Keys are kept as SHA-256 hashes; a key is 256 random bits, so
no salt is needed.
"""

from __future__ import annotations

import base64
import hashlib
import os
import re
import secrets
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from enum import IntEnum
from pathlib import Path

import structlog

from residuum.service.settings import BadSettings

log = structlog.get_logger()

LOOK_EVERY = 1.0
"""Seconds between looks at whether the file of keys has changed."""
_UNTIL = "until="
LONGEST_NAME = 64
"""Characters of a caller's name that journals and the audit trail keep."""


class Role(IntEnum):
    """What a caller may do; each role includes those before it. A monitor reads metrics and health
    alone.
    """

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
    """Sites whose assets the caller may see and handle: those called SITE or SITE.…; None: all, and
    all that is no asset's.
    """

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


@dataclass(frozen=True)
class _Key:
    """Whose key it is, and when it ends (None: never)."""

    caller: Caller
    until: datetime | None


class ApiKeys:
    """The keys of a file with a line each: `name role sha256 [site,site…] [until=2027-01-31]`; `#`
    begins a comment.

    The file is read again when it changes: a key that is taken out of it is nobody's a second
    later, and one name may have two while one takes over from the other. A file that cannot be read
    any more leaves the keys as they were, and is told in the log. Without a file everybody may do
    everything, unless there are `tokens` to be shown instead.

    Raises BadSettings with the line that is malformed, or when the file cannot be read or has no
    key.
    """

    def __init__(self, path: Path | None, *, tokens: bool = False) -> None:
        self._path, self._looked = path, time.monotonic()
        # before the file is read: what changes in between is seen as a change
        self._seen = None if path is None else _version(path)
        # None: nobody needs a key; none at all: everybody needs a token
        without_file: dict[str, _Key] | None = {} if tokens else None
        self._keys = without_file if path is None else _read(path)
        self._lock = threading.Lock()

    @property
    def needed(self) -> bool:
        """Whether a caller has to show a key."""
        return self._keys is not None

    def caller(self, key: str | None) -> Caller | None:
        """Who has this key; None when nobody does, or it has ended. The lookup is by hash, so its
        time tells nothing of keys.
        """
        if self._keys is None:
            return ANYBODY
        known = self._known(key)
        return None if known is None or _ended(known) else known.caller

    def ended(self, key: str | None) -> str | None:
        """Whose key this was before it ended; None for any other."""
        known = self._known(key)
        return known.caller.name if known is not None and _ended(known) else None

    def _known(self, key: str | None) -> _Key | None:
        if self._keys is None or key is None:
            return None
        self._read_again()
        # the hash is looked up, so how long it takes depends on no character of a key
        return self._keys.get(hashlib.sha256(key.encode()).hexdigest())

    def _read_again(self) -> None:
        """Read the file when it has changed, looking at most once a second."""
        if (
            self._path is None
            or time.monotonic() - self._looked < LOOK_EVERY
            or not self._lock.acquire(blocking=False)
        ):
            return
        # whoever does not get the lock goes on with the keys there are; another reads them now
        try:
            self._looked = time.monotonic()
            version = _version(self._path)
            if version == self._seen:
                return
            self._seen = version
            self._keys = _read(self._path)
            log.info("the file of API keys was read again", keys=len(self._keys))
        except BadSettings as error:
            log.error(
                "the file of API keys has changed and cannot be read; the keys before it count",
                reason=str(error),
            )
        finally:
            self._lock.release()


def _ended(key: _Key) -> bool:
    return key.until is not None and datetime.now(UTC) >= key.until


def _version(path: Path) -> tuple[int, int, int] | None:
    """What changes when a file is written or replaced; None where there is none."""
    try:
        status = path.stat()
    except OSError:
        return None
    return status.st_ino, status.st_mtime_ns, status.st_size


def _read(path: Path) -> dict[str, _Key]:
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise BadSettings(f"setting api_keys: {path}: cannot be read: {error}") from None
    callers = {}
    for number, line in enumerate(lines, start=1):
        words = line.split("#")[0].split()
        if not words:
            continue
        words, until = _without_end(words, f"{path}, line {number}")
        if (
            len(words) not in (3, 4)
            or words[1].upper() not in Role.__members__
            or len(words[2]) != 64
        ):
            rule = (
                "must be 'name monitor|viewer|operator|engineer|admin sha256', and may name sites:"
                " 'hall-1,hall-2'"
            )
            rule += ", and its end: until=2027-01-31"
            raise BadSettings(f"setting api_keys: {path}, line {number}: {rule}")
        if len(words[0]) > LONGEST_NAME:
            raise BadSettings(
                f"setting api_keys: {path}, line {number}: a name has at most {LONGEST_NAME}"
                " characters"
            )
        caller = Caller(words[0], Role[words[1].upper()], _sites(words, f"{path}, line {number}"))
        callers[words[2].lower()] = _Key(caller, until)
    if not callers:
        raise BadSettings(f"setting api_keys: {path}: holds no key")
    return callers


def _without_end(words: list[str], where: str) -> tuple[list[str], datetime | None]:
    """The words of a line without the one that says when its key ends, and that moment."""
    endings = [word for word in words if word.startswith(_UNTIL)]
    if not endings:
        return words, None
    try:
        until = datetime.fromisoformat(endings[-1].removeprefix(_UNTIL))
    except ValueError:
        says = (
            f"{endings[-1][:60]!r}: must be until=2027-01-31, or with a time,"
            " until=2027-01-31T18:00+01:00"
        )
        raise BadSettings(f"setting api_keys: {where}: {says}") from None
    moment = until if until.tzinfo else until.replace(tzinfo=UTC)
    return [word for word in words if word not in endings], moment


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


# The keys of a deployment that has none yet: an engineer's, which is shown once, that by which
# Prometheus reads, and the password by which the service enters its broker.

API_KEYS, METRICS_KEY = "api_keys", "metrics_key"
"""Names of the files: what the setting `api_keys` reads, and the plain key for Prometheus."""
BROKER_PASSWORD, BROKER_USERS = "broker_password", "broker_users"
"""What the setting `mqtt_password_file` reads, and Mosquitto's `password_file`."""
BROKER_USER = "residuum"
_ROUNDS = 101  # as mosquitto_passwd; the password is 256 random bits, and needs none
_MODE = 0o640


def make_first_keys(folder: Path, show: Callable[[str], None]) -> bool:
    """Make both files in `folder` unless they are there; whether an engineer's key was made, which
    `show` is told.

    Files that are there stay as they are; where only Prometheus's key is missing, it alone is made
    anew. A file appears whole or not at all, and the engineer's key counts only once it has been
    shown.

    Raises
    ------
    BadSettings
        The folder cannot be written, or holds a file of keys that cannot be read.
    """
    keys, metrics = folder / API_KEYS, folder / METRICS_KEY
    first = not keys.is_file()
    if first:
        key, digest = new_key()
        lines = [f"engineer engineer {digest}"]
    else:
        ApiKeys(keys)
        if metrics.is_file():
            return False
        lines = _without(keys, "prometheus")
    scraper, digest = new_key()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        written = (
            _beside(metrics, scraper),
            _beside(keys, "\n".join([*lines, f"prometheus monitor {digest}"]) + "\n"),
        )
        # shown before it counts: a key that nobody saw must not keep one from being made again
        if first:
            show(key)
        written[1].replace(keys)
        written[0].replace(metrics)
    except OSError as error:
        raise BadSettings(
            f"keys in {folder}: cannot be written: {error.strerror or error}"
        ) from None
    return first


def make_broker_user(folder: Path) -> None:
    """Make the password of the broker's user, and Mosquitto's file of users with its hash, unless
    both are there.

    Raises BadSettings where the folder cannot be written.
    """
    users, password = folder / BROKER_USERS, folder / BROKER_PASSWORD
    if users.is_file() and password.is_file():
        return
    # the form of Mosquitto's password files, `$7$ROUNDS$SALT$HASH` (PBKDF2 with SHA-512)
    chosen, salt = secrets.token_urlsafe(32), secrets.token_bytes(12)
    hashed = hashlib.pbkdf2_hmac("sha512", chosen.encode(), salt, _ROUNDS)
    shown = [base64.b64encode(part).decode() for part in (salt, hashed)]
    line = f"{BROKER_USER}:$7${_ROUNDS}${shown[0]}${shown[1]}\n"
    try:
        written = _beside(password, chosen), _beside(users, line)
        written[0].replace(password)
        written[1].replace(users)
    except OSError as error:
        raise BadSettings(
            f"keys in {folder}: cannot be written: {error.strerror or error}"
        ) from None


def _without(file: Path, name: str) -> list[str]:
    return [
        line for line in file.read_text(encoding="utf-8").splitlines() if line.split()[:1] != [name]
    ]


def _beside(file: Path, content: str) -> Path:
    """The content in a file beside `file`, for its owner and the owner's group alone, to be put in
    its place.
    """
    part = file.with_name(f".{file.name}.part")
    part.unlink(missing_ok=True)
    with os.fdopen(
        os.open(part, os.O_CREAT | os.O_EXCL | os.O_WRONLY, _MODE), "w", encoding="utf-8"
    ) as opened:
        # whatever the umask takes away: another container reads it by the group
        os.fchmod(opened.fileno(), _MODE)
        opened.write(content)
    return part
