"""A model as dx/dt = f(t, x, u, p), y = h(t, x, u, p) with names that every language takes."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from residuum.identification.errors import BadModel
from residuum.identification.physics.compile import symbolic as sp
from residuum.identification.physics.compile.composition import TIME, Equations, compose
from residuum.identification.physics.compile.equation_functions import SteppedRound
from residuum.identification.physics.compile.implicit import Root
from residuum.identification.physics.files.consistency import owners_of
from residuum.identification.physics.model import PhysicalModel, term_name

AT_REST = (
    (
        "Standstill is exact: at zero velocity the machine rests until what drives it exceeds the"
        " friction (Filippov's condition)."
    ),
)
LIMITS = (
    "Standstill: where the model has dry friction, sign(v) of an exactly zero velocity is 0 here.",
    (
        "The original holds a machine at rest until the forces exceed the friction; here it may"
        " creep by a step's length."
    ),
)
"""What the text cannot do as the original does; stands in its head."""


@dataclass(frozen=True)
class Component:
    """The term that an effect adds to a balance: `expression` [`unit`]; `title` is `effect in
    balance`.

    `effect` is the effect's label, by which its parameters are named.
    """

    title: str
    effect: str
    expression: Any
    unit: str


@dataclass(frozen=True, eq=False)
class ExplicitModel:
    """Names, units and expressions of one model.

    `states`, `inputs`, `parameters` are identifiers in order; `symbols` has the symbol of each, of
    each component and of `time`; `rates` and `initial` are by state, `outputs` by identifier;
    `units` and `meanings` by identifier; `values` by parameter. `components` are the terms of
    effects by identifier; rates name them. `directions` has the symbol, in rates and components, of
    the direction of each velocity that can stand still; `with_signs` puts the sign of the velocity
    there. `defined` are the large expressions that stand in several places, by identifier, each
    after those it names: a text computes them once.
    """

    name: str
    title: str
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    parameters: tuple[str, ...]
    symbols: Mapping[str, Any]
    rates: Mapping[str, Any]
    initial: Mapping[str, Any]
    outputs: Mapping[str, Any]
    units: Mapping[str, str]
    meanings: Mapping[str, str]
    values: Mapping[str, float]
    components: Mapping[str, Component]
    directions: Mapping[str, Any]
    defined: Mapping[str, Any]

    def head(self, comment: str, *, at_rest: bool = False) -> list[str]:
        """The first lines of any text: what it is, and what it does at standstill: `at_rest`, as
        the original does.
        """
        lines = [
            f"Model {self.title!r}, written by Residuum. Inputs, states, outputs and parameters in"
            " the units named beside them."
        ]
        return [
            f"{comment} {line}"
            for line in [*lines, *((AT_REST if at_rest else LIMITS) if self.directions else ())]
        ]

    def symbols_in(self, expressions: Mapping[str, Any]) -> set[Any]:
        """The symbols that any of the expressions names, itself or by what is defined."""
        used = set().union(*(sp.sympify(e).free_symbols for e in expressions.values()))
        # Backwards: a definition names only those before it.
        for name, expression in reversed(list(self.defined.items())):
            if self.symbols[name] in used:
                used |= expression.free_symbols
        return used

    def defined_in(self, used: set[Any]) -> dict[str, Any]:
        """What is defined of the symbols that `symbols_in` found, in order."""
        return {name: e for name, e in self.defined.items() if self.symbols[name] in used}

    def with_signs(self, expression: Any) -> Any:
        """An expression with each direction as the sign of its velocity."""
        return sp.sympify(expression).subs(
            {d: sp.sign(self.symbols[v]) for v, d in self.directions.items()}
        )

    def described(self, name: str) -> str:
        """`full name [unit]`."""
        unit = self.units.get(name, "")
        return f"{self.meanings[name]} [{unit}]" if unit else self.meanings[name]


@dataclass(frozen=True)
class _Identifiers:
    """What the names of each family are called in the text; no two are alike."""

    states: Mapping[str, str]
    inputs: Mapping[str, str]
    parameters: Mapping[str, str]
    outputs: Mapping[str, str]
    terms: Mapping[str, str]
    defined: Mapping[str, str]

    def symbols(self) -> dict[str, Any]:
        """The symbol of each identifier that equations name, and of the time."""
        families = (self.states, self.inputs, self.parameters, self.terms, self.defined)
        identifiers = [new for family in families for new in family.values()]
        return {new: sp.Symbol(new, real=True) for new in (*identifiers, "time")}

    def meanings(self) -> dict[str, str]:
        """The full name that each identifier stands for."""
        families = (self.states, self.inputs, self.parameters, self.outputs)
        return {new: old for family in families for old, new in family.items()}


@dataclass(frozen=True)
class _Rewriting:
    """Equations in the symbols of the text."""

    swap: Mapping[Any, Any]
    signs: Mapping[Any, Any]

    def put(self, expression: Any) -> Any:
        """An expression with every symbol replaced, and stairs by what any language has."""
        # all at once: a model may call its own states x_1, x_2
        renamed = sp.sympify(expression).xreplace(self.swap)
        return renamed.replace(SteppedRound, lambda a: sp.floor(a + sp.Rational(1, 2)))

    def turned(self, expression: Any) -> Any:
        """The same with the direction of each velocity that can stand still in place of its sign."""
        return self.put(expression).subs(self.signs)


def explicit(model: PhysicalModel) -> ExplicitModel:
    """The model's equations with its effects, unknown terms left out.

    Raises
    ------
    BadModel
        An input that is delayed: no text here has a memory of its inputs. A parameter with a value
        for each record, of which none is that of the model.
    """
    of_records = [name for name, state in model.states.items() if state.of_record]
    if of_records:
        raise BadModel(
            f"model {model.name!r}: {of_records[0]!r} has a value for each record, which no export"
            " holds; write the one to export as its 'value' and leave out 'per'"
        )
    equations = compose(model)
    _refuse_unwritable(model, equations)
    places = _effect_terms(model, equations)
    # names that the texts themselves use
    taken: set[str] = {"time", "t", "x", "u", "p", "y", "s", "dx"}
    names = _named(model, equations, places, taken)
    symbols = names.symbols()
    directions = _directions(equations, names.states, taken)
    rewriting = _Rewriting(
        _swapped(model, equations, names, symbols, directions),
        {sp.sign(symbols[velocity]): d for velocity, d in directions.items()},
    )
    components = {
        names.terms[title]: Component(
            title, effect, rewriting.turned(equations.signals[signal]), model.balances[balance].unit
        )
        for signal, (title, effect, balance) in places.items()
    }
    return ExplicitModel(
        name=_identifier(model.name),
        title=model.name,
        states=tuple(names.states.values()),
        inputs=tuple(names.inputs.values()),
        parameters=tuple(names.parameters.values()),
        symbols=symbols,
        rates=_rates(model, equations, places, names, rewriting, symbols),
        initial=_first_states(model, equations, names, rewriting, symbols),
        outputs={new: rewriting.put(equations.outputs[old]) for old, new in names.outputs.items()},
        units=_units(model, names.states, names.inputs, names.parameters, names.outputs),
        meanings=names.meanings(),
        values={new: model.values[old] for old, new in names.parameters.items()},
        components=components,
        directions=directions,
        defined={
            names.defined[str(symbol)]: rewriting.put(e) for symbol, e in equations.defined.items()
        },
    )


_Places = Mapping[str, tuple[str, str, str]]
"""Signal `balance.term` → (title, effect's label, balance)."""


def _named(
    model: PhysicalModel, equations: Equations, places: _Places, taken: set[str]
) -> _Identifiers:
    unknown = {balance.missing for balance in model.balances.values()}
    driving = [name for name, signal in model.inputs.items() if not signal.is_clock]
    # the first of two alike keeps its plain name: states come first
    return _Identifiers(
        states=_identifiers(equations.x, taken),
        inputs=_identifiers(driving, taken),
        parameters=_identifiers([name for name in equations.p if name not in unknown], taken),
        outputs=_identifiers(equations.outputs, taken),
        terms=_identifiers([title for title, _, _ in places.values()], taken),
        defined=_identifiers(map(str, equations.defined), taken),
    )


def _swapped(
    model: PhysicalModel,
    equations: Equations,
    names: _Identifiers,
    symbols: Mapping[str, Any],
    directions: Mapping[str, Any],
) -> dict[Any, Any]:
    """Every symbol of the equations → what stands for it in the text; unknown terms are zero."""
    swap = {equations.p[b.missing]: sp.S.Zero for b in model.balances.values()}
    swap |= _renamed(equations, symbols, names.states, names.inputs, names.parameters)
    swap |= {symbol: symbols[names.defined[str(symbol)]] for symbol in equations.defined}
    states = list(equations.x)
    for k, symbol in equations.surfaces.items():
        swap[symbol] = directions[names.states[states[k]]]
    for name, signal in model.inputs.items():
        if signal.is_clock:
            swap[equations.u[name]] = symbols["time"]
    return swap


def _rates(
    model: PhysicalModel,
    equations: Equations,
    places: _Places,
    names: _Identifiers,
    rewriting: _Rewriting,
    symbols: Mapping[str, Any],
) -> dict[str, Any]:
    """dx/dt by state. Where effects act in a balance its rate is written as a sum over its storage,
    so that each effect's term is computed in one place and can be looked at.
    """
    by_name = {signal: symbols[names.terms[title]] for signal, (title, _, _) in places.items()}
    rates = {
        new: rewriting.put(rate)
        for new, rate in zip(names.states.values(), equations.rates, strict=True)
    }
    for balance, state in _owners(model, equations).items():
        own = [signal for signal in equations.signals if signal.startswith(f"{balance}.")]
        if by_name.keys().isdisjoint(own):
            continue
        total = sum(
            by_name[signal] if signal in by_name else rewriting.turned(equations.signals[signal])
            for signal in own
        )
        rates[names.states[state]] = total / rewriting.put(equations.signals[f"storage:{balance}"])
    return rates


def _first_states(
    model: PhysicalModel,
    equations: Equations,
    names: _Identifiers,
    rewriting: _Rewriting,
    symbols: Mapping[str, Any],
) -> dict[str, Any]:
    """First values by state, none of them in terms of another state's."""
    own_first = {
        name: rewriting.put(
            # Written out: first values stand in it for states, wherever these are named.
            _without(
                equations.defined, equations.initial.get(old, model.first_values.get(old, 0.0))
            )
        )
        for old, name in names.states.items()
    }
    first = {symbols[name]: value for name, value in own_first.items()}
    # twice: an effect's state may begin at that of another effect, which begins at the model's
    return {name: value.subs(first).subs(first) for name, value in own_first.items()}


def _without(defined: Mapping[Any, Any], expression: Any) -> Any:
    """An expression with what its symbols stand for written out."""
    e = sp.sympify(expression)
    while named := {symbol: defined[symbol] for symbol in e.free_symbols if symbol in defined}:
        e = e.xreplace(named)
    return e


def _owners(model: PhysicalModel, equations: Equations) -> dict[str, str]:
    """The state whose derivative each balance gives."""
    owners = {b.name: next(iter(owners_of(b)), b.defines) for b in model.balances.values()}
    return {
        balance: state
        for balance, state in owners.items()
        if state is not None and state in equations.x
    }


def _effect_terms(model: PhysicalModel, equations: Equations) -> dict[str, tuple[str, str, str]]:
    """Signal `balance.term` → (title, effect's label, balance) of the terms of effects in balances
    that have a state.
    """
    terms = {term_name(use): use for use in model.effects if use.effect.place == "balance"}
    by_signal = {}
    for balance in _owners(model, equations):
        for term, use in terms.items():
            signal = f"{balance}.{term}"
            if signal in equations.signals:
                title = use.label if balance == use.place else f"{use.label} in {balance}"
                by_signal[signal] = (title, use.label, balance)
    return by_signal


def _directions(equations: Equations, states: Mapping[str, str], taken: set[str]) -> dict[str, Any]:
    velocities = [states[list(equations.x)[k]] for k in equations.surfaces]
    # Last: names of quantities come before those that only the text needs.
    names = _identifiers([f"direction of {velocity}" for velocity in velocities], taken)
    return {v: sp.Symbol(new, real=True) for v, new in zip(velocities, names.values(), strict=True)}


def _refuse_unwritable(model: PhysicalModel, equations: Equations) -> None:
    values = (*equations.rates, *equations.outputs.values(), *equations.defined.values())
    if any(sp.sympify(e).has(Root) for e in values):
        solved = [balance.name for balance in model.balances.values() if balance.start is not None]
        raise BadModel(
            f"export: model {model.name!r} solves {', '.join(solved)} by Newton's method (start:),"
            " which no exported text can hold; solve them for their variables by hand"
        )
    for delayed in equations.delays:
        raise BadModel(
            f"export: input {delayed!r} is delayed, which no exported text can hold; take the delay"
            " out, and delay what drives it"
        )


def _renamed(
    equations: Equations, symbols: Mapping[str, Any], *families: Mapping[str, str]
) -> dict[Any, Any]:
    """Every symbol of the equations by what stands for it in the text."""
    states, inputs, parameters = families
    swap = {TIME: symbols["time"]}
    for family, known in ((equations.x, states), (equations.u, inputs), (equations.p, parameters)):
        swap |= {symbol: symbols[known[name]] for name, symbol in family.items() if name in known}
    return swap


def _units(model: PhysicalModel, *families: Mapping[str, str]) -> dict[str, str]:
    states, inputs, parameters, outputs = families
    known = {new: model.states[old].unit for old, new in states.items() if old in model.states}
    known |= {new: model.inputs[old].unit for old, new in inputs.items()}
    known |= {new: model.all_parameters[old].unit for old, new in parameters.items()}
    return known | {new: model.outputs[old].unit for old, new in outputs.items()}


def _identifiers(names: Iterable[str], taken: set[str]) -> dict[str, str]:
    """Name → an identifier that no other name has."""
    identifiers = {}
    for name in names:
        # With numbers from 2 on, as effects of one kind have.
        plain = new = _identifier(name)
        count = 2
        while new in taken:
            new = f"{plain}_{count}"
            count = count + 1
        taken.add(new)
        identifiers[name] = new
    return identifiers


def _identifier(name: str) -> str:
    plain = re.sub(r"[^A-Za-z0-9]+", "_", name).strip("_")
    # No language takes a name that begins with a digit.
    return plain if plain and plain[0].isalpha() else f"m_{plain}"
