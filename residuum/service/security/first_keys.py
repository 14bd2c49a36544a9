"""The keys of a deployment that has none yet: an engineer's, which is shown once, that by which Prometheus reads, and the
password by which the service enters its broker."""

from __future__ import annotations

import base64
import hashlib
import os
import secrets
from collections.abc import Callable
from pathlib import Path

from residuum.service.security.access import ApiKeys, new_key
from residuum.service.settings import BadSettings

API_KEYS, METRICS_KEY = "api_keys", "metrics_key"
"""Names of the files: what the setting `api_keys` reads, and the plain key for Prometheus."""
BROKER_PASSWORD, BROKER_USERS = "broker_password", "broker_users"
"""What the setting `mqtt_password_file` reads, and Mosquitto's `password_file`."""
BROKER_USER = "residuum"
_ROUNDS = 101  # as mosquitto_passwd; the password is 256 random bits, and needs none
_MODE = 0o640


def make_first_keys(folder: Path, show: Callable[[str], None]) -> bool:
    """Make both files in `folder` unless they are there; whether an engineer's key was made, which `show` is told.

    Files that are there stay as they are; where only Prometheus's key is missing, it alone is made anew. A file appears whole or
    not at all, and the engineer's key counts only once it has been shown.

    Raises
    ------
    BadSettings
        The folder cannot be written, or holds a file of keys that cannot be read.
    """
    keys, metrics = folder / API_KEYS, folder / METRICS_KEY
    if first := not keys.is_file():
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
        written = _beside(metrics, scraper), _beside(keys, "\n".join([*lines, f"prometheus monitor {digest}"]) + "\n")
        if first:
            show(key)
        written[1].replace(keys)
        written[0].replace(metrics)
    except OSError as error:
        raise BadSettings(f"keys in {folder}: cannot be written: {error.strerror or error}") from None
    return first


def make_broker_user(folder: Path) -> None:
    """Make the password of the broker's user, and Mosquitto's file of users with its hash, unless both are there.

    Raises BadSettings where the folder cannot be written.
    """
    users, password = folder / BROKER_USERS, folder / BROKER_PASSWORD
    if users.is_file() and password.is_file():
        return
    chosen, salt = secrets.token_urlsafe(32), secrets.token_bytes(12)
    hashed = hashlib.pbkdf2_hmac("sha512", chosen.encode(), salt, _ROUNDS)
    line = f"{BROKER_USER}:$7${_ROUNDS}${base64.b64encode(salt).decode()}${base64.b64encode(hashed).decode()}\n"
    try:
        written = _beside(password, chosen), _beside(users, line)
        written[0].replace(password)
        written[1].replace(users)
    except OSError as error:
        raise BadSettings(f"keys in {folder}: cannot be written: {error.strerror or error}") from None


def _without(file: Path, name: str) -> list[str]:
    return [line for line in file.read_text(encoding="utf-8").splitlines() if line.split()[:1] != [name]]


def _beside(file: Path, content: str) -> Path:
    """The content in a file beside `file`, for its owner and the owner's group alone, to be put in its place."""
    part = file.with_name(f".{file.name}.part")
    part.unlink(missing_ok=True)
    with os.fdopen(os.open(part, os.O_CREAT | os.O_EXCL | os.O_WRONLY, _MODE), "w", encoding="utf-8") as opened:
        os.fchmod(opened.fileno(), _MODE)  # whatever the umask takes away: another container reads it by the group
        opened.write(content)
    return part
