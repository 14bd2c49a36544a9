"""Equations → LLVM assembly: rates, exact Jacobians, outputs and signals, as functions called by
address.

The functions are straight-line arithmetic, so they are written in the compiler's own language:
translating a Python text of them (type inference above all) takes ten times as long as compiling
what comes out of it. Every expression is computed once a function, however often it occurs;
branches are selections, so nothing is skipped and nothing can trap.

Each function is `void name(x, u, ur, p, s, m, r₀, r₁, r₂)` of pointers to doubles: states, inputs
(time last), their slopes, parameters, directions, motion of each surface, and three arrays for
results.
"""

from __future__ import annotations

import hashlib
import struct
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import reduce
from typing import Any, ClassVar

import sympy as sp
from sympy.logic.boolalg import Boolean

from residuum.identification.errors import NoExplicitEquations
from residuum.identification.physics.compile import implicit
from residuum.identification.physics.compile.composition import TIME, Equations
from residuum.identification.physics.compile.equation_functions import (
    SYMBOLS,
    ExternalSlope,
    ExternalValue,
    SteppedRound,
)
from residuum.identification.physics.compile.machine_code import FUNCTIONS
from residuum.identification.physics.compile.stepping_code import FREE, columns_of, stepping

ARGUMENTS = ("x", "u", "ur", "p", "s", "m", "r0", "r1", "r2")
_COMPARISONS = {"<": "olt", "<=": "ole", ">": "ogt", ">=": "oge", "==": "oeq", "!=": "une"}

Slot = tuple[str, int]
"""Where a value goes: a result array and the place in it."""
Rows = Mapping[int, sp.Expr]
"""An expression for each row of the results."""
_FLAT = (sp.sign, sp.floor, sp.Heaviside)
"""Functions whose slope is nothing, a jump included."""


_LIBRARY = {
    sp.tanh: "tanh",
    sp.tan: "tan",
    sp.asin: "asin",
    sp.acos: "acos",
    sp.atan: "atan",
    sp.sinh: "sinh",
    sp.cosh: "cosh",
}
"""Functions of the C library."""
_INTRINSICS = {
    sp.sin: "sin",
    sp.cos: "cos",
    sp.exp: "exp",
    sp.log: "log",
    sp.Abs: "fabs",
    sp.floor: "floor",
}


def names_of(equations: Equations) -> dict[str, list[Any]]:
    """What the functions are about: names and counts, in their order."""
    eq = equations
    return {
        "states": list(eq.x),
        "inputs": list(eq.u),
        "parameters": list(eq.p),
        "outputs": list(eq.outputs),
        "signals": list(eq.signals),
        "deviating": list(eq.deviating),
        "sizes": list(map(len, (eq.x, eq.u, eq.p, eq.outputs, eq.signals))),
        "surfaces": list(eq.surfaces),
        "delays": [
            -1 if name not in eq.delays else _index(eq.p.values(), eq.delays[name]) for name in eq.u
        ],
        "own": [list(eq.x).index(name) for name in eq.initial],
        "remembered": [list(eq.x).index(name) for name in eq.initial if name not in eq.deviating],
    }


def generate(equations: Equations) -> tuple[str, ...]:
    """The assembly of the modules that make a structure.

    Its own has `FUNCTIONS` and `STEPPING`; those that follow are shared with structures that are
    alike in them.
    """
    nx, nu, n_p, ny = map(len, (equations.x, equations.u, equations.p, equations.outputs))
    functions = _functions(equations)
    used = {*_INTRINSICS.values(), "pow", "sqrt"}
    declared = [
        f"declare double @llvm.{f}.f64({', '.join(['double'] * (2 if f == 'pow' else 1))})"
        for f in sorted(used)
    ]
    declared += [
        f"declare double @{SYMBOLS[0]}(i64, ptr)",
        f"declare double @{SYMBOLS[1]}(i64, i64, ptr)",
    ]
    systems = {name: system for function in functions for name, system in function.roots.items()}
    bodies = [function.text() for function in functions]
    # Each root brings two functions: one step of Newton's method, and the loop around it.
    for name, (z, a, g, start) in systems.items():
        bodies += [
            _NewtonStep(f"{name}_step", z, a, g).text(),
            implicit.newton(name, [float(value) for value in start]),
        ]
    declared += [f"declare double @{f}(double)" for f in _LIBRARY.values()] + [
        "declare double @atan2(double, double)"
    ]
    own = "\n\n".join([*declared, *bodies, stepping(nx, nu, n_p, ny)])
    slopes = functions[FUNCTIONS.index("slopes")]
    return own, *columns_of(nx, ny, slopes.places("r1", nx), slopes.places("r2", n_p + nx))


def _index(symbols: Iterable[sp.Symbol], wanted: sp.Symbol) -> int:
    return list(symbols).index(wanted)


def _functions(eq: Equations) -> list[_Function]:
    # A state that sticks has no rate: m is 0 there, else 1.
    moving = {row: sp.Symbol(f"m_{number}", real=True) for number, row in enumerate(eq.surfaces)}
    rates = {i: moving.get(i, sp.S.One) * rate for i, rate in enumerate(eq.rates)}
    start = {list(eq.x).index(name): expression for name, expression in eq.initial.items()}
    outputs = dict(enumerate(eq.outputs.values()))
    signals = dict(enumerate(eq.signals.values()))
    # (values, slopes) of each function, in the order of FUNCTIONS.
    given: list[tuple[Rows, Rows]] = [
        (rates, {}),
        (rates, rates),
        (start, start),
        (outputs, {}),
        ({}, outputs),
        (signals, {}),
    ]
    return [_Function(name, eq, *pair) for name, pair in zip(FUNCTIONS, given, strict=True)]


def _loads(eq: Equations) -> dict[sp.Symbol, Slot]:
    loads = {symbol: ("x", k) for k, symbol in enumerate(eq.x.values())}
    loads |= {symbol: ("u", k) for k, symbol in enumerate(eq.u.values())}
    loads |= {sp.Symbol(f"ur_{k}", real=True): ("ur", k) for k in range(len(eq.u))}
    loads |= {symbol: ("p", k) for k, symbol in enumerate(eq.p.values())}
    loads |= {symbol: ("s", k) for k, symbol in enumerate(eq.surfaces.values())}
    loads |= {sp.Symbol(f"m_{k}", real=True): ("m", k) for k in range(len(eq.surfaces))}
    return loads | {TIME: ("u", len(eq.u))}


class _Function:
    """A function while it is written: a line an operation, the value of each expression and each
    slope remembered.

    The values of `rows` go to the first array, the slopes of `sloping` by states and by parameters
    to those that follow.
    """

    def __init__(self, name: str, eq: Equations, rows: Rows, sloping: Rows) -> None:
        moved = {
            eq.u[n]: (d, sp.Symbol(f"ur_{list(eq.u).index(n)}", real=True))
            for n, d in eq.delays.items()
        }
        self._begin(name, _loads(eq), moved, eq.defined)
        self.stores: dict[Slot, str] = {
            ("r0", i): self.value(sp.sympify(e)) for i, e in rows.items()
        }
        # A function that writes no values has its slopes in the first arrays.
        matrices = ("r1", "r2") if rows else ("r0", "r1")
        for i, e in sloping.items():
            for matrix, by, width in zip(
                matrices, (eq.x, eq.p), (len(eq.x), len(eq.p) + len(eq.x)), strict=True
            ):
                slopes = {
                    (matrix, i * width + j): self.slope(sp.sympify(e), v)
                    for j, v in enumerate(by.values())
                }
                # What is always zero is not stored: the arrays are zero at first, and the step
                # leaves such places out.
                self.stores |= {slot: slope for slot, slope in slopes.items() if slope is not None}

    def _begin(
        self,
        name: str,
        loads: Mapping[sp.Symbol, Slot],
        moved: Mapping[Any, tuple[Any, Any]],
        defined: Mapping[sp.Symbol, sp.Expr],
    ) -> None:
        self.name = name
        self.loads = loads
        self.moved = moved
        self.defined = defined
        self.roots: dict[str, Any] = {}
        self.lines: list[str] = []
        self.known: dict[Any, str] = {}
        self.dependent: dict[Any, frozenset[sp.Symbol]] = {}
        self.known_slopes: dict[tuple[Any, sp.Symbol], str | None] = {}

    def text(self) -> str:
        """All values first, then the stores: a result array may be one of the arguments."""
        for (array, index), value in self.stores.items():
            self.lines.append(f"store double {value}, ptr {self._place(array, index)}")
        arguments = ", ".join(f"ptr %{name}" for name in ARGUMENTS)
        return "\n".join(
            [
                f"define void @{self.name}({arguments}) {{",
                *(f"  {line}" for line in self.lines),
                "  ret void",
                "}",
            ]
        )

    def places(self, matrix: str, width: int) -> list[tuple[int, int]]:
        """Row and column of what a matrix of slopes holds beside zeros."""
        return [divmod(k, width) for array, k in self.stores if array == matrix]

    def slope(self, e: Any, by: sp.Symbol) -> str | None:
        """What holds the slope of an expression by a symbol, by the chain rule; None where it is
        nothing.

        SymPy's own derivatives take ten times as long to find, and repeat what a chain has in
        common.
        """
        if by not in self._depends(e):
            return None
        if e in self.defined:
            return self.slope(self.defined[e], by)
        if (e, by) not in self.known_slopes:
            self.known_slopes[e, by] = self._slope(e, by)
        return self.known_slopes[e, by]

    def _depends(self, e: Any) -> frozenset[sp.Symbol]:
        """Symbols by which an expression may have a slope: its own, and the delay of an input."""
        if e in self.defined:
            return self._depends(self.defined[e])
        if e not in self.dependent:
            if e.is_Symbol:
                self.dependent[e] = frozenset({e, self.moved[e][0]} if e in self.moved else {e})
            else:
                self.dependent[e] = frozenset().union(*map(self._depends, e.args))
        return self.dependent[e]

    def _slope(self, e: Any, by: sp.Symbol) -> str | None:
        if e.is_Symbol:
            return (
                _ONE if e == by else self._new(f"fneg {FREE} double {self.value(self.moved[e][1])}")
            )
        if isinstance(e, sp.Piecewise):
            return self._piecewise_slope(e, by)
        # A jump has no slope that an estimation could use: it is switched, not differentiated.
        if isinstance(e, (*_FLAT, Boolean)):
            return None
        if isinstance(e, implicit.Root):
            return self._root_slope(e, by)
        # The chain rule: Σ ∂e/∂part · ∂part/∂by, over the parts that depend on it.
        slopes = [(i, self.slope(part, by)) for i, part in enumerate(e.args)]
        terms = [
            self._times(self._partial(e, i), slope) for i, slope in slopes if slope is not None
        ]
        return self._fold("fadd", terms) if terms else None

    def _piecewise_slope(self, e: sp.Piecewise, by: sp.Symbol) -> str | None:
        """The slope of the piece that holds; jumps between pieces have none."""
        pieces = [(self.slope(value, by), condition) for value, condition in e.args]
        if not any(slope for slope, _ in pieces):
            return None
        return self._chosen([(slope or _ZERO, condition) for slope, condition in pieces])

    def _partial(self, e: Any, i: int) -> str:
        """What holds the slope of an operation by its argument i."""
        if e.is_Add:
            return _ONE
        if e.is_Mul:
            # The product of all other factors.
            return self.value(sp.Mul(*e.args[:i], *e.args[i + 1 :], evaluate=False))
        if isinstance(e, sp.atan2):
            y, x = e.args
            # ∂atan2/∂y = x/(x² + y²), ∂/∂x = −y/(x² + y²).
            return self.value((x, -y)[i] / (x**2 + y**2))
        if not e.is_Pow:
            return self.value(sp.sympify(e.fdiff(i + 1)))
        # ∂bᵃ/∂a = bᵃ·ln b.
        if i == 1:
            return self._times(self.value(e), self.value(sp.log(e.base)))
        if e.exp == sp.Rational(1, 2):
            # ½/√b.
            return self._times(_constant(0.5), self._inverse_root(e.base))
        return self._times(self.value(e.exp), self.value(e.base ** (e.exp - 1)))

    def _times(self, a: str, b: str) -> str:
        if _ONE in (a, b):
            return b if a == _ONE else a
        return self._new(f"fmul {FREE} double {a}, {b}")

    def value(self, e: Any) -> str:
        """The name of the register, or the constant, that holds an expression."""
        if e in self.defined:
            return self.value(self.defined[e])
        if e not in self.known:
            self.known[e] = self._write(e)
        return self.known[e]

    def _write(self, e: Any) -> str:
        if e.is_Symbol:
            array, index = self.loads[e]
            return self._new(f"load double, ptr {self._place(array, index)}")
        if e in (sp.true, sp.false):
            return "true" if e else "false"
        if e.is_number and not e.is_Boolean:
            return _constant(_real_number(e))
        if type(e) in _INTRINSICS:
            return self._call(f"llvm.{_INTRINSICS[type(e)]}.f64", e.args[0])
        if type(e) in _LIBRARY:
            return self._call(_LIBRARY[type(e)], e.args[0])
        if e.is_Relational:
            return self._new(
                f"fcmp {_COMPARISONS[e.rel_op]} double {self.value(e.lhs)}, {self.value(e.rhs)}"
            )
        rule = self._RULES.get(type(e))
        if rule is None:
            raise NoExplicitEquations(
                f"model: its equations hold a {type(e).__name__}, which has no code; write it"
                " otherwise"
            )
        return rule(self, *e.args)

    def _add(self, *terms: sp.Expr) -> str:
        positive = [t for t in terms if not t.could_extract_minus_sign()]
        negative = [-t for t in terms if t.could_extract_minus_sign()]
        # Sums first, then what is subtracted: no product with −1.
        total = self._fold("fadd", [self.value(t) for t in positive]) if positive else _ZERO
        for term in negative:
            total = self._new(f"fsub {FREE} double {total}, {self.value(term)}")
        return total

    def _mul(self, *factors: sp.Expr) -> str:
        above = [f for f in factors if not _is_reciprocal(f)]
        below = [f.base**-f.exp for f in factors if _is_reciprocal(f)]
        # SymPy writes −a as −1·a: one negation instead of a product.
        negative = above[:1] == [sp.S.NegativeOne]
        product = self._fold("fmul", [self.value(f) for f in above[negative:]] or [_ONE])
        # One division for all reciprocals together.
        if below:
            product = self._new(
                f"fdiv {FREE} double {product},"
                f" {self._fold('fmul', [self.value(f) for f in below])}"
            )
        return self._new(f"fneg {FREE} double {product}") if negative else product

    def _pow(self, base: sp.Expr, exponent: sp.Expr) -> str:
        if exponent == sp.Rational(1, 2):
            return self._call("llvm.sqrt.f64", base)
        if exponent.is_Integer and 1 <= abs(int(exponent)) <= 4:
            product = self._fold("fmul", [self.value(base)] * abs(int(exponent)))
            return product if exponent > 0 else self._new(f"fdiv {FREE} double {_ONE}, {product}")
        return self._new(
            f"call double @llvm.pow.f64(double {self.value(base)}, double {self.value(exponent)})"
        )

    def _atan2(self, y: sp.Expr, x: sp.Expr) -> str:
        return self._new(f"call double @atan2(double {self.value(y)}, double {self.value(x)})")

    def _sign(self, a: sp.Expr) -> str:
        negative = self._select(self._compare("olt", a, sp.S.Zero), _constant(-1.0), _ZERO)
        return self._select(self._compare("ogt", a, sp.S.Zero), _ONE, negative)

    def _heaviside(self, a: sp.Expr, *_: sp.Expr) -> str:
        return self._select(self._compare("ogt", a, sp.S.Zero), _ONE, _ZERO)

    def _external_value(self, k: sp.Expr, *arguments: sp.Expr) -> str:
        return self._new(f"call double @{SYMBOLS[0]}(i64 {k}, ptr {self._array(arguments)})")

    def _external_slope(self, k: sp.Expr, j: sp.Expr, *arguments: sp.Expr) -> str:
        return self._new(
            f"call double @{SYMBOLS[1]}(i64 {k}, i64 {j}, ptr {self._array(arguments)})"
        )

    def _root(self, i: sp.Expr, *given: Any) -> str:
        z = self._solution(given[:4], given[4:])
        values = int(i)
        return self._new(
            f"load double, ptr {self._new(f'getelementptr double, ptr {z}, i64 {values}')}"
        )

    def _solution(self, system: tuple[Any, ...], values: tuple[sp.Expr, ...]) -> str:
        """Where the root of a system stands, found once a function."""
        key = (system, values)
        if key not in self.known:
            # Named by what it solves: two places that ask for the same root share it.
            name = f"root_{hashlib.sha256(str(system).encode()).hexdigest()[:16]}"
            self.roots[name] = system
            a = self._array(values)
            self.known[key] = self._new(f"alloca [{len(system[0])} x double]")
            self.lines.append(f"call void @{name}(ptr {a}, ptr {self.known[key]})")
        return self.known[key]

    def _root_slope(self, e: Any, by: sp.Symbol) -> str:
        """−J⁻¹ ∂g/∂by at the root."""
        i, z, a, g, start, *values = e.args
        root = [
            self._held(self.value(implicit.Root(sp.Integer(k), z, a, g, start, *values)))
            for k in range(len(z))
        ]
        # The system at the root, in registers: its slopes are those of any other expression.
        at = dict(zip(z, root, strict=True)) | dict(zip(a, values, strict=True))
        equations = [equation.xreplace(at) for equation in g]
        right = [self._held(self.slope(equation, by)) for equation in equations]
        return self.value(-implicit.solved(self._jacobian(equations, root), right)[int(i)])

    def _jacobian(self, equations: Sequence[Any], unknown: Sequence[Any]) -> list[list[Any]]:
        """Symbols that hold the slopes of equations by unknown symbols."""
        return [
            [self._held(self.slope(equation, symbol)) for symbol in unknown]
            for equation in equations
        ]

    def _held(self, register: str | None) -> Any:
        """A symbol for what a register holds; zero for nothing."""
        if register is None:
            return sp.S.Zero
        # So a register can stand in an expression, and the adjugate be written by SymPy.
        symbol = sp.Symbol(f"held_{register}", real=True)
        self.known[symbol] = register
        return symbol

    def _array(self, values: tuple[sp.Expr, ...]) -> str:
        """Where values stand side by side."""
        if values not in self.known:
            registers = [self.value(value) for value in values]
            array = self.known[values] = self._new(f"alloca [{len(values)} x double]")
            for k, register in enumerate(registers):
                place = self._new(f"getelementptr double, ptr {array}, i64 {k}")
                self.lines.append(f"store double {register}, ptr {place}")
        return self.known[values]

    def _nothing(self, *_: sp.Expr) -> str:
        return _ZERO

    def _rounded(self, a: sp.Expr) -> str:
        return self._call("llvm.floor.f64", a + sp.Rational(1, 2))

    def _inverse_root(self, a: sp.Expr) -> str:
        """1/√a in the slope of a root, kept finite where the root is zero (an empty tank)."""
        return self._new(
            f"fdiv {FREE} double {_ONE}, {self.value(sp.sqrt(sp.Max(a, sp.Float(1e-12))))}"
        )

    def _max(self, *choices: sp.Expr) -> str:
        return self._extreme("ogt", choices)

    def _min(self, *choices: sp.Expr) -> str:
        return self._extreme("olt", choices)

    def _extreme(self, comparison: str, choices: Iterable[sp.Expr]) -> str:
        def better(best: str, candidate: str) -> str:
            return self._select(
                self._new(f"fcmp {comparison} double {candidate}, {best}"), candidate, best
            )

        return reduce(better, map(self.value, choices))

    def _piecewise(self, *pieces: Any) -> str:
        return self._chosen([(self.value(value), condition) for value, condition in pieces])

    def _chosen(self, pieces: Sequence[tuple[str, Any]]) -> str:
        chosen = _ZERO
        # From the last piece to the first: the first condition that holds is chosen last.
        for value, condition in reversed(pieces):
            chosen = (
                value
                if condition == sp.true
                else self._select(self.value(condition), value, chosen)
            )
        return chosen

    def _and(self, *conditions: Any) -> str:
        return self._fold_bits("and", conditions)

    def _or(self, *conditions: Any) -> str:
        return self._fold_bits("or", conditions)

    def _not(self, condition: Any) -> str:
        return self._new(f"xor i1 {self.value(condition)}, true")

    def _if_then_else(self, condition: Any, yes: Any, no: Any) -> str:
        return self._new(
            f"select i1 {self.value(condition)}, i1 {self.value(yes)}, i1 {self.value(no)}"
        )

    def _fold_bits(self, operation: str, conditions: Iterable[Any]) -> str:
        return reduce(
            lambda a, b: self._new(f"{operation} i1 {a}, {b}"), map(self.value, conditions)
        )

    def _fold(self, operation: str, values: Iterable[str]) -> str:
        return reduce(lambda a, b: self._new(f"{operation} {FREE} double {a}, {b}"), values)

    def _compare(self, comparison: str, left: sp.Expr, right: sp.Expr) -> str:
        return self._new(f"fcmp {comparison} double {self.value(left)}, {self.value(right)}")

    def _select(self, condition: str, yes: str, no: str) -> str:
        return self._new(f"select i1 {condition}, double {yes}, double {no}")

    def _call(self, function: str, argument: sp.Expr) -> str:
        return self._new(f"call double @{function}(double {self.value(argument)})")

    def _place(self, array: str, index: int) -> str:
        return self._new(f"getelementptr double, ptr %{array}, i64 {index}")

    def _new(self, operation: str) -> str:
        name = f"%v{len(self.lines)}"
        self.lines.append(f"{name} = {operation}")
        return name

    _RULES: ClassVar[dict[Any, Callable[..., str]]] = {
        sp.Add: _add,
        sp.Mul: _mul,
        sp.Pow: _pow,
        sp.atan2: _atan2,
        sp.sign: _sign,
        sp.Heaviside: _heaviside,
        sp.DiracDelta: _nothing,
        SteppedRound: _rounded,
        ExternalValue: _external_value,
        ExternalSlope: _external_slope,
        sp.Max: _max,
        sp.Min: _min,
        sp.Piecewise: _piecewise,
        sp.And: _and,
        sp.Or: _or,
        sp.Not: _not,
        sp.ITE: _if_then_else,
        implicit.Root: _root,
    }


class _NewtonStep(_Function):
    """Newton's next z of g(z, a) = 0, then ‖g‖² at this z; a is in place of the states, z of the
    inputs.
    """

    def __init__(self, name: str, z: Sequence[Any], a: Sequence[Any], g: Sequence[Any]) -> None:
        places = (("x", a), ("u", z))
        self._begin(
            name,
            {symbol: (array, k) for array, symbols in places for k, symbol in enumerate(symbols)},
            {},
            {},
        )
        steps = implicit.solved(
            self._jacobian(g, z), [self._held(self.value(equation)) for equation in g]
        )
        results = [
            *(at - step for at, step in zip(z, steps, strict=True)),
            sum(equation**2 for equation in g),
        ]
        self.stores = {("r0", k): self.value(result) for k, result in enumerate(results)}


def _is_reciprocal(factor: sp.Expr) -> bool:
    return bool(factor.is_Pow and factor.exp.is_number and factor.exp.is_negative)


def _real_number(e: sp.Expr) -> float:
    """The number; NoExplicitEquations where a term divides by zero or has a negative root, whatever
    the values.
    """
    if e is sp.nan or e.is_extended_real is False:
        raise NoExplicitEquations(
            f"model: its equations hold {e}, no real number: a term divides by zero or has no root"
        )
    return float(e)


def _constant(value: float) -> str:
    # Bits in hexadecimal: decimals of LLVM must be exact doubles.
    return f"0x{struct.unpack('>Q', struct.pack('>d', value))[0]:016X}"


# By their text, products with them are recognised and left out.
_ZERO, _ONE = _constant(0.0), _constant(1.0)
