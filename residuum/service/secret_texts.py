"""Secrets of settings: given as a text or as a file whose first line is one, and shown nowhere."""

from __future__ import annotations

from pathlib import Path

from pydantic import SecretStr

from residuum.identification.errors import BadInput


def first_line(file: Path, setting: str) -> str:
    """The first line of a file of a secret, as `echo` and secret stores write it; BadInput names
    the setting.
    """
    try:
        return file.read_text(encoding="utf-8").partition("\n")[0].strip()
    except (OSError, UnicodeDecodeError) as error:
        raise BadInput(f"setting {setting}: {file}: cannot be read: {error}") from None


def secret_of(text: SecretStr | None, file: Path | None, setting: str) -> str | None:
    """A secret from its text or its file, None where neither is given; BadInput for an empty one,
    which would keep nobody out.
    """
    if file is None and text is None:
        return None
    secret = first_line(file, setting) if file is not None else text and text.get_secret_value()
    if not secret:
        where = f"{file}: its first line" if file is not None else "it"
        raise BadInput(f"setting {setting}: {where} is empty; write the secret there")
    return secret


def without(text: str, *secrets: str | None) -> str:
    """A text that others wrote, in one line and without these secrets.

    >>> without("no service at /T0/B0/x\\n", "/T0/B0/x")
    'no service at ***'
    """
    # the longest first: one may stand within another
    for secret in sorted(filter(None, secrets), key=len, reverse=True):
        text = text.replace(secret, "***")
    return " ".join(text.split())
