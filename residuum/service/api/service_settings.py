"""What is set: every setting of the running service, with its default and its meaning."""

from __future__ import annotations

import re
from typing import Any
from urllib.parse import urlsplit

from fastapi import APIRouter, Response
from pydantic_core import to_jsonable_python

from residuum.service.api.answers import PROBLEMS
from residuum.service.api.responses import Json, StrictRoute
from residuum.service.broker import with_hidden_password
from residuum.service.services import Running
from residuum.service.settings import Settings

_PASSWORD_IN_QUERY = re.compile(r"(password=)[^&]*")  # as a database's URL may have it

router = APIRouter(tags=["settings"], route_class=StrictRoute, responses=PROBLEMS)


@router.get("/settings")
def list_settings(running: Running) -> Response:
    """Every setting with its value, whether it was set, and what it means; passwords, secrets and
    the paths of webhooks are hidden.
    """
    settings = running.settings
    values = to_jsonable_python(
        {name: getattr(settings, name) for name in Settings.model_fields}, inf_nan_mode="strings"
    )
    rows = [
        {
            "name": name,
            "value": _shown(name, values[name]),
            "set": name in settings.model_fields_set,
            "meaning": field.description,
        }
        for name, field in Settings.model_fields.items()
    ]
    return Json({"items": rows, "next_cursor": None})


def _shown(name: str, value: Any) -> Any:
    """A value without what only its owner may know; of machines their names, for each has a route
    of its own.
    """
    if name == "machines":
        return [machine["asset"] for machine in value]
    # Secrets are marks already; what is not set says nothing.
    if name == "receivers":
        return [
            {key: value for key, value in receiver.items() if value not in (None, "", {}, [])}
            for receiver in value
        ]
    # The paths of many webhooks are their secret.
    if name == "webhooks":
        return [f"{urlsplit(address).scheme}://{urlsplit(address).hostname}/…" for address in value]
    return (
        _PASSWORD_IN_QUERY.sub(r"\1***", with_hidden_password(value))
        if isinstance(value, str)
        else value
    )
