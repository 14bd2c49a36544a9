"""The questions `score` and `train`: how a diagnoser judges, and from what it learns."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BeforeValidator, Field, ValidationInfo

from residuum.identification.errors import BadInput
from residuum.library.questions import Question, field
from residuum.library.questions.names import Names

_FORM = "bpfi=5.4,…"


def _frequencies(given: Any, info: ValidationInfo) -> Any:
    """Names with numbers, of texts `bpfi=5.4,bpfo=3.6`, too; names in small letters."""
    texts = [given] if isinstance(given, str) else given
    if isinstance(texts, list | tuple):
        parts = [part for text in texts for part in str(text).split(",")]
        given = dict(_pair(part, str(info.field_name)) for part in parts)
    if not isinstance(given, dict):
        return given
    return {str(name).strip().lower(): value for name, value in given.items()}


def _pair(text: str, where: str) -> tuple[str, str]:
    name, equals, value = text.partition("=")
    if not (name.strip() and equals):
        raise BadInput(repr(text), where, "must be name=number")
    return name, value


Frequencies = Annotated[
    dict[str, float] | None,
    Field(max_length=20),
    BeforeValidator(_frequencies, json_schema_input_type=dict[str, float] | str | None),
]
_METHODS = (
    "Method that decides: source or default (gate-actuator, robust-residual). Every finding shows"
    " both."
)


class Score(Question):
    """What a diagnoser says of records. A setting that the diagnoser has not is refused."""

    speed_rpm: float | None = field(
        None, "Bearing: shaft speed [rpm], when the record has no speed channel.", gt=0, le=1e7
    )
    orders: Frequencies = field(
        None, "Bearing: fault frequencies in multiples of shaft speed.", written=_FORM
    )
    hertz: Frequencies = field(None, "Bearing: fault frequencies [Hz].", written=_FORM)
    method: str | None = field(None, _METHODS)
    # At most one a second.
    false_alarms_per_day: float | None = field(
        None,
        "Number of false alarms a day that is accepted (model-based; robust-residual when it is"
        " trained).",
        gt=0,
        le=86400,
    )

    @property
    def settings(self) -> dict[str, Any]:
        """The settings that were given, as a diagnoser takes them."""
        # What was not said is left out: a diagnoser refuses a setting that it does not have.
        return self.model_dump(exclude_none=True, exclude_defaults=True)


class Train(Score):
    """A diagnoser that has learned from records."""

    model: str | None = field(None, "Model-based: a model file, a built-in model, or an FMU.")
    free: Names = field(
        None,
        "Model-based: follow these values of the model from window to window, and hold all others."
        " Default: those that the model does not hold fixed; of an FMU they have to be named.",
    )
    fix_undetermined: bool = field(
        False,
        "Model-based: keep the file's value of a parameter that the healthy records do not"
        " determine.",
    )
