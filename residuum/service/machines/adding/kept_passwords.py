"""Passwords of machines' sources: they are never shown, and they are kept when what was shown comes back."""

from __future__ import annotations

from collections.abc import Sequence

from residuum.identification.errors import BadInput
from residuum.service.fieldbus.settings import SourceSettings
from residuum.service.hidden_password import is_hidden, with_hidden_password


def with_kept_passwords(asked: Sequence[SourceSettings], kept: Sequence[SourceSettings]) -> list[SourceSettings]:
    """The sources that are asked for, with a kept password wherever one is hidden.

    A password goes to no other address, user or kind of source than those it was given for: BadInput when none was.
    """
    return [_with_password(place, source, kept) for place, source in enumerate(asked)]


def _with_password(place: int, source: SourceSettings, kept: Sequence[SourceSettings]) -> SourceSettings:
    if not is_hidden(source.channel):
        return source
    same = {each.channel for each in kept if (each.kind, with_hidden_password(each.channel)) == (source.kind, source.channel)}
    if len(same) != 1:
        raise BadInput(f"sources[{place}].channel: its password is hidden, and not one alone is kept for this address; give it")
    return source.model_copy(update={"channel": same.pop()})
