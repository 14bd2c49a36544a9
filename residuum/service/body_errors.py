"""What may be wrong with the body of a request, whatever it is read as."""

from __future__ import annotations

from residuum.identification.errors import BadInput


class BadBody(BadInput):
    """The body of a request is not what its content type says (malformed JSON, no array, wrong
    length).
    """


class UnsupportedBody(BadInput):
    """The content type of a request is none that the route reads."""


class TooLarge(BadInput):
    """The body of a request, or what it declares to hold, is larger than the limit."""
