"""What may be asked, declared once: a question's fields are options of a command, the body over
HTTP and keywords in Python.

A question is a file of this folder. `asks` gives its fields to a function of the library,
`service/commands/asked.py` to a command, and a route takes the question itself as its body.
"""

from __future__ import annotations

import inspect
import re
import warnings
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from contextlib import suppress
from contextvars import ContextVar
from dataclasses import dataclass
from functools import reduce
from operator import or_
from textwrap import TextWrapper
from types import NoneType, UnionType
from typing import (
    Any,
    ClassVar,
    Literal,
    Self,
    TypeVar,
    Union,
    get_args,
    get_origin,
    get_type_hints,
)

from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    GetCoreSchemaHandler,
    ValidationError,
    ValidationInfo,
    field_validator,
    model_validator,
)
from pydantic.fields import FieldInfo

from residuum.identification.errors import BadInput
from residuum.nearest_names import known_names

Value = TypeVar("Value")
Function = TypeVar("Function", bound=Callable[..., Any])
# pydantic's kinds of errors → rules of ours.
_RULES = {
    "missing": "is missing",
    "finite_number": "must be a finite number",
    "greater_than_equal": "must be ≥ {ge:.10g}",
    "greater_than": "must be > {gt:.10g}",
    "less_than_equal": "must be ≤ {le:.10g}",
    "less_than": "must be < {lt:.10g}",
    **dict.fromkeys(("int_type", "int_parsing", "int_from_float"), "must be a whole number"),
    **dict.fromkeys(("float_type", "float_parsing"), "must be a number"),
    **dict.fromkeys(("tuple_type", "list_type"), "must be a list"),
    "dict_type": "must be names with values",
    "string_type": "must be a text",
    "string_too_short": "needs {min_length} or more characters",
    "too_short": "needs {min_length} or more items",
    **dict.fromkeys(("bool_type", "bool_parsing"), "must be true or false"),
}
# How a type is shown; of several names one may stand alone.
_SHOWN = {
    NoneType: "None",
    tuple[str, ...]: "str | tuple[str, ...]",
}
_BOUNDS = {"ge": "≥", "gt": ">", "le": "≤", "lt": "<"}
# Of a value in a refusal.
_LONGEST = 60
# What comes after a question's fields in a docstring.
_LAST = re.compile(r"(\nprogress :|\n\nReturns\n)")
_LINES = TextWrapper(126, initial_indent="    ", subsequent_indent="    ", break_on_hyphens=False)


def _warned(says: str) -> None:
    # So many frames lie between here and the line that called the library.
    warnings.warn(says, FutureWarning, stacklevel=6)


OLD_SPELLINGS: ContextVar[Callable[[str], None]] = ContextVar(
    "who hears of an old spelling", default=_warned
)
"""A door that answers somebody else than who runs the process (the service) tells it there."""


class Question(BaseModel):
    """A question as a value, whoever asks it; its fields are declared by `field`."""

    # Frozen, for a question is handed on as a value. An unknown field is refused: one that was
    # mistyped and passed over (`speed_rmp`) once had a bearing called healthy.
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    earlier: ClassVar[Mapping[str, Mapping[str, Any]]] = {}
    """Field → how a value was written before → how it is written now."""
    renamed: ClassVar[Mapping[str, str]] = {}
    """How a field was called before → how it is called now."""
    singular: ClassVar[Mapping[str, str]] = {}
    """Field of several → how a command calls one of them, beside the field's name."""

    @classmethod
    def of(cls, given: Mapping[str, Any]) -> Self:
        """The question of these fields; BadInput for the first that breaks a rule."""
        try:
            return cls(**given)
        except ValidationError as error:
            # The first alone: a refusal is one line in every door.
            raise refusal(error.errors()[0], cls.model_fields) from None

    @model_validator(mode="before")
    @classmethod
    def _as_written_now(cls, given: Any) -> Any:
        if not isinstance(given, dict):
            return given
        # A name of before is read, and told; where both names are given, the new one counts.
        for old in [
            name for name, new in cls.renamed.items() if name in given and new not in given
        ]:
            OLD_SPELLINGS.get()(f"{old}: will not be read much longer; say {cls.renamed[old]}")
            given = {
                cls.renamed.get(name, name) if name == old else name: value
                for name, value in given.items()
            }
        now = {
            name: values[given[name]]
            for name, values in cls.earlier.items()
            # By equality in a list: as a key of the mapping a value that is itself a list would not
            # do.
            if given.get(name) in list(values)
        }
        for name, value in now.items():
            instead = (
                "leave it out" if value == cls.model_fields[name].default else f"write {value!r}"
            )
            OLD_SPELLINGS.get()(f"{name} {given[name]!r}: will not be read much longer; {instead}")
        return given | now

    def handed_to(self, kind: Callable[..., Value]) -> Value:
        """What a dataclass or function of the rooms below takes of the fields, by their names."""
        return kind(
            **{
                name: getattr(self, name)
                for name in inspect.signature(kind).parameters
                if name in type(self).model_fields
            }
        )

    @field_validator("*")
    @classmethod
    def _is_known(cls, value: Any, info: ValidationInfo) -> Any:
        name = str(info.field_name)
        # Names are held to those that there are here, so that every door suggests the nearest one.
        names = choices(cls.model_fields[name])
        if value is not None and names and value not in names:
            raise BadInput(
                repr(value), name, f"there is none of this name; {known_names(value, names)}"
            )
        return value


Asked = TypeVar("Asked", bound=Question)


@dataclass(frozen=True)
class Either:
    """Beside a type of several alternatives: what is told of a value that is none of them, instead
    of pydantic's own names.
    """

    rule: str

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> Any:
        """pydantic's schema of the alternatives, with one error for all of them."""
        return {**handler(source), "custom_error_type": "either", "custom_error_message": self.rule}


def field(
    default: Any,
    help: str,
    *,
    choices: Iterable[str] = (),
    choices_with: Mapping[str, Mapping[str, Collection[Any]]] | None = None,
    only_with: Iterable[Mapping[str, Collection[Any]]] = (),
    example: Any = None,
    written: str | None = None,
    **bounds: Any,
) -> Any:
    """A field of a question; `...` as default makes it needed, `bounds` are pydantic's.

    `choices` are the names that it takes. `only_with` says with which values of other fields it
    counts, `{field: values}`, in one way or another, and `choices_with` the same of a name that it
    takes. A form does not show what does not count. `written` is the form of a text that says one
    item of several, which the question reads itself.
    """
    extra: dict[str, Any] = {"enum": list(choices)} if choices else {}
    if choices_with:
        extra["x-choices-only-with"] = {name: [_listed(way)] for name, way in choices_with.items()}
    ways = [_listed(way) for way in only_with]
    if ways:
        extra["x-only-with"] = ways
    if written:
        extra["x-written"] = written
    examples = None if example is None else [example]
    return Field(
        default, description=help, examples=examples, json_schema_extra=extra or None, **bounds
    )


def _listed(way: Mapping[str, Collection[Any]]) -> dict[str, list[Any]]:
    return {name: list(values) for name, values in way.items()}


def choices(field: FieldInfo) -> list[str]:
    """The names that a field takes; empty where it takes others."""
    extra: Any = field.json_schema_extra or {}
    return list(extra.get("enum", ()))


def written(field: FieldInfo) -> str | None:
    """The form of a text that says one item of a field, where the question reads it itself."""
    extra: Any = field.json_schema_extra or {}
    form: str | None = extra.get("x-written")
    return form


def help_of(field: FieldInfo) -> str:
    """What a field means, the names that it takes, and its bounds."""
    names = choices(field)
    limits = [
        f"{sign} {getattr(rule, key):.10g}"
        for key, sign in _BOUNDS.items()
        for rule in field.metadata
        if hasattr(rule, key)
    ]
    sentences = [str(field.description)]
    if names:
        sentences.append(f"One of {', '.join(names)}.")
    elif limits:
        sentences.append(f"Must be {' and '.join(limits)}.")
    return " ".join(sentences)


def refusal(error: Mapping[str, Any], known: Iterable[str] = ()) -> BadInput:
    """One of pydantic's errors as every door refuses it; `known` are the names of the fields that
    there are.
    """
    context = error.get("ctx", {})
    # A refusal of ours, raised in a validator, is in words already.
    own = context.get("error")
    if isinstance(own, BadInput):
        return own
    # `body`, `query` and `[key]` are where FastAPI and pydantic found it, which tells a caller
    # nothing.
    where = ".".join(str(part) for part in error["loc"] if part not in ("body", "query", "[key]"))
    if error["type"] == "extra_forbidden":
        return BadInput(repr(where), "", f"there is none of this name; {known_names(where, known)}")
    ours = _RULES.get(error["type"])
    rule = error["msg"] if ours is None else ours.format_map(context)
    return BadInput("" if error["type"] == "missing" else _as_given(error["input"]), where, rule)


def _as_given(value: object) -> str:
    """A value as a refusal shows it: of a number the same, whether it came as a number or as a
    text.

    >>> _as_given("soon"), _as_given(-3), _as_given("-3")
    ("'soon'", '-3', '-3')
    """
    shown = repr(value)
    if isinstance(value, str):
        with suppress(ValueError):
            float(value)
            shown = value
    return shown[:_LONGEST]


def part_of(asked: BaseModel, question: type[Asked]) -> Asked:
    """The question in a body that has fields of a door's own beside it."""
    # Not validated again: it was as part of the body, and an old spelling is told once.
    return question.model_construct(
        **{name: getattr(asked, name) for name in question.model_fields}
    )


def asks(question: type[Question]) -> Callable[[Function], Function]:
    """Give the fields of a question to a function that takes them as `**given`: to its signature,
    and to its docstring after the parameters of its own, but for `progress`, which is the last.
    """

    # In the signature and in the docstring: both are what an editor and the reference show.
    def with_fields(function: Function) -> Function:
        signature = inspect.signature(function)
        # `**given` goes: each of its keywords stands in the signature by itself.
        own = [arg for arg in signature.parameters.values() if arg.kind is not arg.VAR_KEYWORD]
        parameters = sorted(
            [*own, *_keywords(question)], key=lambda arg: (arg.kind, arg.name == "progress")
        )
        with_fields_too = signature.replace(parameters=parameters)
        function.__signature__ = with_fields_too  # type: ignore[attr-defined]
        fields = []
        for arg in _keywords(question):
            meaning = _LINES.fill(help_of(question.model_fields[arg.name]))
            fields.append(f"{arg.name} : {arg.annotation.replace(' | ', ' or ')}\n{meaning}")
        before, ending, after = _LAST.split(inspect.cleandoc(function.__doc__ or ""), maxsplit=1)
        function.__doc__ = "\n".join([before, *fields]) + ending + after
        return function

    return with_fields


def _shown(question: type[Question], name: str) -> str:
    """The type of a field as a signature shows it; what texts may say may come as texts."""
    kind = _kind(get_type_hints(question)[name])
    return f"{kind} | list[str]" if written(question.model_fields[name]) else kind


def _keywords(question: type[Question]) -> Iterator[inspect.Parameter]:
    for name, field in question.model_fields.items():
        default = inspect.Parameter.empty if field.is_required() else field.default
        yield inspect.Parameter(
            name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=_shown(question, name)
        )


def kinds(hint: Any) -> tuple[Any, ...]:
    """The alternatives of a type."""
    return get_args(hint) if get_origin(hint) in (Union, UnionType) else (hint,)


def _kind(hint: Any) -> str:
    shown = (_SHOWN.get(kind) or _formatted(kind) for kind in kinds(hint))
    return " | ".join(shown)


def _formatted(hint: Any) -> str:
    return inspect.formatannotation(_without_choices(hint))


def _without_choices(hint: Any) -> Any:
    """The type with `str` for each choice of texts: the field's help lists them."""
    origin, parts = get_origin(hint), get_args(hint)
    if origin is Literal and all(isinstance(choice, str) for choice in parts):
        return str
    if origin is Literal or not parts:
        return hint
    plain = [_without_choices(part) for part in parts]
    return reduce(or_, plain) if origin in (Union, UnionType) else origin[tuple(plain)]
