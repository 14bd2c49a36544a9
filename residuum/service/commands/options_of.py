"""A parameter of a command that stands for several options."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from typing import Any, TypeVar, get_type_hints

T = TypeVar("T")


def parameter_of(function: Callable[..., Any], kind: type[T]) -> tuple[str, type[T]]:
    """Name and class of the parameter of this kind."""
    return next(
        (name, hint)
        for name, hint in get_type_hints(function).items()
        if inspect.isclass(hint) and issubclass(hint, kind)
    )


def expanded(
    function: Callable[..., Any],
    name: str,
    options: Mapping[str, inspect.Parameter],
    question_of: Callable[[dict[str, Any]], Any],
) -> Callable[..., Any]:
    """A command with these options in the place of the parameter `name`, which is `question_of` of
    what they say.
    """
    # With extras: typer's options stand in `Annotated`, which is dropped otherwise.
    hints = get_type_hints(function, include_extras=True)

    def command(**given: Any) -> Any:
        texts = {option: given.pop(option) for option in options}
        return function(**given, **{name: question_of(texts)})

    own = {
        # Keywords all: options may then stand before arguments without defaults, in their own
        # place.
        part: [parameter.replace(kind=parameter.KEYWORD_ONLY, annotation=hints[part])]
        for part, parameter in inspect.signature(function).parameters.items()
    }
    own[name] = list(options.values())
    signature = inspect.Signature([part for listed in own.values() for part in listed])
    # Typer takes a command's name and help from the function: those of this wrapper would say
    # nothing.
    command.__name__, command.__doc__ = function.__name__, function.__doc__
    # Typer reads the signature for the order, and the annotations for the types.
    command.__signature__ = signature  # type: ignore[attr-defined]
    command.__annotations__ = {part.name: part.annotation for part in signature.parameters.values()}
    return command
