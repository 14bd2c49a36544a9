"""What refusals name as the way on, said to a client: a key of the query with which a file comes,
or of a body.
"""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from urllib.parse import quote

from starlette.types import ASGIApp, Receive, Scope, Send

from residuum.identification.errors import SAID_IN, BadInput, Named, as_texts

_OF_FILES = (
    "resample",
    "sample_time",
    "units",
    "decimal",
    "time",
    "missing",
    "names",
    "duplicates",
    "reordered",
)
# How a file is read, in Python → key of the query, where these differ.
_KEYS = {"units": "unit", "time": "time_form"}


class SaidToClients:
    """Lets what answers a request name fields as its client gives them."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request."""
        # Set anew by each request, which runs in a context of its own.
        SAID_IN.set(as_key)
        await self.app(scope, receive, send)


@contextmanager
def refusing_in(named: Named) -> Iterator[None]:
    """Let refusals of what came in this way be told in these words."""
    try:
        yield
    except BadInput as error:
        error.named = named
        raise


def as_key(field: str, value: object = None) -> str:
    """A field of a question as it is said in a body; how a file is read is said where its record is
    stored.

    >>> as_key("delay", 3), as_key("units", {"duty": "%"}), as_key("map", {"u": "COLUMN"})
    ('"delay": 3', 'POST /records?unit=duty=%25', '"map": {"u": "COLUMN"} in the body')
    """
    if field in _OF_FILES:
        return in_upload(field, value)
    if value is None:
        return f'"{field}"'
    member = f'"{field}": {json.dumps(value, ensure_ascii=False)}'
    return f"{member} in the body" if field == "map" else member


def in_upload(field: str, value: object = None) -> str:
    """How a file is read, as it is said where its record is stored."""
    return f"POST /records{as_query(field, value)}"


def as_query(field: str, value: object = None) -> str:
    """How a file is read, as a key of the query with which it comes.

    >>> as_query("time", "day first"), as_query("map", {"time": "COLUMN"})
    ('?time_form=day%20first', '?time=COLUMN')
    >>> as_query("units", {"duty": "%"})
    '?unit=duty=%25'
    >>> as_query("missing", ["85", "-127"])
    '?missing=85&missing=-127'
    """
    if field not in (*_OF_FILES, "map"):
        return as_key(field, value)
    of_times = field == "map" and isinstance(value, dict) and "time" in value
    key = "" if of_times else _KEYS.get(field, field)
    if value is None:
        return f"?{key}"
    texts = as_texts(field, "true" if value is True else value)
    # left as they are where a query takes them: what is shown is typed again by people
    quoted = [quote(text, safe="=/*,:[]") for text in texts]
    return f"?{quoted[0] if of_times else '&'.join(f'{key}={text}' for text in quoted)}"


def in_json(field: str, value: object = None) -> str:
    """How a body in JSON is read, which says its units itself.

    >>> in_json("units", {"speed": "rpm"})
    '"units": {"speed": "rpm"} in the body'
    """
    return (
        f'"units": {json.dumps(value, ensure_ascii=False)} in the body'
        if field == "units"
        else as_query(field, value)
    )


def of_array(field: str, value: object = None) -> str:
    """How an array is read, whose rows the query names with their units.

    >>> of_array("units", {"speed": "rpm"})
    '?channel=speed%20[rpm]'
    """
    if field != "units" or not isinstance(value, dict):
        return as_query(field, value)
    return "".join(
        f"?channel={quote(f'{name} [{unit}]', safe='/*[]')}" for name, unit in value.items()
    )
