"""What refusals name as the way on, said to a client: the library speaks of options of commands and of Python.

Files that come with the request are spoken of in `api/reading_options`; this is for records that are stored already.
"""

import json
import re
from urllib.parse import quote

from residuum.identification.errors import BadInput
from residuum.identification.record_formats.remedies import IN_PYTHON

_UNIT = re.compile(r"--unit (?:'([^=']+)=([^']+)'|([^\s=,;)]+)=([^\s,;)]+))")
_MAP = re.compile(r"--map ([^\s=,;)]+)=([^\s,;)]+)")


def as_key(field: str, value: object = None) -> str:
    """A field of a question as it is said in a body."""
    return f'"{field}"' if value is None else f'"{field}": {json.dumps(value, ensure_ascii=False)}'


def said_over_http(error: BadInput) -> str:
    """A refusal whose way on is one of the interface: a key of the query with which the record is stored, or of the body.

    >>> said_over_http(BadInput("unit none is no '%'; say it, --unit duty=% if it is in that, in Python units={'duty': '%'}"))
    "unit none is no '%'; say it, POST /records?unit=duty=%25 if it is in that"
    >>> said_over_http(BadInput("say it, --unit 'Motor voltage=V' if it is in that"))
    'say it, POST /records?unit=Motor%20voltage=V if it is in that'
    >>> said_over_http(BadInput("map one of them: --map u=COLUMN, in Python map={'u': 'COLUMN'}"))
    'map one of them: "map": {"u": "COLUMN"} in the body'
    """
    says = error.told(as_key)
    if "--" not in says:
        return says
    says = _UNIT.sub(_unit_key, IN_PYTHON.sub("", says)).replace("--resample", "POST /records?resample=true")
    return _MAP.sub(lambda found: f'"map": {{"{found[1]}": "{found[2]}"}} in the body', says)


def _unit_key(found: re.Match[str]) -> str:
    name, unit = (each for each in found.groups() if each is not None)
    return f"POST /records?unit={quote(name)}={quote(unit, safe='/*')}"
