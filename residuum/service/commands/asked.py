"""The fields of a question as options of a command."""

from __future__ import annotations

import inspect
import re
import warnings
from collections.abc import Callable, Container, Iterable
from typing import Annotated, Any, get_origin, get_type_hints

import typer

from residuum.identification.errors import BadInput
from residuum.library.questions import Question, help_of, kinds, written
from residuum.service.commands import as_option
from residuum.service.commands.options_of import expanded, parameter_of
from residuum.service.commands.report import progress

# Names that have no commas: written with commas between them, too.
_NAMES: Any = tuple[str, ...]
# What a field may take → what stands for it in the help; the first that it takes is shown.
_METAVARS: dict[Any, str | None] = {
    bool: None,
    list[str]: "NAME",
    _NAMES: "NAME,…",
    dict[str, float]: "NAME=VALUE",
    dict[str, bool | float | str]: "NAME=VALUE",
    dict[str, tuple[float, float]]: "NAME=LOW:HIGH",
    tuple[float | None, float | None]: "LOW HIGH",
    str: "TEXT",
    int: "INTEGER",
    float: "NUMBER",
}
# What is written several times, or as two words.
_FORMS: dict[Any, Any] = {
    _NAMES: list[str],
    list: list[str],
    dict: list[str],
    tuple: tuple[str, str],
}


def asks(without: Container[str] = ()) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Turn the parameter of a command that is a question into options: one a field, but for those
    in `without`.

    Texts are handed over as they are written; the question reads them and refuses as it does for
    every door.
    """

    def command(function: Callable[..., Any]) -> Callable[..., Any]:
        name, question = parameter_of(function, Question)
        options = {
            field: _option(question, field)
            for field in question.model_fields
            if field not in without
        }

        def question_of(texts: dict[str, Any]) -> Question:
            # Old spellings are told as a command tells anything, not as a warning of Python with
            # the line of the code.
            with warnings.catch_warnings(record=True) as caught:
                warnings.simplefilter("always")
                given = {
                    field: _read(question, field, value)
                    for field, value in texts.items()
                    if value not in (None, [])
                }
                asked = question.of(given)
            for warning in caught:
                progress(f"--{warning.message}")
            return asked

        return expanded(function, name, options, question_of)

    return command


def _read(question: type[Question], name: str, value: Any) -> Any:
    """A value as the question reads it: of texts with commas a list, of `NAME=VALUE` or
    `NAME=LOW:HIGH` a mapping.
    """
    # A field that has a written form of its own (`ID[:SIZE]`) is parted by its question, for every
    # door.
    if written(question.model_fields[name]):
        return value
    taken = _taken(question, name)
    if taken == _NAMES:
        return [part.strip() for text in value for part in text.split(",")]
    # a field that takes one text or several: an answer shows one as it was written
    if taken == list[str] and len(value) == 1 and str in kinds(get_type_hints(question)[name]):
        return value[0]
    return _mapping(value, name, _METAVARS[taken] or "") if get_origin(taken) is dict else value


def _mapping(texts: Iterable[str], name: str, form: str) -> dict[str, str | list[str]]:
    """Texts of a form, of which the first word is the key, as a mapping."""
    # The form that the help shows is the one that is read: they cannot come apart.
    pattern = re.sub("[A-Z]+", "(.+?)", form)
    mapping: dict[str, str | list[str]] = {}
    for text in texts:
        parts = re.fullmatch(pattern, text)
        if parts is None:
            raise BadInput(repr(text), name, f"must have the form {form}")
        key, *values = parts.groups()
        mapping[key] = values[0] if len(values) == 1 else values
    return mapping


def _taken(question: type[Question], name: str) -> Any:
    """What a field takes, as it is shown in the help."""
    return next(kind for kind in _METAVARS if kind in kinds(get_type_hints(question)[name]))


def _option(question: type[Question], name: str) -> inspect.Parameter:
    """One option: a flag, or a text; several texts where the field takes a list."""
    field, option = question.model_fields[name], as_option(name)
    metavar = written(field)
    taken = list[str] if metavar else _taken(question, name)
    default: Any = (
        None if field.is_required() or field.default in (None, {}) else str(field.default)
    )
    form: Any = _FORMS.get(taken, _FORMS.get(get_origin(taken), str))
    if taken is bool:
        # A flag that is on by default can only be taken back, by `--no-…`.
        option, default, form = (
            option if not field.default else f"{option}/--no-{option[2:]}",
            field.default,
            bool,
        )
    # Rich takes brackets for markup: units such as [s] were missing in the help.
    text = help_of(field).replace("[", "\\[") + (
        " Repeat it for several." if form == list[str] else ""
    )
    names = [as_option(question.singular[name])] if name in question.singular else []
    annotation = Annotated[
        form | None,
        typer.Option(*names, option, help=text, metavar=metavar or _METAVARS[taken]),
    ]
    return inspect.Parameter(
        name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation
    )
