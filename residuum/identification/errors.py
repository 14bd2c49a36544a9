"""The exceptions of Residuum's mathematics, one class a scenario.

Every message is one line that says *what* is wrong, *where*, and *which rule* it breaks, because the
command line and the HTTP interface print it unchanged.
"""


class BadInput(ValueError):
    """Something a caller handed over cannot be used; the message names what, where and the rule."""


class BadRecord(BadInput):
    """A record or record file breaks the record rules (uneven sampling, text in a number column, …)."""


class BadUnit(BadInput):
    """A unit is unknown, or incompatible with the one that is needed."""


class BadModel(BadInput):
    """A model file or a model built in code is not well formed; the message carries line and column."""


class NotIdentifiable(BadInput):
    """The data cannot determine what was asked for (too short, input does not excite, …)."""
