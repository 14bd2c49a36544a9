"""The fields of a question as options of a command."""

from __future__ import annotations

import inspect
import warnings
from collections.abc import Callable, Container
from typing import Annotated, Any, get_args, get_type_hints

import typer

from residuum.library.questions import Question, help_of
from residuum.service.commands import as_option
from residuum.service.commands.report import progress

_METAVARS = {str: "TEXT", int: "INTEGER", float: "NUMBER"}


def asks(without: Container[str] = ()) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Turn the parameter of a command that is a question into options: one a field, but for those in `without`.

    Texts are handed over as they are written; the question reads them and refuses as it does for every door.
    """

    def command(function: Callable[..., Any]) -> Callable[..., Any]:
        hints = get_type_hints(function, include_extras=True)
        parameters = dict(inspect.signature(function).parameters)
        name = next(each for each in parameters if inspect.isclass(hints[each]) and issubclass(hints[each], Question))
        question: type[Question] = hints[name]
        options = {field: _option(question, field) for field in question.model_fields if field not in without}

        def asked(**given: Any) -> Any:
            said = {field: given.pop(field) for field in options}
            with warnings.catch_warnings(record=True) as told:
                warnings.simplefilter("always")
                made = question.of({field: value for field, value in said.items() if value not in (None, [])})
            for warning in told:
                progress(f"--{warning.message}")
            return function(**given, **{name: made})

        own = {each: [p.replace(kind=p.KEYWORD_ONLY, annotation=hints[each])] for each, p in parameters.items()}
        own[name] = list(options.values())
        signature = inspect.Signature([each for listed in own.values() for each in listed])
        asked.__name__, asked.__doc__ = function.__name__, function.__doc__
        asked.__signature__ = signature  # type: ignore[attr-defined]
        asked.__annotations__ = {each.name: each.annotation for each in signature.parameters.values()}
        return asked

    return command


def _option(question: type[Question], name: str) -> inspect.Parameter:
    """One option: a flag, or a text; several texts where the field takes a list."""
    field, kind = question.model_fields[name], get_type_hints(question)[name]
    option, kinds = as_option(name), get_args(kind) or (kind,)
    default: Any = None if field.is_required() or field.default is None else str(field.default)
    form: Any = str | None
    metavar = next((says for each, says in _METAVARS.items() if each in kinds), None)
    if bool in kinds:
        option, default, form, metavar = option if not field.default else f"{option}/--no-{option[2:]}", field.default, bool, None
    elif list[str] in kinds:
        form, metavar = list[str] | None, "NAME"
    told = help_of(field).replace("[", "\\[") + (" Repeat it for several." if metavar == "NAME" else "")
    annotation = Annotated[form, typer.Option(option, help=told, metavar=metavar)]
    return inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation)
