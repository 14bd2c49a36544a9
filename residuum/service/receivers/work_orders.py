"""Work orders: an alarm in the JSON that another program's interface takes, and the number that it
gives back.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, Literal

import orjson
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from residuum.identification.errors import BadInput
from residuum.identification.yaml_text import read_yaml
from residuum.nearest_names import known_names
from residuum.service.alarms.alarm_states import MACHINE, AlarmEvent
from residuum.service.receivers.alarm_text import alarm_text, says_of, value_of

TEMPLATES = Path(__file__).parent / "templates"
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_PLACE = re.compile(r"{(\w+)}")
# Characters of a number that is kept.
_LONGEST = 100
PLACES = (
    "machine",
    "object",
    "title",
    "what",
    "value",
    "text",
    "link",
    "priority",
    "since",
    "since_day_ms",
    "since_duration",
)
"""What a template may name in braces."""

Scalar = str | int | float | bool


class OrderTemplate(BaseModel):
    """A template: the body with names in braces, and where the answer has the order's number."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    body: dict[str, Any] = Field(min_length=1)
    longest: dict[str, int] = {}
    priorities: dict[Literal["high", "medium", "low", "none"], Scalar] = {}
    headers: dict[str, str] = {}
    order: list[str] = []
    csrf: bool = False


def read_template(name: str) -> OrderTemplate:
    """The template of this name that comes with Residuum, or a YAML or JSON file; BadInput says what
    it lacks.
    """
    own = TEMPLATES / f"{name}.yaml"
    file = own if "/" not in name and own.is_file() else Path(name)
    if not file.is_file():
        known = known_names(name, sorted(path.stem for path in TEMPLATES.glob("*.yaml")))
        raise BadInput(f"setting receivers, template: no such file: {name}; {known}")
    try:
        template = OrderTemplate.model_validate(read_yaml(file, BadInput))
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        where = ".".join(map(str, first["loc"])) or "the file"
        raise BadInput(f"setting receivers, template {name}: {where}: {first['msg']}") from None
    for place in _places(template.body):
        if place not in PLACES:
            raise BadInput(
                f"setting receivers, template {name}: {{{place}}}: {known_names(place, PLACES)}"
            )
    return template


def is_order(kind: str, payload: Mapping[str, Any]) -> bool:
    """Whether a notice is one that a work order is made of: a fault of a machine that comes onto the
    list for the first time since its alarm was normal.
    """
    return kind == "alarm" and payload.get("kind") == MACHINE and payload.get("first") is True


def order_body(
    template: OrderTemplate,
    payload: Mapping[str, Any],
    *,
    public_url: str | None,
    fields: Mapping[str, Scalar],
    objects: Mapping[str, str],
) -> dict[str, Any]:
    """The body of a work order.

    Parameters
    ----------
    fields : mapping
        Constants, which stand before what the template says.
    objects : mapping
        Machine → what the other program calls it; a machine that is not there has its own name.
    """
    # of the fault, also where it is told late: when its alarm is released
    text = alarm_text("alarm", {**payload, "change": AlarmEvent.RAISE.value}, public_url)
    asset = str(payload["asset"])
    since = datetime.fromisoformat(payload["raised_at"]).astimezone(UTC)
    day = since.replace(hour=0, minute=0, second=0, microsecond=0)
    values: dict[str, Scalar] = {
        "machine": asset,
        "object": objects.get(asset, asset),
        "title": text.title,
        "what": says_of(payload),
        "value": value_of(payload),
        "text": text.plain,
        "link": text.link or "",
        "priority": template.priorities.get(payload.get("priority") or "none", ""),
        "since": since.isoformat(timespec="seconds"),
        "since_day_ms": (day - _EPOCH) // timedelta(milliseconds=1),
        "since_duration": f"PT{since:%H}H{since:%M}M{since:%S}S",
    }
    body = {
        name: _bounded(_filled(value, values), template.longest.get(name))
        for name, value in template.body.items()
    }
    return {**body, **fields}


def order_number(template: OrderTemplate, answer: bytes) -> str | None:
    """The number of the order in an answer; None where it gives none back."""
    try:
        content = orjson.loads(answer)
    except orjson.JSONDecodeError:
        return None
    for path in template.order:
        found = content
        for key in path.split("."):
            found = found.get(key) if isinstance(found, Mapping) else None
        if isinstance(found, str | int) and not isinstance(found, bool) and str(found).strip():
            return " ".join(str(found).split())[:_LONGEST]
    return None


def _filled(value: Any, values: Mapping[str, Scalar]) -> Any:
    """A value of a template with what is named in its braces; a name alone keeps its kind."""
    if isinstance(value, Mapping):
        return {name: _filled(part, values) for name, part in value.items()}
    if isinstance(value, list):
        return [_filled(part, values) for part in value]
    if not isinstance(value, str):
        return value
    alone = _PLACE.fullmatch(value)
    if alone:
        return values[alone[1]]
    return _PLACE.sub(lambda place: str(values[place[1]]), value)


def _places(value: Any) -> Sequence[str]:
    if isinstance(value, Mapping):
        return [place for part in value.values() for place in _places(part)]
    if isinstance(value, list):
        return [place for part in value for place in _places(part)]
    return _PLACE.findall(value) if isinstance(value, str) else []


def _bounded(value: Any, longest: int | None) -> Any:
    if longest is None or not isinstance(value, str) or len(value) <= longest:
        return value
    return f"{value[: longest - 1]}…"
