"""PhysicalModel: a model made of balances, each `storage = sum of terms`, with the physical effects
added to it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations, permutations
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple

from residuum.identification.errors import BadModel
from residuum.identification.physics.effects import EFFECTS, STRUCTURAL
from residuum.identification.physics.effects.base import (
    Effect,
    JoiningEffect,
    Parameter,
    Prior,
    SignalEffect,
    Site,
)
from residuum.nearest_names import did_you_mean, known_names

if TYPE_CHECKING:
    from residuum.identification.physics.files.expression import Expression
    from residuum.identification.physics.foreign import Foreign

BALANCE_KINDS: Mapping[str, tuple[str, tuple[str, ...]]] = MappingProxyType(
    {
        "torque": ("N*m", ("position", "velocity")),
        "force": ("N", ("position", "velocity")),
        "voltage": ("V", ("current",)),
        "heat": ("W", ("temperature", "ambient")),
        "volume": ("m**3/s", ("level",)),
        "signal": ("", ()),
    }
)
"""Balance kind → (unit of its terms, roles of the variables it may name)."""

# In SI: model files of other units are converted to these where effects are checked.
ROLE_UNITS = {
    "position": {"torque": "rad", "force": "m"},
    "velocity": {"torque": "rad/s", "force": "m/s"},
    "current": {"voltage": "A"},
    "temperature": {"heat": "K"},
    "ambient": {"heat": "K"},
    "level": {"volume": "m"},
}
"""Role → its unit in each kind of balance, which units are checked with."""

CHANNELS = ("conveyor", "door")
"""Inputs of these names are offered to effects that know what to do with them."""


CLOCK = "clock"
"""Default of an input that is the time since the record's begin, where records have no column for
it.
"""


@dataclass(frozen=True)
class Input:
    """A recorded input. `default` (a number, a parameter, `clock`) stands in when records lack it
    (`absent`); None: required.
    """

    name: str
    unit: str
    default: str | None = None
    absent: bool = False

    @property
    def is_clock(self) -> bool:
        """Whether it is the time since the record's begin [s]."""
        return self.default == CLOCK


@dataclass(frozen=True)
class State:
    """A state; `rate` names the state that is its derivative (None: a balance gives the
    derivative). A parameter with a value for each record is one that stands still: `of_record`
    holds its declaration, at whose value it begins. `start` is where the estimation of a first
    value begins.
    """

    name: str
    unit: str
    rate: str | None = None
    of_record: Parameter | None = None
    start: float | None = None


@dataclass(frozen=True)
class Output:
    """A recorded output: an expression of states, inputs and variables."""

    name: str
    value: Expression
    unit: str


@dataclass(frozen=True)
class Balance:
    """`storage = sum of terms`; `variables` maps roles (velocity, current, …) to names; `unit` is
    that of its terms.

    Of a balance that is not linear in the variable it defines, Newton's method begins at `start`.
    """

    name: str
    kind: str
    storage: Expression
    terms: Mapping[str, Expression]
    variables: Mapping[str, str] = field(default_factory=dict)
    unit: str = ""
    start: float | None = None

    @property
    def missing(self) -> str:
        """Name of its additive unknown term among the kernel's parameters."""
        return f"missing@{self.name}"

    @property
    def defines(self) -> str | None:
        """The name of the variable that a balance without storage defines."""
        return (
            # The first that it names, in the file's order.
            next(iter(self.variables.values()), None) if self.storage.text in ("0", "0.0") else None
        )


class Key(NamedTuple):
    """An effect of the catalogue at a place: what is asked for, tried, found or ruled out, whatever
    its parameters.

    `target` is a balance, an input or an output, with the signals that the effect is tied to in
    brackets: `tank(next)`.
    """

    effect: str
    target: str

    def __str__(self) -> str:
        return f"{self.effect}@{self.target}"


@dataclass(frozen=True)
class EffectUse:
    """An effect of the catalogue at its place in a model.

    `target` names the balance, input or output; `instance` tells several of one id at one place
    apart; `provenance` is what was known when it was added (file, date, error before and after).
    """

    id: str
    target: str
    parameters: Mapping[str, Parameter]
    instance: int = 1
    provenance: Mapping[str, Any] = field(default_factory=dict)
    own: Effect | None = field(default=None, compare=False)

    @property
    def effect(self) -> Effect:
        """The catalogue's entry, or the one that the model's own file defines."""
        return find_effect(self.id) if self.own is None else self.own

    @property
    def fingerprint(self) -> str:
        """What tells effects of one id apart that users defined; empty for one of the list."""
        return EFFECTS.fingerprint(self.id)

    @property
    def place(self) -> str:
        """The balance, input or output that it acts on: its target without the signals that it is
        tied to.
        """
        return place_of(self.target)

    @property
    def key(self) -> Key:
        """What effect it is, and where."""
        return Key(self.id, self.target)

    @property
    def label(self) -> str:
        """`coulomb-friction@shaft`, with `#2` for a second instance; parameter names are
        `label.name`.
        """
        return f"{self.id}@{self.target}" + (f"#{self.instance}" if self.instance > 1 else "")


@dataclass(frozen=True)
class PhysicalModel:
    """A model made of balances. Immutable; `with_…` return changed copies.

    Build one with `load_model` (built-in name or file) or `read_model` (text). Everything that can
    be wrong with a model is refused there, with line and column.

    Attributes
    ----------
    inputs, states, parameters, balances, outputs : mapping of name to declaration
    effects : tuple of EffectUse
    initial : mapping of state to value
        States whose initial value is known; all others are estimated for each record.
    foreign : Foreign or None
        What computes a part of it outside of its equations, by parameters that no term names.
    """

    name: str
    inputs: Mapping[str, Input]
    states: Mapping[str, State]
    parameters: Mapping[str, Parameter]
    balances: Mapping[str, Balance]
    outputs: Mapping[str, Output]
    effects: tuple[EffectUse, ...] = ()
    initial: Mapping[str, float] = field(default_factory=dict)
    foreign: Foreign[Any] | None = field(default=None, compare=False, repr=False)

    @property
    def all_parameters(self) -> dict[str, Parameter]:
        """Every parameter by its full name: the model's own, then `effect@target.name` of each
        effect.
        """
        # The model's own first: kernels number parameters in this order.
        own = dict(self.parameters)
        for use in self.effects:
            own.update(
                {f"{use.label}.{name}": parameter for name, parameter in use.parameters.items()}
            )
        return own

    @property
    def values(self) -> dict[str, float]:
        """Value of every parameter, by full name."""
        return {name: parameter.value for name, parameter in self.all_parameters.items()}

    @property
    def first_values(self) -> dict[str, float]:
        """Where states begin, as far as the model says it: known, declared for each record, or the
        start of an estimation.
        """
        states = self.states.values()
        starts = {state.name: state.start for state in states if state.start is not None}
        of_record = {state.name: state.of_record.value for state in states if state.of_record}
        # What is known comes last: it holds over any start.
        return {**starts, **of_record, **self.initial}

    @property
    def free(self) -> tuple[str, ...]:
        """Full names of the parameters that estimation may change."""
        return tuple(name for name, parameter in self.all_parameters.items() if not parameter.fixed)

    @property
    def expressions(self) -> list[Expression]:
        """Those of its balances, then those of its outputs."""
        expressions: list[Expression] = []
        for balance in self.balances.values():
            expressions += [balance.storage, *balance.terms.values()]
        return expressions + [output.value for output in self.outputs.values()]

    @property
    def definitions(self) -> dict[str, Expression]:
        """What names in the texts of its expressions stand for, where these keep them."""
        definitions: dict[str, Expression] = {}
        unread = self.expressions
        while unread:
            # a definition's own text may hold names that are defined in turn
            new = {
                name: expression
                for name, expression in unread.pop().where.items()
                if name not in definitions
            }
            definitions |= new
            unread += new.values()
        return definitions

    def site(self, target: str, effect: Effect) -> Site:
        """The balance, input or output of this name as an effect sees it; BadModel when there is
        none.

        A balance, an input and an output may share a name: the one that the effect acts on is
        meant.
        """
        if effect.is_tied(target):
            return self._tied_site(target, effect)
        sites = []
        if balance := self.balances.get(target):
            sites.append(Site(balance.kind, target, balance.unit, self._roles(balance)))
        # Kinds of balances and of paths share no name: `acts_on` tells which one is meant.
        for kind, signals in (("input", self.inputs), ("output", self.outputs)):
            if target in signals:
                sites.append(Site(kind, target, signals[target].unit))
        if sites:
            # Where the effect acts on none of them, the first is what its refusal speaks of.
            return next((site for site in sites if site.kind in effect.acts_on), sites[0])
        known = known_names(target, [*self.balances, *self.inputs, *self.outputs], "there are")
        raise BadModel(f"model {self.name!r}: {target!r} is no balance, input or output; {known}")

    def _fitting_site(self, target: str, effect: Effect) -> Site:
        """`site`, refused where the effect cannot stand there."""
        if not effect.is_tied(target) and tied_to(target):
            raise BadModel(
                f"effect {effect.id!r} at {target!r}: is tied to no signal; say where as"
                f" {place_of(target)!r}"
            )
        site = self.site(target, effect)
        if not effect.fits(site):
            raise BadModel(
                f"effect {effect.id!r} does not fit {site.kind} {target!r}: {_acts_on(effect)}"
            )
        return site

    def _tied_site(self, target: str, effect: Effect) -> Site:
        """The site of an effect at `balance(signal)` or `balance(other)`."""
        place = place_of(target)
        tied = tied_to(target)
        joins = effect.joins(target)
        if place not in self.balances or len(tied) != 1:
            form = "balance(other balance)" if joins else "balance(signal)"
            balances = ", ".join(self.balances)
            raise BadModel(
                f"effect {effect.id!r} at {target!r}: say where as {form}; the balances are"
                f" {balances}"
            )
        (name,) = tied
        known = self.balances if joins else {**self.inputs, **self.states, **self._defined()}
        if name not in known or name == place:
            raise BadModel(
                f"effect {effect.id!r} at {target!r}: cannot be tied to {name!r};"
                f" {known_names(name, known, 'there are')}"
            )
        balance = self.balances[place]
        units = self._roles(balance)
        if not joins:
            units[name] = self.unit_of(name)
        elif self.balances[name].kind != balance.kind:
            raise BadModel(
                f"effect {effect.id!r} at {target!r}: {place!r} and {name!r} are balances of"
                " different kinds"
            )
        return Site(balance.kind, target, balance.unit, units, tied)

    def _defined(self) -> dict[str, str]:
        return {
            name: balance.kind for balance in self.balances.values() if (name := balance.defines)
        }

    def records(self, key: Key) -> bool:
        """Whether the record says when this effect acts at its target."""
        effect = find_effect(key.effect)
        return effect.recorded(self.site(key.target, effect))

    def with_input(self, name: str, unit: str) -> PhysicalModel:
        """The model with one more recorded input, for an effect that is tied to it."""
        if name in self.inputs:
            return self
        if name in {*self.states, *self.parameters, *self._defined()}:
            raise BadModel(f"model {self.name!r}: {name!r} is no free name for an input")
        return replace(self, inputs=MappingProxyType({**self.inputs, name: Input(name, unit)}))

    def with_inputs_of(self, names: Iterable[str]) -> PhysicalModel:
        """The model with these of its inputs alone; the others must be in no term."""
        return replace(self, inputs=MappingProxyType({name: self.inputs[name] for name in names}))

    def supply_input(self, balance: Balance) -> str | None:
        """The first input that a term of the balance contains."""
        for term in balance.terms.values():
            for name, signal in self.inputs.items():
                if (
                    name in term.names
                    # An ambient temperature is a condition of the balance, and drives nothing.
                    and name not in balance.variables.values()
                    and not signal.is_clock
                ):
                    return name
        return None

    def unit_of(self, name: str) -> str:
        """Unit of a state, input or parameter, or of the variable that a balance without storage
        defines.
        """
        # A declared unit; a variable that a balance defines has the unit of its kind.
        for family in (self.states, self.inputs, self.parameters):
            if name in family:
                return str(family[name].unit)
        return {"voltage": "A", "heat": "K", "volume": "m", "torque": "rad/s", "force": "m/s"}.get(
            self._definer(name), ""
        )

    def with_effect(
        self,
        id: str,
        target: str,
        values: Mapping[str, float] | None = None,
        *,
        fixed: Iterable[str] = (),
        priors: Mapping[str, Prior | None] | None = None,
        provenance: Mapping[str, Any] | None = None,
    ) -> PhysicalModel:
        """The model with one more effect at `target`; `values` and `priors` by the effect's own
        parameter names.

        Raises
        ------
        BadModel
            Unknown effect or target, effect that does not fit there, unknown parameter name, value
            outside its bounds.
        """
        effect = find_effect(id)
        site = self._fitting_site(target, effect)
        declared = _declared(effect, site, dict(values or {}), tuple(fixed))
        for name, prior in (priors or {}).items():
            declared[name] = replace(declared[name], prior=prior)
        key = Key(id, target)
        instance = 1 + sum(use.key == key for use in self.effects)
        # an effect that a file defines is known in its own context alone: the model keeps it
        own = effect if EFFECTS.is_here(id) else None
        use = EffectUse(
            id, target, MappingProxyType(declared), instance, dict(provenance or {}), own
        )
        return replace(self, effects=(*self.effects, use))

    def without_effect(self, label: str) -> PhysicalModel:
        """The model without the effect of this label (`id@target`, or the id alone when it occurs
        once).
        """
        # The id alone is enough where it occurs once.
        uses = [use for use in self.effects if label in (use.label, use.id)]
        if len(uses) != 1:
            hint = known_names(label, [use.label for use in self.effects], "there are")
            raise BadModel(
                f"model {self.name!r}: effect {label!r} occurs {len(uses)} times; {hint}"
            )
        return replace(self, effects=tuple(use for use in self.effects if use is not uses[0]))

    def with_values(self, values: Mapping[str, float]) -> PhysicalModel:
        """The model with these parameter values, by full name (values are taken as they are, bounds
        are not checked).
        """
        if unknown := [name for name in values if name not in self.all_parameters]:
            raise BadModel(
                f"model {self.name!r}: no parameter {unknown[0]!r};"
                f" {known_names(unknown[0], self.all_parameters, 'there are')}"
            )
        own = {
            name: replace(p, value=float(values.get(name, p.value)))
            for name, p in self.parameters.items()
        }
        # Effects hold their parameters by short names, values come by full ones.
        effects = tuple(replace(use, parameters=_revalued(use, values)) for use in self.effects)
        return replace(self, parameters=own, effects=effects)

    def with_provenance(self, label: str, provenance: Mapping[str, Any]) -> PhysicalModel:
        """The model with a note on where the effect `label` came from."""
        effects = tuple(
            replace(u, provenance=dict(provenance)) if u.label == label else u for u in self.effects
        )
        return replace(self, effects=effects)

    def _roles(self, balance: Balance) -> dict[str, str]:
        roles = {role: self.unit_of(name) for role, name in balance.variables.items()}
        # Offered to effects on the supply: the input that drives the balance.
        if supply := self.supply_input(balance):
            roles["supply"] = self.inputs[supply].unit
        if balance.defines:
            roles["defined"] = self.unit_of(balance.defines)
        return roles | {name: self.inputs[name].unit for name in CHANNELS if name in self.inputs}

    def _definer(self, name: str) -> str:
        return next(
            (balance.kind for balance in self.balances.values() if balance.defines == name), ""
        )


def _declared(
    effect: Effect, site: Site, given: Mapping[str, float], fixed: tuple[str, ...]
) -> dict[str, Parameter]:
    """An effect's parameters at a site, with the values given and those held that are to be."""
    declared = {parameter.name: parameter for parameter in effect.parameters(site)}
    if unknown := [name for name in [*given, *fixed] if name not in declared]:
        raise BadModel(
            f"effect {effect.id!r}: no parameter {unknown[0]!r};"
            f" {known_names(unknown[0], declared, 'there are')}"
        )
    for name, value in given.items():
        declared[name] = replace(
            declared[name], value=checked_value(f"effect {effect.id!r}", declared[name], value)
        )
    # After all values are in: each may have moved one of the pair.
    for low in declared.values():
        if low.below and not low.value < declared[low.below].value:
            raise BadModel(
                f"effect {effect.id!r}: parameter {low.name!r} is {low.value:g} and {low.below!r}"
                f" is {declared[low.below].value:g}; {low.name!r} must be below {low.below!r}"
            )
    # What is held keeps the value that it was given.
    return declared | {name: replace(declared[name], fixed=True) for name in fixed}


def place_of(target: str) -> str:
    """The balance, input or output of a target that may name signals: `tank` of `tank(next)`."""
    return target.partition("(")[0]


def tied_to(target: str) -> tuple[str, ...]:
    """The names in a target's brackets.

    >>> tied_to("tank(next)"), tied_to("tank")
    (('next',), ())
    """
    inside = target.partition("(")[2].removesuffix(")")
    return tuple(name.strip() for name in inside.split(",") if name.strip())


def term_name(use: EffectUse) -> str:
    """Name of an effect's term among those of its balance."""
    # The balance is known where the term stands; what it is tied to, and which of several, is not.
    tied = use.target.removeprefix(use.place)
    return f"{use.id}{tied}" + (f"#{use.instance}" if use.instance > 1 else "")


def _acts_on(effect: Effect) -> str:
    needs = f" with {', '.join(effect.needs)}" if effect.needs else ""
    return f"it acts on {' or '.join(effect.acts_on)}{needs}"


def fitting(model: PhysicalModel, id: str) -> list[Key]:
    """The keys of one effect that fit the model; BadModel where it fits nowhere, or is in it
    already.
    """
    keys = candidates(model, [id])
    if not keys:
        raise BadModel(
            f"effect {id!r}: fits no balance, input or output of model {model.name!r}, or is in it"
            f" already: {_acts_on(find_effect(id))}"
        )
    return keys


def candidates(model: PhysicalModel, ids: Iterable[str] | None = None) -> list[Key]:
    """All keys of effects that fit the model and are not in it yet; `ids` restricts the effects.

    Targets are balances, outputs, and inputs that drive: without a default, and no condition of a
    balance (its surroundings). Couplings are proposed between balances that know nothing of each
    other, forgotten inputs where the model has an idle one.
    """
    chosen = [*EFFECTS, *STRUCTURAL] if ids is None else list(ids)
    effects = [find_effect(id) for id in chosen]
    keys = [*_on_single_targets(model, effects), *_on_tied_targets(model, effects)]
    present = {use.key for use in model.effects}
    return [key for key in keys if key not in present]


def _on_single_targets(model: PhysicalModel, effects: Iterable[Effect]) -> list[Key]:
    """Keys of the effects at a balance, input or output alone; none of those that must be tied."""
    targets = _targets(model)
    keys: list[Key] = []
    for effect in effects:
        keys += [
            Key(effect.id, target)
            for target in targets[effect.place]
            if not effect.is_tied(target) and effect.fits(model.site(target, effect))
        ]
    return keys


def _on_tied_targets(model: PhysicalModel, effects: Sequence[Effect]) -> list[Key]:
    """Keys of the effects between two balances, then of those tied to an idle input."""
    keys: list[Key] = []
    for effect in effects:
        if isinstance(effect, JoiningEffect):
            keys += [Key(effect.id, target) for target in _pairs_of_balances(model, effect)]
    idle = [f"{balance}({name})" for balance in model.balances for name in idle_inputs(model)]
    for effect in effects:
        if takes_columns(effect.id):
            keys += [Key(effect.id, target) for target in idle]
    return keys


def _targets(model: PhysicalModel) -> dict[str, list[str]]:
    """Where effects of each kind of place may be put: balances, inputs that drive, outputs."""
    # An input that is a condition of a balance (its surroundings) has no actuator.
    no_drive = {
        name for balance in model.balances.values() for name in balance.variables.values()
    } | set(idle_inputs(model))
    inputs = [
        name
        for name, signal in model.inputs.items()
        if signal.default is None and name not in no_drive
    ]
    return {"balance": list(model.balances), "input": inputs, "output": list(model.outputs)}


def idle_inputs(model: PhysicalModel) -> list[str]:
    """Inputs that no term, output, balance or effect of the model names."""
    used = {name for expression in model.expressions for name in expression.names}
    used |= {
        name for balance in model.balances.values() for name in balance.variables.values()
    } | set(CHANNELS)
    # An effect that is tied to a signal names it in its target.
    used |= {name for use in model.effects for name in (use.target, *tied_to(use.target))}
    return [name for name in model.inputs if name not in used]


def _pairs_of_balances(model: PhysicalModel, effect: JoiningEffect) -> list[str]:
    """Targets `first(second)` of balances of one kind: both ways where what one gives may run into
    the other, else those that know nothing of each other's variables.
    """
    storing = [balance for balance in model.balances.values() if balance.defines is None]
    pairs = permutations(storing, 2) if effect.reaches else combinations(storing, 2)
    targets = []
    for first, second in pairs:
        if first.kind != second.kind:
            continue
        # balances that share a state exchange something already: a coupling would not be told apart
        shared = _names_in(first) & _names_in(second) & model.states.keys()
        target = f"{first.name}({second.name})"
        if (effect.reaches or not shared) and effect.fits(model.site(target, effect)):
            targets.append(target)
    return targets


def _names_in(balance: Balance) -> set[str]:
    """Names in the terms of a balance, and of its variables."""
    in_terms = {name for term in balance.terms.values() for name in term.names}
    return in_terms | set(balance.variables.values())


def find_effect(id: str) -> Effect:
    """The effect of this id; BadModel names the nearest there are."""
    if id in STRUCTURAL:
        return STRUCTURAL[id]
    if id not in EFFECTS:
        # Structural effects are known by name, though no catalogue lists them.
        asked = did_you_mean(id, [*EFFECTS, *STRUCTURAL])
        raise BadModel(
            f"effect {id!r} is not in the catalogue; {asked}`residuum effects` lists all"
        )
    return EFFECTS[id]


def takes_columns(id: str) -> bool:
    """Whether the effect of this id is tried with columns that the model does not use."""
    effect = find_effect(id)
    return isinstance(effect, SignalEffect) and effect.takes_columns


def is_curve(id: str) -> bool:
    """Whether the effect of this id is a curve to be learned."""
    effect = find_effect(id)
    return isinstance(effect, SignalEffect) and effect.curve


def checked_value(where: str, parameter: Parameter, value: float) -> float:
    """`value` as a float inside the parameter's bounds; BadModel otherwise."""
    number = float(value)
    # An infinite value lies within infinite bounds: refused by itself.
    if not math.isfinite(number) or not parameter.lower <= number <= parameter.upper:
        bounds = f"{parameter.lower:g} to {parameter.upper:g} {parameter.unit}"
        raise BadModel(
            f"{where}: parameter {parameter.name!r} is {value:g}; it must be within {bounds}"
        )
    return number


def _revalued(use: EffectUse, values: Mapping[str, float]) -> Mapping[str, Parameter]:
    return MappingProxyType(
        {
            name: replace(p, value=float(values.get(f"{use.label}.{name}", p.value)))
            for name, p in use.parameters.items()
        }
    )
