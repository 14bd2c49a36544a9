"""Effects of a user's own, written in YAML: the equation, its parameters and states, and where it
acts.

    effects:
      - id: dent
        title: Dent in the rail
        acts_on: [force, torque]                    # kinds of balance, or input, or output
        term: -tau * exp(-((position - q_0) / w)**2) * sign(velocity)
        parameters:
          tau: {value: 0, unit: N, lower: 0, size: true, meaning: friction in the dent}
          q_0: {value: 0.1, unit: m, meaning: its place}
          w:   {value: 0.02, unit: m, lower: 1e-6, meaning: its half width}
        reference: our own measurement of May

`term` is added to the balance and may name its variables by role (position, velocity, current,
temperature, ambient, level, supply), the effect's parameters and states; `signal` is, for an input
or output, what becomes of it, and names it `signal`. The equation is in SI units of its kind of
balance (a volume balance in m**3/s, its level in m), whatever the model has. Parameters with `size:
true` vanish with the effect. `states` is a mapping of name to `{unit, rate, start}`.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from residuum.identification.errors import BadModel
from residuum.identification.physics.compile import symbolic as sp
from residuum.identification.physics.compile.expression_meaning import symbolic
from residuum.identification.physics.effects.base import (
    Conditions,
    Contribution,
    Effect,
    Parameter,
    Scene,
    Site,
)
from residuum.identification.physics.effects.example_models import Example
from residuum.identification.physics.files.dimension import dimension_of, dimension_of_unit
from residuum.identification.physics.files.expression import Expression, parse
from residuum.identification.physics.files.yaml_tree import (
    Listing,
    Scalar,
    Table,
    read_text,
    read_tree,
)
from residuum.identification.physics.model import BALANCE_KINDS, ROLE_UNITS
from residuum.identification.units import compatible, convert
from residuum.nearest_names import known_names

OWN_ID = r"[a-z][a-z0-9]*(-[a-z0-9]+)*"
DEFINITION_KEYS = ("id", "title", "acts_on", "term", "signal", "parameters", "states", "reference")
PLACES = (*(kind for kind in BALANCE_KINDS if kind != "signal"), "signal", "input", "output")
_FIRST = 0.1
"""Part of the balance's driving terms that an effect begins with."""


@dataclass(frozen=True)
class OwnState:
    """A state of an effect: its unit, its derivative, and where it begins."""

    unit: str
    rate: Expression
    start: Expression


class WrittenEffect(Effect):
    """An effect that a file defines; `definition` is what the file says."""

    def __init__(
        self, definition: Mapping[str, Any], equation: Expression, states: Mapping[str, OwnState]
    ) -> None:
        self.definition = dict(definition)
        self.id = definition["id"]  # type: ignore[misc]
        self.title = definition.get("title", self.id)  # type: ignore[misc]
        self.equation = equation.text  # type: ignore[misc]
        self.reference = definition.get("reference", "")  # type: ignore[misc]
        self.acts_on = tuple(definition["acts_on"])  # type: ignore[misc]
        self._own = tuple(
            _parameter(name, entry) for name, entry in definition["parameters"].items()
        )
        sizes = [name for name, entry in definition["parameters"].items() if entry.get("size")]
        self.sizes = tuple(sizes)  # type: ignore[misc]
        needs = [role for role in ROLE_UNITS if role in _names(equation, states)]
        self.needs = tuple(needs)  # type: ignore[misc]
        # An exact standstill exists only once there is some friction: derivatives at zero are taken
        # a little above.
        self.rest = 0.001 if "sign" in equation.text else 0.0  # type: ignore[misc]
        self._equation = equation
        self._states = dict(states)

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        """As the file has them, wherever it stands."""
        return self._own

    def states(self, site: Site) -> Mapping[str, str]:
        """Name → unit."""
        return {name: state.unit for name, state in self._states.items()}

    def contribution(self, scene: Scene) -> Contribution:
        """The equation in the scene's symbols; `sign(velocity)` is exact at standstill.

        The file is written in SI units: what a model has in others (litres, degrees) is converted
        on its way in and out.
        """
        variables = {
            role: _in_si(role, value, scene.site) for role, value in scene.variables.items()
        }
        names = {**variables, **scene.p, **scene.x, "signal": scene.signal}
        signs = {
            # The sign of a velocity or a current is the direction that the integrator switches.
            role: scene.direction
            for role in ("velocity", "current")
            if role in scene.variables
        }
        value = symbolic(self._equation.tree, names, signs)
        rates = {n: symbolic(s.rate.tree, names, signs) for n, s in self._states.items()}
        initial = {n: symbolic(s.start.tree, names, signs) for n, s in self._states.items()}
        if self.place == "balance":
            return Contribution(term=value * _of_si(scene.site), rates=rates, initial=initial)
        return Contribution(signal=value, rates=rates, initial=initial)

    def starts(self, conditions: Conditions) -> Sequence[Mapping[str, float]]:
        """The file's values; sizes that are zero there, so large that the term is a tenth of what
        drives the balance.
        """
        values = {p.name: p.value for p in self._own}
        open_ = [name for name in self.sizes if values[name] == 0.0]
        if not open_:
            return [values]
        # The term is taken to be proportional to its sizes: at 1 it says how large they have to be.
        unit_sizes = values | dict.fromkeys(open_, 1.0)
        largest = self._largest(unit_sizes, conditions)
        known = {p.name: p for p in self._own}
        size = _FIRST * conditions.magnitude / largest
        # A size that may be negative is tried both ways.
        signs = (1.0, -1.0) if any(known[n].lower < 0.0 for n in open_) else (1.0,)
        starts = []
        for sign in signs:
            sizes = {n: np.clip(sign * size, known[n].lower, known[n].upper) for n in open_}
            starts.append(values | {name: float(value) for name, value in sizes.items()})
        return starts

    def _largest(self, values: Mapping[str, float], conditions: Conditions) -> float:
        """Largest magnitude of the term at these values along the operation; 1 where states of its
        own decide.
        """
        if self._states or self.place != "balance":
            return 1.0
        names = {name: sp.Symbol(name, real=True) for name in _names(self._equation, self._states)}
        expression = symbolic(self._equation.tree, names, {})
        known = [conditions.variables[n] if n in conditions.variables else values[n] for n in names]
        with np.errstate(all="ignore"):
            along = np.atleast_1d(
                np.asarray(
                    sp.lambdify(list(names.values()), expression, "numpy")(*known), dtype=float
                )
            )
        finite = np.abs(along[np.isfinite(along)])
        return float(finite.max(initial=0.0)) or 1.0

    def examples(self) -> Sequence[Example]:
        """None: what stands for it is the user's record."""
        return []


def read_effects(path: str | Path) -> list[WrittenEffect]:
    """The effects that a file defines.

    Raises
    ------
    BadModel
        No such file, or anything wrong in it, with line and column.
    """
    file = Path(path)
    if not file.is_file():
        raise BadModel(f"catalogue {str(path)!r}: no such file")
    return effects_in(read_text(file, "catalogue"), file.name)


def effects_in(text: str, source: str = "catalogue") -> list[WrittenEffect]:
    """The effects that a text defines; `source` names it in refusals."""
    tree = read_tree(text, source, "a catalogue is a mapping that begins with 'effects:'")
    tree.only(("effects",), "catalogue")
    return effects_of(tree.entries.get("effects"), tree)


def effects_of(listing: Scalar | Listing | Table | None, tree: Table) -> list[WrittenEffect]:
    """The effects of a list of definitions."""
    if not isinstance(listing, Listing):
        raise tree.place.refuse("effects must be a list of definitions")
    effects = []
    for item in listing.items:
        if not isinstance(item, Table):
            raise item.place.refuse("effects: each entry is a mapping with 'id'")
        effects.append(_effect(item))
    return effects


def _effect(item: Table) -> WrittenEffect:
    item.only(DEFINITION_KEYS, "effect")
    id = item.scalar("id", "effect")
    label = f"effect {id.text!r}"
    if not re.fullmatch(OWN_ID, id.text):
        raise id.place.refuse(f"{label}: an id is of small letters, digits and '-'")
    acts_on = _acts_on(item, label)
    # Paths and balances are not mixed (`_acts_on`): the first kind says which it is.
    on_path = acts_on[0] in ("input", "output")
    if ("signal" in item.entries) != on_path or ("term" in item.entries) == on_path:
        raise item.place.refuse(f"{label}: a balance gets a 'term', an input or output a 'signal'")
    text = item.scalar("signal" if on_path else "term", label)
    definition: dict[str, Any] = {
        "id": id.text,
        "acts_on": acts_on,
        "signal" if on_path else "term": text.text,
    }
    definition |= {
        key: item.scalar(key, label).text for key in ("title", "reference") if key in item.entries
    }
    definition["parameters"] = _parameters(item.table("parameters", label), label)
    states = _states(item.table("states", label), label)
    if states:
        definition["states"] = {
            n: {"unit": s.unit, "rate": s.rate.text, "start": s.start.text}
            for n, s in states.items()
        }
    equation = parse(text.text, text.place)
    _check(label, equation, states, definition, on_path)
    return WrittenEffect(definition, equation, states)


def _acts_on(item: Table, label: str) -> list[str]:
    listing = item.entries.get("acts_on")
    if not isinstance(listing, Listing) or not listing.items:
        raise item.place.refuse(f"{label}: acts_on is a list of {', '.join(PLACES)}")
    kinds = []
    for kind in listing.items:
        if not isinstance(kind, Scalar) or kind.text not in PLACES:
            raise kind.place.refuse(f"{label}: acts_on is a list of {', '.join(PLACES)}")
        kinds.append(kind.text)
    if len(kinds) > 1 and {"input", "output"} & set(kinds):
        raise listing.place.refuse(
            f"{label}: acts on balances, on an input or on an output, not on several of these"
        )
    return kinds


def _parameters(table: Table, label: str) -> dict[str, dict[str, Any]]:
    parameters = {}
    for name in table:
        part = f"{label}, parameter {name!r}"
        entry = table.table(name, label)
        entry.only(("value", "unit", "lower", "upper", "fixed", "size", "meaning"), part)
        given = {key: entry.scalar(key, part) for key in entry}
        numbers = {
            key: text.number(f"{part}: {key}")
            for key, text in given.items()
            if key in ("value", "lower", "upper")
        }
        flags = {
            key: text.truth(f"{part}: {key}")
            for key, text in given.items()
            if key in ("fixed", "size")
        }
        texts = {key: text.text for key, text in given.items() if key in ("unit", "meaning")}
        # Defaults first: what the file says comes over them.
        parameters[name] = {"value": 0.0, "unit": "", "meaning": name, **texts, **numbers, **flags}
        if (
            not numbers.get("lower", -np.inf)
            <= numbers.get("value", 0.0)
            <= numbers.get("upper", np.inf)
        ):
            raise entry.place.refuse(f"{part}: value is outside its bounds")
    return parameters


def _states(table: Table, label: str) -> dict[str, OwnState]:
    states = {}
    for name in table:
        part = f"{label}, state {name!r}"
        entry = table.table(name, label)
        entry.only(("unit", "rate", "start"), part)
        unit = entry.optional("unit", part)
        start = entry.optional("start", part)
        rate = entry.scalar("rate", part)
        begin = parse("0") if start is None else parse(start.text, start.place)
        states[name] = OwnState(unit.text if unit else "", parse(rate.text, rate.place), begin)
    return states


def _check(
    tag: str,
    equation: Expression,
    states: Mapping[str, OwnState],
    definition: Mapping[str, Any],
    on_path: bool,
) -> None:
    """Names are known, units agree in the first kind of balance, and nothing is left of the effect
    without its sizes.
    """
    own = {*definition["parameters"], *states}
    allowed = own | ({"signal"} if on_path else {*ROLE_UNITS, "supply"})
    _check_names(tag, equation, states, allowed)
    sizes = [name for name, entry in definition["parameters"].items() if entry.get("size")]
    # What states do at zero sizes cannot be seen in the equation alone.
    if not sizes or states:
        return
    _check_vanishes(tag, equation, allowed, sizes, on_path)
    if not on_path and "supply" not in equation.names:
        _check_units(tag, equation, definition)


def _check_names(
    tag: str, equation: Expression, states: Mapping[str, OwnState], allowed: set[str]
) -> None:
    of_states = [e for state in states.values() for e in (state.rate, state.start)]
    for expression in (equation, *of_states):
        if unknown := sorted(expression.names - allowed):
            raise expression.place.refuse(
                f"{tag}: {unknown[0]!r} is not known here;"
                f" {known_names(unknown[0], sorted(allowed), 'there are')}"
            )


def _check_vanishes(
    label: str, equation: Expression, allowed: Iterable[str], sizes: list[str], on_path: bool
) -> None:
    """Where its sizes are zero an effect adds nothing, or leaves the signal as it is."""
    names = {n: sp.Symbol(n, real=True) for n in allowed} | dict.fromkeys(sizes, sp.S.Zero)
    # What is left with sizes of zero: nothing of a term, the signal itself of a path.
    nothing = symbolic(equation.tree, names, {}) - (names["signal"] if on_path else 0)
    if sp.simplify(nothing) != 0:
        raise equation.place.refuse(
            f"{label}: does not vanish where its sizes ({', '.join(sizes)}) are zero"
        )


def _check_units(label: str, equation: Expression, definition: Mapping[str, Any]) -> None:
    kind = definition["acts_on"][0]
    units = {role: by_kind[kind] for role, by_kind in ROLE_UNITS.items() if kind in by_kind}
    units |= {name: entry["unit"] for name, entry in definition["parameters"].items()}
    try:
        dimension = dimension_of(
            equation.tree, {name: dimension_of_unit(unit) for name, unit in units.items()}
        )
    # It names a role that this kind of balance has no unit for: nothing to check by.
    except KeyError:
        return
    expected = dimension_of_unit(BALANCE_KINDS[kind][0])
    if kind != "signal" and not dimension.agrees(expected):
        raise equation.place.refuse(
            f"{label}: the term is in {dimension}; a {kind} balance is in {expected}"
        )


def _in_si(role: str, value: sp.Expr, site: Site) -> sp.Expr:
    """A variable of the model in the unit in which definitions have its role; as it is where that
    is not known.
    """
    unit = site.units.get(role, "")
    own = ROLE_UNITS.get(role, {}).get(site.kind, "")
    if not (unit and own) or not compatible(unit, own):
        return value
    zero, unity = convert([0.0, 1.0], unit, own)
    # In SI already: no factor, so that the equation stays as it was written.
    return value if (zero, unity) == (0.0, 1.0) else float(zero) + float(unity - zero) * value


def _of_si(site: Site) -> float:
    """The unit of definitions for this kind of balance, in the model's; 1 where those do not
    convert.
    """
    own = BALANCE_KINDS[site.kind][0] if site.kind in BALANCE_KINDS else ""
    return float(convert(1.0, own, site.unit)) if own and compatible(own, site.unit) else 1.0


def _parameter(name: str, entry: Mapping[str, Any]) -> Parameter:
    lower = float(entry.get("lower", "-inf"))
    upper = float(entry.get("upper", "inf"))
    value = float(entry["value"])
    fixed = bool(entry.get("fixed"))
    return Parameter(name, value, entry["unit"], lower, upper, fixed, entry["meaning"])


def _names(equation: Expression, states: Mapping[str, OwnState]) -> frozenset[str]:
    return equation.names.union(*(s.rate.names | s.start.names for s in states.values()))
