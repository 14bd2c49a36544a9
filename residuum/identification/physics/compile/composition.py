"""Composition: a PhysicalModel becomes explicit equations, symbolically.

Each balance `storage · dx/dt = Σ terms` is solved for its derivative; a balance without storage is
solved for the variable it defines. The result is

    dx/dt = f(x, u, p, s),   y = h(x, u, p)

with states x (the model's, then those of effects), inputs u, parameters p (the model's, those of
effects, and one additive *missing term* a balance, zero unless a smoother estimates it) and
directions s.

**Standstill is exact.** `sign(v)` of a state v in the balance that gives dv/dt is not evaluated but
becomes a direction s ∈ {−1, 0, 1} that the integrator switches: with f⁺ and f⁻ the right-hand sides
at v = 0 for s = ±1, the machine sticks while f⁺ ≤ 0 ≤ f⁻ (Filippov's sliding condition, which is
Coulomb's law), so no smoothing width is chosen.

**A balance without storage** may contain its variable linearly, and in `sign()` and `abs()`: with
residual r + a·i + b·sign(i) + c·|i| it is solved piecewise. Of balances that name a start value the
variables are a root (`implicit`), each one's or those that define each other together; anything
else is refused as an algebraic loop.

Reference: A. F. Filippov, *Differential Equations with Discontinuous Righthand Sides*, 1988.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field

import sympy as sp

from residuum.identification.errors import BadModel, NoExplicitEquations
from residuum.identification.physics.compile import implicit
from residuum.identification.physics.compile.expression_meaning import meaning, number
from residuum.identification.physics.effects.base import Contribution, Scene
from residuum.identification.physics.files.consistency import (
    owners_of,
)
from residuum.identification.physics.files.expression import (
    Call,
    Name,
    Node,
    Number,
    Operation,
    folded,
    walk,
)
from residuum.identification.physics.model import (
    CHANNELS,
    Balance,
    EffectUse,
    PhysicalModel,
    term_name,
    tied_to,
)

TIME = sp.Symbol("t", real=True)
LARGE = 60
"""Numbers, names and operations from which on what stands in several places is kept apart."""
_ARITHMETIC = ("+", "-", "*", "/", "**", "neg")


@dataclass(frozen=True)
class Equations:
    """Explicit equations of a model, as SymPy expressions.

    Attributes
    ----------
    x, u, p : mapping of name to symbol
        States, inputs, parameters (`missing@balance` last) in kernel order.
    rates : tuple of expression
        dx/dt, one a state.
    outputs : mapping of name to expression
    signals : mapping of name to expression
        What else can be looked at: variables that balances define, `balance.term` of every term,
        `storage:balance` and `drive:balance` (the sum of its terms that contain an input or a
        current).
    initial : mapping of state to expression
        Initial values of the effects' own states.
    deviating : tuple of str
        Those of them that may begin away from it; a first value is then the deviation.
    surfaces : mapping of state index to direction symbol
        Velocities (or currents) that can stand still.
    delays : mapping of input to symbol
        Parameter by which an input is delayed [s].
    defined : mapping of symbol to expression
        What symbols of large models stand for that are none of these, each after those it names.
    """

    x: Mapping[str, sp.Symbol]
    u: Mapping[str, sp.Symbol]
    p: Mapping[str, sp.Symbol]
    rates: tuple[sp.Expr, ...]
    outputs: Mapping[str, sp.Expr]
    signals: Mapping[str, sp.Expr]
    initial: Mapping[str, sp.Expr]
    deviating: tuple[str, ...]
    surfaces: Mapping[int, sp.Symbol]
    delays: Mapping[str, sp.Symbol]
    defined: Mapping[sp.Symbol, sp.Expr]


def compose(model: PhysicalModel) -> Equations:
    """Explicit equations of the model with its effects.

    Raises
    ------
    NoExplicitEquations
        A balance without storage that cannot be solved for its variable (algebraic loop), a storage
        that is zero or given twice.
    """
    return _Composer(model).equations()


@dataclass
class _Sides:
    """The two sides of one balance while effects are added."""

    balance: Balance
    terms: dict[str, sp.Expr]
    state: str | None
    coefficient: sp.Expr
    defines: sp.Symbol | None
    direction: sp.Expr = sp.S.Zero
    roles: dict[str, sp.Expr] = field(default_factory=dict)

    @property
    def storage(self) -> sp.Expr:
        """What multiplies the derivative, or for a balance without storage the slope of its terms
        by the variable it defines.
        """
        if self.state is not None or self.defines is None:
            return self.coefficient
        return -sp.diff(sum(self.terms.values()), self.defines)


class _Composer:
    """Holds the symbols of one model while its equations are put together."""

    def __init__(self, model: PhysicalModel) -> None:
        self.model = model
        # Symbols are numbered, not named: structures that differ in names alone share their code.
        self.x = {name: sp.Symbol(f"x_{k}", real=True) for k, name in enumerate(model.states)}
        self.u = {name: sp.Symbol(f"u_{k}", real=True) for k, name in enumerate(model.inputs)}
        names = [*model.all_parameters, *(b.missing for b in model.balances.values())]
        self.p = {name: sp.Symbol(f"p_{k}", real=True) for k, name in enumerate(names)}
        self.variables = {
            v: sp.Symbol(f"i_{b.name}", real=True)
            for b in model.balances.values()
            if (v := b.defines)
        }
        self.paths: dict[str, sp.Expr] = {
            name: self._recorded_or_default(name) for name in model.inputs
        }
        # A state with a `rate` has that state as its derivative; a value for each record stands
        # still. All other rates come from balances and effects.
        self.rates: dict[str, sp.Expr] = {
            s.name: self.x[s.rate] if s.rate else sp.S.Zero
            for s in model.states.values()
            if s.rate or s.of_record
        }
        self.initial: dict[str, sp.Expr] = {}
        self.deviating: list[str] = []
        self.delays: dict[str, sp.Symbol] = {}
        self.directions: dict[str, sp.Symbol] = {}
        self.became_state: dict[sp.Symbol, sp.Expr] = {}
        self.meanings: dict[tuple[int, str | None, sp.Symbol | None], sp.Expr] = {}
        self.apart = _standing_apart(model)
        self.defined: dict[sp.Symbol, sp.Expr] = {}

    def equations(self) -> Equations:
        # inputs first: the balances' terms are made of what actuators make of them
        self._add_to_paths("input", self.paths)
        sides = {name: self._sides(balance) for name, balance in self.model.balances.items()}
        for use in self.model.effects:
            if use.effect.place == "balance":
                self._add_to_balance(use, sides)
        # After all effects: they may add terms with the variable that a balance defines.
        defined = self._solve_defined(sides)
        for side in sides.values():
            if side.state is not None:
                # The balance solved for its derivative.
                self.rates[side.state] = sum(side.terms.values()) / side.coefficient
        outputs = {
            name: self._symbolic(output.value.tree, None)
            for name, output in self.model.outputs.items()
        }
        self._add_to_paths("output", outputs)
        return self._explicit(sides, outputs, defined)

    def _explicit(
        self,
        sides: dict[str, _Sides],
        outputs: dict[str, sp.Expr],
        defined: dict[sp.Symbol, sp.Expr],
    ) -> Equations:
        def put(expression: sp.Expr) -> sp.Expr:
            return sp.sympify(expression).subs(defined)

        # Signals are looked at, not integrated: there a direction is the plain sign.
        moving = {s: sp.sign(self.x[name]) for name, s in self.directions.items()}
        terms = {
            f"{n}.{term}": put(e).subs(moving)
            for n, side in sides.items()
            for term, e in side.terms.items()
        }
        variables = {
            name: defined[symbol] for name, symbol in self.variables.items() if symbol in defined
        }
        for name, side in sides.items():
            variables[f"storage:{name}"] = put(side.storage).subs(moving)
            variables[f"drive:{name}"] = put(side.roles["drive"]).subs(moving)
        rates = tuple(put(self.rates[name]) for name in self.x)
        initial = {name: put(e) for name, e in self.initial.items()}
        y = {name: put(e) for name, e in outputs.items()}
        deviating = tuple(self.deviating)
        return Equations(
            self.x,
            self.u,
            self.p,
            rates,
            y,
            variables | terms,
            initial,
            deviating,
            self._surfaces(rates),
            self.delays,
            self.defined,
        )

    def _surfaces(self, rates: Sequence[sp.Expr]) -> dict[int, sp.Symbol]:
        """The directions that rates name, by the number of their state."""
        order = list(self.x)
        return {
            order.index(name): direction
            for name, direction in self.directions.items()
            if any(rate.has(direction) for rate in rates)
        }

    def _recorded_or_default(self, name: str) -> sp.Expr:
        signal = self.model.inputs[name]
        if not signal.absent or signal.default is None:
            return self.u[name]
        return (
            self.p[signal.default]
            if signal.default in self.p
            else sp.Float(float(signal.default), 17)
        )

    def _sides(self, balance: Balance) -> _Sides:
        owner = next(iter(owners_of(balance)), None)
        state = owner
        defines = self.variables[balance.defines] if balance.defines else None
        coefficient = sp.S.Zero
        direction: sp.Expr = sp.sign(defines) if defines is not None else sp.S.Zero
        if state is not None:
            direction = self.directions.setdefault(
                state, sp.Symbol(f"s_{len(self.directions)}", real=True)
            )
            # A placeholder for der(state), whose coefficient is what the derivative is multiplied
            # by.
            derivative = sp.Symbol("derivative", real=True)
            storage = sp.expand(self._symbolic(balance.storage.tree, None, derivative))
            coefficient = storage.coeff(derivative, 1)
            if sp.expand(storage - coefficient * derivative) != 0 or coefficient.has(derivative):
                raise balance.storage.place.refuse(
                    f"storage {balance.storage.text!r} must be linear in der({state})"
                )
        terms = {name: self._symbolic(term.tree, state) for name, term in balance.terms.items()}
        # The unknown term that a smoother estimates; zero otherwise.
        terms["missing"] = self.p[balance.missing]
        side = _Sides(balance, terms, state, coefficient, defines, direction)
        side.roles = self._roles(side)
        return side

    def _roles(self, side: _Sides) -> dict[str, sp.Expr]:
        balance = side.balance
        roles = {role: self._name(name) for role, name in balance.variables.items()}
        own = side.state if side.state is not None else balance.defines
        # The input that drives the balance, as effects on the supply see it: after what actuators
        # make of it.
        supply = self.model.supply_input(balance)
        if supply is not None:
            roles["supply"] = self.paths[supply]
        roles |= {name: self.paths[name] for name in CHANNELS if name in self.paths}
        roles["supply_terms"] = _sum_with(side, {supply} if supply is not None else set())
        roles["drive"] = _sum_with(side, self._driving() - {own})
        roles["storage"] = side.coefficient
        return roles

    def _driving(self) -> set[str]:
        """Inputs, and currents: a motor's current drives its shaft as an input does."""
        inputs = {name for name, signal in self.model.inputs.items() if not signal.is_clock}
        balances = self.model.balances.values()
        return inputs | {b.variables["current"] for b in balances if "current" in b.variables}

    def _add_to_balance(self, use: EffectUse, sides: Mapping[str, _Sides]) -> None:
        side = sides[use.place]
        name = term_name(use)
        added = self._contribution(
            use, side.roles | self._tied(use, sides), side.direction, sp.S.Zero
        )
        side.terms[name] = sp.sympify(added.term)
        for balance, term in added.elsewhere.items():
            sides[balance].terms[name] = sp.sympify(term)
        # Effects that take a share of the inertia away follow each other: shares multiply.
        side.coefficient = side.coefficient * added.storage_factor
        if added.inductance is not None:
            self._give_storage(side, added.inductance, use)

    def _tied(self, use: EffectUse, sides: Mapping[str, _Sides]) -> dict[str, sp.Expr]:
        """What an effect is tied to: signals by name, the other balance's variables as
        `other:role`.
        """
        if use.effect.joins(use.target):
            return {
                f"other:{role}": value
                for role, value in sides[tied_to(use.target)[0]].roles.items()
            }
        return {name: self._name(name) for name in tied_to(use.target)}

    def _give_storage(self, side: _Sides, inductance: sp.Expr, use: EffectUse) -> None:
        name = side.balance.defines
        if side.state is not None or name is None or side.defines is None:
            raise NoExplicitEquations(
                f"effect {use.label!r}: balance {side.balance.name!r} has a storage already"
            )
        state = sp.Symbol(f"x_{len(self.x)}", real=True)
        # Where the variable stands when nothing changes: it begins there.
        resting = self._solve(side.defines, sum(side.terms.values()), side.balance)
        direction = self.directions.setdefault(
            name, sp.Symbol(f"s_{len(self.directions)}", real=True)
        )
        self.initial[name] = resting
        self.deviating.append(name)
        self.x[name] = state
        # The variable is a state from here on, in every term: its sign can stand still now.
        swap = {sp.sign(side.defines): direction, side.defines: state}
        side.terms = {term: e.subs(swap) for term, e in side.terms.items()}
        self.became_state[side.defines] = state
        side.state = name
        side.coefficient = inductance

    def _add_to_paths(self, place: str, paths: dict[str, sp.Expr]) -> None:
        """Add the effects on inputs, or those on outputs, in their order: each takes the signal as
        the one before left it.
        """
        for use in self.model.effects:
            if use.effect.place != place:
                continue
            added = self._contribution(use, {}, sp.S.Zero, paths[use.target])
            if added.signal is not None:
                paths[use.target] = added.signal
            if added.delay is not None:
                self.delays[use.target] = added.delay

    def _contribution(
        self, use: EffectUse, roles: Mapping[str, sp.Expr], direction: sp.Expr, signal: sp.Expr
    ) -> Contribution:
        site = self.model.site(use.target, use.effect)
        p = {name: self.p[f"{use.label}.{name}"] for name in use.parameters}
        own = {}
        for name in use.effect.states(site):
            full = f"{use.label}.{name}"
            # States of effects stand behind the model's own, in the order of the effects.
            own[name] = self.x[full] = sp.Symbol(f"x_{len(self.x)}", real=True)
        added = use.effect.contribution(Scene(site, p, own, roles, direction, signal, TIME))
        self.rates.update({f"{use.label}.{name}": rate for name, rate in added.rates.items()})
        self.initial.update(
            {f"{use.label}.{name}": sp.sympify(value) for name, value in added.initial.items()}
        )
        self.deviating += [f"{use.label}.{name}" for name in added.deviating]
        return added

    def _solve_defined(self, sides: Mapping[str, _Sides]) -> dict[sp.Symbol, sp.Expr]:
        solved: dict[sp.Symbol, sp.Expr] = dict(self.became_state)
        open_sides = [
            side for side in sides.values() if side.state is None and side.defines is not None
        ]
        while open_sides:
            # The smallest system that can be solved by itself comes first: the others may need its
            # variables.
            together = min((_needed(side, open_sides) for side in open_sides), key=len)
            total = [sum(side.terms.values()) for side in together]
            if len(together) == 1 and together[0].balance.start is None:
                side = together[0]
                solved[side.defines] = self._solve(
                    side.defines, total[0].subs(solved), side.balance
                )
            else:
                solved |= self._roots(together, total, solved)
            open_sides = [side for side in open_sides if side not in together]
        return self._substituted(solved)

    def _roots(
        self, sides: list[_Sides], total: list[sp.Expr], solved: dict[sp.Symbol, sp.Expr]
    ) -> dict[sp.Symbol, sp.Expr]:
        names = ", ".join(side.balance.name for side in sides)
        place = sides[0].balance.storage.place
        start = [side.balance.start for side in sides if side.balance.start is not None]
        # J is inverted by its adjugate, which grows fast.
        if len(start) < len(sides) or len(sides) > implicit.MOST_VARIABLES:
            raise place.refuse(
                f"algebraic loop: balances {names} define each other's variables; each needs a"
                f" start value (start: 1.0), and at most {implicit.MOST_VARIABLES} are solved"
                " together",
                NoExplicitEquations,
            )
        unknown = [side.defines for side in sides]
        # A Jacobian that is zero whatever the values: no step of Newton's method leads anywhere.
        if sp.expand(implicit.jacobian(unknown, total).det(method="berkowitz")) == 0:
            raise place.refuse(
                f"algebraic loop of index 2: balances {names} do not determine the variables that"
                " they define; differentiate one by hand, or give one a storage",
                NoExplicitEquations,
            )
        return dict(zip(unknown, implicit.roots(unknown, total, start, solved), strict=True))

    def _substituted(self, solved: dict[sp.Symbol, sp.Expr]) -> dict[sp.Symbol, sp.Expr]:
        # As often as there are variables: each may name another one, in a chain of at most that
        # length.
        for _ in solved:
            replaced = {}
            for symbol, e in solved.items():
                known = {k: v for k, v in solved.items() if k != symbol}
                replaced[symbol] = sp.sympify(e).subs(known)
            solved = replaced
        return solved

    def _solve(self, i: sp.Symbol, total: sp.Expr, balance: Balance) -> sp.Expr:
        """The root i of r + a·i + b·sign(i) + c·|i| = 0."""
        # Both are taken for variables of their own, so that the equation is linear in all three.
        sign = sp.Symbol("sign_of_variable")
        size = sp.Symbol("size_of_variable")
        flat = sp.expand(sp.expand(total).subs({sp.sign(i): sign, sp.Abs(i): size}))
        a, b, c = (flat.coeff(symbol, 1) for symbol in (i, sign, size))
        r = flat.subs({i: 0, sign: 0, size: 0})
        # A coefficient that contains the variable: not linear.
        if a == 0 or {i, sign, size} & (a.free_symbols | b.free_symbols | c.free_symbols):
            raise self._loop(balance)
        # Something is left over: a power, a function of the variable.
        if flat.has(i) and sp.expand(flat - r - a * i - b * sign - c * size) != 0:
            raise self._loop(balance)
        if b == 0 and c == 0:
            return -r / a
        # Between −gap and gap neither sign solves the equation: the variable rests at zero (a
        # brush's drop).
        free = -r / a
        gap = b / a
        return sp.Piecewise(
            (-(r + b) / (a + c), free > gap), (-(r - b) / (a - c), free < -gap), (0, True)
        )

    def _loop(self, balance: Balance) -> BadModel:
        return balance.storage.place.refuse(
            f"algebraic loop: balance {balance.name!r} has no storage and is not linear in"
            f" {balance.defines!r}, which it defines",
            NoExplicitEquations,
        )

    def _symbolic(
        self, tree: Node, surface: str | None, derivative: sp.Symbol | None = None
    ) -> sp.Expr:
        """What a tree means; asked once of what stands in several places."""
        apart = id(tree) in self.apart
        # What is put into a tree later depends on where it stands; a tree that stands apart holds
        # none of that.
        key = (id(tree), None, None) if apart else (id(tree), surface, derivative)
        if key not in self.meanings:
            means = self._meaning(tree, surface, derivative)
            if apart:
                symbol = sp.Symbol(f"d_{len(self.defined)}", real=True)
                # Defined once, named everywhere: SymPy does not look into a symbol.
                self.defined[symbol] = sp.sympify(means)
                means = symbol
            self.meanings[key] = means
        return self.meanings[key]

    def _meaning(self, tree: Node, surface: str | None, derivative: sp.Symbol | None) -> sp.Expr:
        if isinstance(tree, Number):
            return number(tree)
        if isinstance(tree, Name):
            return self._name(tree.name)
        if isinstance(tree, Call):
            if tree.function == "der":
                return derivative
            if tree.function == "delay":
                return self._delayed(tree)
            if (
                surface is not None
                and tree.function == "sign"
                and _is_name(tree.operands[0], surface)
            ):
                # the direction that the integrator switches: an exact standstill has no sign
                return self.directions[surface]
        operands = [self._symbolic(operand, surface, derivative) for operand in tree.operands]
        return meaning(tree)(*operands)

    def _delayed(self, call: Call) -> sp.Expr:
        """What is made of inputs, each of them read so much earlier."""
        signal, by = call.operands
        delay = self._symbolic(by, None)
        for node in walk(signal):
            if (
                isinstance(node, Name)
                and node.name in self.u
                and self.delays.setdefault(node.name, delay) != delay
            ):
                raise NoExplicitEquations(
                    f"input {node.name!r}: the model delays it itself; one delay is all that it can"
                    " have"
                )
        return self._symbolic(signal, None)

    def _name(self, name: str) -> sp.Expr:
        for family in (self.x, self.paths, self.p, self.variables):
            if name in family:
                return family[name]
        raise BadModel(f"model {self.model.name!r}: name {name!r} is not declared")


def _standing_apart(model: PhysicalModel) -> set[int]:
    """Which nodes of the model's trees have a symbol of their own: large ones that stand in several
    places, but for what a direction or the variable of a balance without storage is put into.

    SymPy asks of whatever it is given whether it is real, positive or zero, all the way down: a
    model of a hundred equations that name each other would take it hours.
    """
    put_into = {b.defines for b in model.balances.values()}
    trees = [expression.tree for expression in model.expressions]
    places = _places(trees)
    apart = set[int]()

    def size(node: Node, inner: list[float]) -> float:
        """Infinite of what holds something that is put into it."""
        if _is_put_into(node, put_into):
            return math.inf
        # Numbers, names and operations below this node, itself included.
        total = 1 + sum(inner)
        is_value = not isinstance(node, Operation) or node.operator in _ARITHMETIC
        if LARGE <= total < math.inf and places[id(node)] > 1 and is_value:
            apart.add(id(node))
        return total

    for tree in trees:
        folded(tree, size)
    return apart


def _is_put_into(node: Node, put_into: Collection[str | None]) -> bool:
    """Whether a node is replaced later: by a direction, a derivative, or a defined variable."""
    if isinstance(node, Name):
        return node.name in put_into
    return isinstance(node, Call) and node.function in ("sign", "der")


def _sum_with(side: _Sides, names: Collection[str]) -> sp.Expr:
    """The sum of a balance's own terms that contain any of these names."""
    containing = [name for name, t in side.balance.terms.items() if not t.names.isdisjoint(names)]
    return sum((side.terms[name] for name in containing), sp.S.Zero)


def _places(trees: Sequence[Node]) -> Counter[int]:
    """In how many places each node of the trees stands."""
    nodes = {id(node): node for tree in trees for node in walk(tree)}
    places = Counter(map(id, trees))
    for node in nodes.values():
        places.update(map(id, node.operands if isinstance(node, Operation | Call) else ()))
    return places


def _needed(side: _Sides, sides: list[_Sides]) -> list[_Sides]:
    """The sides that have to be solved together with this one, or before it, in their order."""
    needed = [side]
    for known in needed:  # grows while it is walked along
        symbols = sum(known.terms.values()).free_symbols
        needed += [side for side in sides if side.defines in symbols and side not in needed]
    return [side for side in sides if side in needed]


def _is_name(tree: Node, name: str) -> bool:
    return isinstance(tree, Name) and tree.name == name
