"""What readers name as the way on, in the words of another door: they speak of options of commands."""

import re
import shlex
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace

from residuum.identification.errors import BadInput
from residuum.identification.record import Record
from residuum.identification.record_formats.loggers.logger_time import FORMS

Spelling = Callable[[str, str | None], str]
"""How a door says an option (`sample-time`, `map` …) of a command, with its value or without one."""
_VALUES = {
    "sample-time": r"[\d.]+",
    "decimal": "'[.,]'",
    "time": rf"(?:'[^']*'|(?:{'|'.join(FORMS)})\b)",
    "missing": r"(?:'[^']*'|[^\s`;,]+)",
    "names": r"(?:'[^']*'|[^\s'`;])+",
    "unit": r"(?:'[^']+=[^']+'|[^\s=]+=[^\s,;)]+)",
    "map": r"(?:'[^']+=[^']+'|[^\s=]+=[^\s,;)]+)",
    "duplicates": r"\w+",
    "reordered": r"\w+",
    "resample": "(?!)",
}
_OPTION = re.compile("|".join(rf"--{name}\b(?![-\w])(?: {value})?" for name, value in _VALUES.items()))
IN_PYTHON = re.compile(r",? \(?in Python \w+=(?:\{[^}]*\}|True\b)\)?")
"""What a refusal says for Python beside the option of a command."""
_SETTLED = re.compile(r" \(`residuum inspect FILE[^`]*` (?:with it [^)]*|writes it)\)")
_INSPECT = re.compile(r"(say )?`residuum inspect FILE (--(?!out)[^`]*?)(?: --out [^`]*)?`( says so)?")
_IN_MAPPING = re.compile(r"set the mapping's `(duplicates|reordered)(?:` to `|: )(\w+)`( where|)")


@contextmanager
def respelling(spell: Spelling) -> Iterator[None]:
    """Let refusals name a door's own keys where readers name the options of the command line."""
    try:
        yield
    except BadInput as error:
        error.args = (respelt(str(error), spell), *error.args[1:])
        raise


def notes_respelt(record: Record, spell: Spelling) -> Record:
    """The record with what its notes propose in the words of a door."""
    return replace(record, notes=tuple(respelt(note, spell) for note in record.notes))


def respelt(says: str, spell: Spelling) -> str:
    """A refusal in the words of a door; that a command settles a thing for the others is left out.

    >>> def spell(option, value):
    ...     return f"?{option}={value or '…'}"
    >>> respelt("say --time 'day first' or --time 'month first'", spell)
    'say ?time=day first or ?time=month first'
    >>> respelt("if it means no value, `residuum inspect FILE --missing 'OL' --out FILE.mapping.yaml` says so", spell)
    'if it means no value, say ?missing=OL'
    >>> respelt("set the mapping's `reordered: sort` where its rows are only shuffled", spell)
    'say ?reordered=sort where its rows are only shuffled'
    """
    says = IN_PYTHON.sub("", says)
    says = _IN_MAPPING.sub(r"say --\1 \2\3", _SETTLED.sub("", says))
    says = _INSPECT.sub(lambda found: ("say " if found[1] or found[3] else "") + found[2], says)
    return _OPTION.sub(lambda found: _spelt(found[0], spell), says)


def _spelt(option: str, spell: Spelling) -> str:
    name, _, value = option.removeprefix("--").partition(" ")
    return spell(name, " ".join(shlex.split(value)) or None)
