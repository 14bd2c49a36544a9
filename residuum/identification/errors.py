"""The exceptions of Residuum's mathematics, one class a scenario.

Every message is one line that says *what* is wrong, *where*, and *which rule* it breaks, because
the command line and the HTTP interface print it unchanged.
"""

from collections.abc import Callable, Iterable, Mapping
from contextvars import ContextVar
from typing import Any

# Characters: some libraries repeat a whole file in what they say.
_LONGEST = 200

MAY_DIVERGE = "check the signs of its terms, their units and the start values"
"""How to go on with a model whose simulation diverges."""


def in_one_line(error: Exception) -> str:
    """Another library's exception as part of our line: its class and what it says, cut after 200
    characters.
    """
    return " ".join(f"{type(error).__name__}: {error}".split())[:_LONGEST]


Named = Callable[[str, object], str]
"""How a door names one of its fields, alone (`None`) or with a value: `--delay 3`, `"delay": 3`,
`delay=3`.
"""


Way = tuple[str, object] | tuple[str, object, str]
"""A field, a value with which it would do (`"SECONDS"`: one that only the caller knows), and
perhaps when it would.
"""


def as_keyword(field: str, value: object = None) -> str:
    """A field as it is said in Python."""
    # In capitals stands what only the caller knows, `SECONDS`: no text to be quoted.
    return field if value is None else f"{field}={value if str(value).isupper() else repr(value)}"


def as_text(value: object) -> str:
    """A value as it is said outside of Python: of a mapping `name=value`, of a list its items with
    commas between them.

    >>> as_text({"speed": "rpm"}), as_text(["time [s]", "n"]), as_text(3)
    ('speed=rpm', 'time [s],n', '3')
    """
    if isinstance(value, Mapping):
        return ",".join(f"{name}={of_it}" for name, of_it in value.items())
    return ",".join(map(str, value)) if isinstance(value, list | tuple) else str(value)


SAID_IN: ContextVar[Named] = ContextVar("how a field is said", default=as_keyword)
"""The words in which a question was asked here; a door other than Python's sets its own."""


def said(field: str, value: object = None) -> str:
    """A field as a sentence of an answer names it, in the words in which was asked.

    >>> said("missing", ["85"])
    "missing=['85']"
    """
    return SAID_IN.get()(field, value)


def as_texts(field: str, value: object) -> list[str]:
    """A field's value as it is said outside of Python, in one text or, where an item may hold a
    comma, in one an item.

    >>> as_texts("missing", ["OL", "1,5"]), as_texts("names", ["n", "m"])
    (['OL', '1,5'], ['n,m'])
    """
    # A cell that means no value may hold a comma itself.
    apart = field == "missing" and isinstance(value, list | tuple)
    return list(map(str, value)) if apart else [as_text(value)]  # type: ignore[call-overload]


class BadInput(ValueError):
    """Something a caller handed over cannot be used; the message names what, where and the rule.

    Where the input is a field of a question, `what` is its value, `where` its name, and `way_on`
    may name fields and values with which it would do; `str(error)` says them in the words of
    `SAID_IN`, `told` in those of a door. A text that names a way on of its own ends in `, or`.

    >>> import residuum as rs
    >>> rs.simulate("gate-drive", duration=2.0, colour="red")  # doctest: +ELLIPSIS
    Traceback (most recent call last):
        ...
    residuum.identification.errors.BadInput: gate-drive: has no setting 'colour'; known are ...
    >>> error = BadInput("-3", "delay", "must be ≥ 0", way_on=[("delay", 3)])
    >>> print(error)
    delay -3: must be ≥ 0; say delay=3
    >>> error.told(lambda field, value: f"--{field}" if value is None else f"--{field} {value}")
    '--delay -3: must be ≥ 0; say --delay 3'
    """

    named: Named | None = None
    """The words of the door through which the input came, where another one tells the refusal."""

    def __init__(
        self, what: str, where: str = "", rule: str = "", *, way_on: Iterable[Way] = ()
    ) -> None:
        self.what, self.where, self.rule, self.way_on = what, where, rule, tuple(way_on)
        # The parts, not a sentence: its words are those of the door that tells it.
        super().__init__(what, where, rule)

    def __str__(self) -> str:
        return self.told(SAID_IN.get())

    def told(self, named: Named) -> str:
        """The refusal in the words of a door."""
        named = self.named or named
        place = " ".join(
            text for text in (self.where and named(self.where, None), self.what) if text
        )
        ways = [" ".join([named(field, value), *when]) for field, value, *when in self.way_on]
        says = f"{place}: {self.rule}" if self.rule else place
        if not ways:
            return says
        listed = (", or " if any(len(way) > 2 for way in self.way_on) else " or ").join(ways)
        return f"{says}{'' if says.endswith(', or') else ';'} say {listed}"

    @property
    def parts(self) -> dict[str, Any]:
        """Its parts as plain values, of which another process makes it again."""
        return {"what": self.what, "where": self.where, "rule": self.rule, "way_on": self.way_on}


class BadRecord(BadInput):
    """A record or record file breaks the record rules (uneven sampling, text in a number column,
    …).

    >>> import residuum as rs
    >>> rs.from_arrays({"u": [1.0, 2.0]}, units={"u": "V"}, sample_time=0.0)
    Traceback (most recent call last):
        ...
    residuum.identification.errors.BadRecord: record: sample_time is 0.0; must be a positive number of seconds
    """


class BadUnit(BadInput):
    """A unit is unknown, or incompatible with the one that is needed.

    >>> import residuum as rs
    >>> rs.from_arrays({"u": [1.0]}, units={"u": "V"}, sample_time=0.1).in_unit("u", "A")  # doctest: +ELLIPSIS
    Traceback (most recent call last):
        ...
    residuum.identification.errors.BadUnit: channel 'u': unit 'V' cannot be converted to 'A'; ...
    """


class BadModel(BadInput):
    """A model file or a model built in code is not well formed; the message carries line and
    column.

    >>> import residuum as rs
    >>> rs.model("linear-axis").with_values(weight=90.0)  # doctest: +ELLIPSIS
    Traceback (most recent call last):
        ...
    residuum.identification.errors.BadModel: ...
    """


class Forbidden(BadInput):
    """It would run code that is run only where somebody allowed that."""


class NoExplicitEquations(BadModel):
    """A model whose equations cannot be made explicit: an algebraic loop, a division by zero, a
    function without a slope.

    A search takes effects that raise it as none that can be tried here; whatever else an effect
    raises is a fault in it.

    >>> from residuum.identification.physics import read_model
    >>> winding = "{kind: voltage, storage: 0, terms: {supply: u, diode: -R * max(i, 0)}, current: i}"
    >>> text = "inputs: {u: V}\\nparameters: {R: {value: 1, unit: ohm}}\\noutputs: {i: {value: i, unit: A}}"
    >>> read_model(f"name: diode\\n{text}\\nbalances: {{winding: {winding}}}")  # doctest: +ELLIPSIS
    Traceback (most recent call last):
        ...
    residuum.identification.errors.NoExplicitEquations: ... algebraic loop: ...
    """


class NotIdentifiable(BadInput):
    """The data cannot determine what was asked for (too short, input does not excite, …).

    >>> import residuum as rs
    >>> record = rs.from_arrays({"u": [0.0] * 300, "y": [0.0] * 300}, units={"u": "V", "y": "V"}, sample_time=0.1)
    >>> rs.identify(record, input="u", output="y")  # doctest: +ELLIPSIS
    Traceback (most recent call last):
        ...
    residuum.identification.errors.NotIdentifiable: ...
    """
