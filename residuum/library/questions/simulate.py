"""The question `simulate`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal, get_args

from pydantic import BeforeValidator, Field, ValidationInfo

from residuum.identification.errors import BadInput
from residuum.library.questions import Either, Question, field
from residuum.nearest_names import known_names

_Size = Literal["small", "medium", "large"]
SIZES = get_args(_Size)
_Name = Annotated[str, Field(min_length=1, max_length=64)]
_Said = Annotated[list[str], Field(max_length=20)]
_Parameters = Annotated[dict[_Name, float], Field(max_length=20)]
_Hidden = Annotated[
    _Size | _Parameters,
    Either("must be small, medium or large, or names of parameters with numbers"),
]


def _effects(given: Any, info: ValidationInfo) -> Any:
    """Effects with their sizes, of texts `id`, `id:large` or `id:par=value,…`, too."""
    return _of_texts(given, info, _effect_size, {})


def _sizes(given: Any, info: ValidationInfo) -> Any:
    """Faults or events with their sizes, of texts `id` or `id:size`, too."""
    return _of_texts(given, info, _number, None)


def _of_texts(given: Any, info: ValidationInfo, read: Any, unsized: Any) -> Any:
    """Names with what `read` makes of their sizes, or `unsized`; what is no texts as it is."""
    texts = [given] if isinstance(given, str) else given
    # What is no text goes on as it is: the field's own rule refuses it, in the words of every door.
    if not isinstance(texts, list | tuple) or not all(isinstance(text, str) for text in texts):
        return {} if given is None else given
    where, sized = str(info.field_name), {}
    for text in texts:
        name, colon, size = text.partition(":")
        if not name:
            raise BadInput(repr(text), where, "must have the form ID[:SIZE]")
        sized[name] = read(size, text, where) if colon else unsized
    return sized


def _effect_size(size: str, text: str, where: str) -> Any:
    if size in SIZES:
        return size
    parameters = {}
    for part in size.split(","):
        name, equals, value = part.partition("=")
        if not equals:
            rule = f"{name!r} must be par=value, or {known_names(name, SIZES, 'one of')}"
            raise BadInput(repr(text), where, rule)
        parameters[name] = _number(value, text, where)
    return parameters


def _number(value: str, text: str, where: str) -> float:
    try:
        return float(value)
    except ValueError:
        raise BadInput(repr(text), where, f"{value!r} is not a number") from None


def _value(given: Any) -> Any:
    """A setting's value; a text that is a number, true or false as what it says."""
    if not isinstance(given, str):
        return given
    if given.lower() in ("true", "false"):
        return given.lower() == "true"
    try:
        return float(given)
    except ValueError:
        return given


_Effects = Annotated[
    dict[_Name, _Hidden],
    Field(max_length=20),
    BeforeValidator(_effects, json_schema_input_type=dict[_Name, _Hidden] | _Said),
]
_Sizes = Annotated[
    dict[_Name, float | None],
    Field(max_length=20),
    BeforeValidator(_sizes, json_schema_input_type=dict[_Name, float | None] | _Said),
]


_Value = Annotated[
    bool | float | str, BeforeValidator(_value), Either("must be a number, a text, true or false")
]
_Settings = Annotated[dict[_Name, _Value], Field(max_length=20)]


class Simulate(Question):
    """A record of a virtual machine, with what is hidden in it."""

    singular: ClassVar[Mapping[str, str]] = {
        "effects": "effect",
        "faults": "fault",
        "events": "event",
        "settings": "set",
    }

    effects: _Effects = field(
        {},
        "Physics that the built-in model of the machine does not have: ID, ID:small, ID:medium,"
        " ID:large or ID:par=value,…",
        example={"coulomb-friction": "large"},
        written="ID[:SIZE]",
    )
    faults: _Sizes = field(
        {},
        "Damage from the start, of its usual size where none is said.",
        written="ID[:SIZE]",
    )
    events: _Sizes = field(
        {},
        "Operating events at the next occasion, of their usual size where none is said.",
        written="ID[:SIZE]",
    )
    duration: float | None = field(
        None, "Length of the record [s]. Default: the machine's own.", gt=0, le=1e6
    )
    seed: int = field(0, "Seed of noise, disturbances and start values.", ge=0, le=2**32 - 1)
    exemplar: int = field(0, "Number of the specimen; 0 is the nominal one.", ge=0, le=2**32 - 1)
    profile: str | None = field(None, "Input profile, for machines that have several.")
    rate: float | None = field(
        None, "Sampling rate [Hz], for machines that offer it.", gt=0, le=1e9
    )
    noise_color: float | None = field(
        None, "Correlation of the noise from sample to sample.", ge=0, le=0.9999
    )
    settings: _Settings = field({}, "Other settings of the machine.")
    reveal: bool = field(False, "Write the truth into the record's notes.")

    @property
    def of_the_machine(self) -> dict[str, bool | float | str]:
        """What the machine itself is asked for; names as its code writes them."""
        own = {name.replace("-", "_"): value for name, value in self.settings.items()}
        asked = {"profile": self.profile, "rate": self.rate, "noise_color": self.noise_color}
        return own | {name: value for name, value in asked.items() if value is not None}
