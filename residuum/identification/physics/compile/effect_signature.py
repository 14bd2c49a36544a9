"""What a physical effect looks like: its own equation along a standard movement, against its
natural argument.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
import sympy as sp

from residuum.identification.physics.effects.base import (
    Conditions,
    Contribution,
    Effect,
    Parameter,
    Scene,
    Site,
)

Array = npt.NDArray[np.float64]
# Samples of a period, periods, and every how manieth sample is drawn: 200 points a period.
_SAMPLES, _PERIODS, _EVERY = 800, 2, 4
_COARSE = 0.2  # steps of a coarse sensor, for the effect that is one
_MODULES = [{"SteppedRound": np.round}, "numpy"]
_t, _signal, _direction = sp.symbols("t signal direction", real=True)
_ORDER = ("position", "velocity", "current", "temperature", "level", "supply")
_PATHS = ("input", "output")


@dataclass(frozen=True)
class Scenario:
    """A standard movement of a balance or a path: its site, period [s], storage, driving magnitude
    and supply.
    """

    site: Site
    period: float
    storage: float = 1.0
    magnitude: float = 1.0
    supply: float = 12.0


_MECHANICAL = {"supply": "V", "current": "A"}
SCENARIOS: Mapping[str, Scenario] = {
    "torque": Scenario(
        Site("torque", "shaft", "N*m", {"velocity": "rad/s", "position": "rad"} | _MECHANICAL),
        2.0,
        0.1,
    ),
    "force": Scenario(
        Site("force", "axis", "N", {"velocity": "m/s", "position": "m"} | _MECHANICAL), 2.0, 0.1
    ),
    "voltage": Scenario(
        Site(
            "voltage",
            "winding",
            "V",
            {"current": "A", "velocity": "rad/s", "supply": "V", "defined": "A"},
        ),
        1.0,
        1.0,
        12.0,
    ),
    "heat": Scenario(
        Site("heat", "chamber", "W", {"temperature": "°C", "supply": "W"}),
        3600.0,
        2000.0,
        1000.0,
        1000.0,
    ),
    "volume": Scenario(
        Site("volume", "tank", "m**3/s", {"level": "m", "supply": "V"}), 600.0, 0.02, 1e-3
    ),
    "input": Scenario(Site("input", "u", "V"), 1.0, 1.0, 8.0),
    "output": Scenario(Site("output", "y", "rad/s"), 1.0, 1.0, 8.0),
}


@dataclass(frozen=True, eq=False)
class Signature:
    """A curve: `value` [unit] against `at` [axis_unit].

    `before` is the path's signal without the effect (None for a balance); `parameters` hold the
    values that it is drawn with.
    """

    kind: str
    axis: str
    axis_unit: str
    unit: str
    at: Array
    value: Array
    before: Array | None
    parameters: tuple[Parameter, ...]


def signature(effect: Effect, kind: str | None = None) -> Signature:
    """The effect's term (or its path's signal) along the standard movement of a kind of balance
    (default: the first it acts on).

    Speeds, currents and signals swing as sines, temperatures and levels rise and fall evenly,
    positions are the speed's integral; the effect's own states are integrated (Runge–Kutta). Of the
    effect's first values the most conspicuous are drawn, over time both periods, else the second
    one, in which what an effect remembers has settled.

    >>> from residuum.identification.physics.effects import EFFECTS
    >>> drawn = signature(EFFECTS["coulomb-friction"])
    >>> drawn.axis, drawn.axis_unit, bool(np.all(drawn.value * drawn.at <= 0))
    ('velocity', 'rad/s', True)
    """
    scenario = SCENARIOS[effect.acts_on[0] if kind is None else kind]
    motion = _motion(scenario)
    known = {
        name: values
        for name, values in motion.items()
        if name in scenario.site.units or name in ("signal", "measured")
    }
    last = float(motion["t"][-1])
    conditions = Conditions(
        scenario.period / 200, last, scenario.magnitude, scenario.storage, known
    )
    parameters = {parameter.name: parameter for parameter in effect.parameters(scenario.site)}
    drawn = [
        _Drawing(effect, scenario, motion, {**_defaults(parameters), **start})
        for start in effect.starts(conditions)
    ]
    best = max(enumerate(drawn), key=lambda numbered: (numbered[1].conspicuous, numbered[0]))[1]
    axis = best.axis
    values = tuple(
        replace(parameter, value=float(best.values[name])) for name, parameter in parameters.items()
    )
    units = {"t": "s", "signal": scenario.site.unit, **scenario.site.units}
    name = {"t": "time"}.get(axis, axis)
    # Against another axis than time the first period would show how states settle.
    shown = slice(0 if axis == "t" else _SAMPLES, None, _EVERY)
    before = None if best.before is None else best.before[shown]
    at = motion[axis][shown]
    value = best.value[shown]
    return Signature(
        scenario.site.kind, name, units[axis], scenario.site.unit, at, value, before, values
    )


def _defaults(parameters: Mapping[str, Parameter]) -> dict[str, float]:
    return {name: parameter.value for name, parameter in parameters.items()}


def _motion(scenario: Scenario) -> dict[str, Array]:
    """Every variable there is, over two periods."""
    t = np.linspace(0.0, _PERIODS * scenario.period, _PERIODS * _SAMPLES + 1)
    turn = 2 * np.pi * t / scenario.period
    # A sine, and a triangle from 0 to 1 and back.
    swing = np.sin(turn)
    even = 1.0 - np.abs(1.0 - 2.0 * ((t / scenario.period) % 1.0))
    size = scenario.magnitude
    driven = even if scenario.site.kind in ("heat", "volume") else swing
    return {
        "t": t,
        "velocity": 10.0 * swing,
        "position": 10.0 * scenario.period / (2 * np.pi) * (1 - np.cos(turn)),
        "current": 5.0 * swing,
        "temperature": 20.0 + 180.0 * even,
        "level": 0.05 + 0.95 * even,
        "supply": scenario.supply * driven,
        "supply_terms": size * driven,
        "drive": np.full_like(t, size),
        "storage": np.full_like(t, scenario.storage),
        "defined": 5.0 * swing,
        "signal": size * swing,
        "measured": _COARSE * size * np.round(swing / _COARSE),
        # Rounding: the sine of a whole turn is 1e-16, and would be taken for motion.
        "direction": np.sign(np.where(np.abs(swing) < 1e-9, 0.0, swing)),
    }


class _Drawing:
    """One set of values, evaluated along the movement."""

    def __init__(
        self,
        effect: Effect,
        scenario: Scenario,
        motion: Mapping[str, Array],
        values: Mapping[str, float],
    ) -> None:
        self.values = values
        site = scenario.site
        self._p = {name: sp.Symbol(f"p_{name}", real=True) for name in values}
        self._x = {name: sp.Symbol(f"x_{name}", real=True) for name in effect.states(site)}
        self._roles = {
            name: sp.Symbol(name, real=True)
            for name in (*site.units, "supply_terms", "drive", "storage")
        }
        scene = Scene(site, self._p, self._x, self._roles, _direction, _signal, _t)
        self._motion = motion
        added = effect.contribution(scene)
        self._states = self._integrated(added)
        self.before = motion["signal"] if site.kind in _PATHS else None
        self.value = self._path(added) if site.kind in _PATHS else self._term(added)
        self.axis = self._axis(site, added)

    @property
    def conspicuous(self) -> float:
        """How much of the picture the effect fills: where it is felt; on a path, how much it
        changes.
        """
        if self.before is not None:
            return round(float(np.sqrt(np.mean((self.value - self.before) ** 2))), 3)
        # Rounded, so that first values that fill the picture alike are told apart by their order
        # alone.
        return round(float(np.mean(np.abs(self.value) > 0.05 * np.abs(self.value).max())), 2)

    def _evaluated(self, expression: sp.Expr) -> Array:
        function = self._function([expression])
        row = function(self._inputs(), self._states)[0]
        return np.asarray(np.broadcast_to(row, self._motion["t"].shape), dtype=float)

    def _inputs(self) -> list[Array]:
        names = [symbol.name for symbol in self._symbols]
        return [self._motion[name] for name in names]

    @property
    def _symbols(self) -> list[sp.Symbol]:
        return [*self._roles.values(), _direction, _signal, _t]

    def _function(
        self, expressions: Sequence[sp.Expr]
    ) -> Callable[[Sequence[Array], Sequence[Array]], list[Array]]:
        values = {symbol: self.values[name] for name, symbol in self._p.items()}
        fixed = [sp.sympify(expression).subs(values) for expression in expressions]
        function: Callable[..., list[Array]] = sp.lambdify(
            [self._symbols, list(self._x.values())], fixed, modules=_MODULES
        )
        return function

    def _integrated(self, added: Contribution) -> list[Array]:
        """The effect's own states, a row each; inputs between two samples are their mean."""
        if not self._x:
            return []
        names = list(self._x)
        rates = self._function([added.rates[name] for name in names])
        U = np.array(self._inputs())
        begin = self._function([sp.sympify(added.initial[name]) for name in names])(
            list(U[:, 0]), [np.zeros(())] * len(names)
        )
        step = float(self._motion["t"][1])
        X = np.empty((len(names), U.shape[1]))
        X[:, 0] = np.array(begin, dtype=float)

        def rate(u: Array, x: Array) -> Array:
            return np.array(rates(list(u), list(x)), dtype=float)

        # The integrator of models would need a whole model around the effect.
        for k in range(U.shape[1] - 1):
            u0 = U[:, k]
            u1 = U[:, k + 1]
            x = X[:, k]
            # Runge and Kutta with inputs that move evenly between two samples.
            half = (u0 + u1) / 2
            a = rate(u0, x)
            b = rate(half, x + step / 2 * a)
            c = rate(half, x + step / 2 * b)
            X[:, k + 1] = x + step / 6 * (a + 2 * b + 2 * c + rate(u1, x + step * c))
        return list(X)

    def _path(self, added: Contribution) -> Array:
        if added.delay is not None:
            late = self._motion["t"] - self.values[str(added.delay.name).removeprefix("p_")]
            return np.asarray(np.interp(late, self._motion["t"], self._motion["signal"]))
        return self._evaluated(_signal if added.signal is None else added.signal)

    def _term(self, added: Contribution) -> Array:
        if added.inductance is None:
            return self._evaluated(added.term)
        # An inductance is no term: the voltage that it takes is −L·di/dt.
        return -self._evaluated(added.inductance) * np.gradient(
            self._motion["current"], self._motion["t"]
        )

    def _remembers(self, added: Contribution) -> bool:
        """Whether the effect depends on what was before."""
        return bool(self._x) or added.inductance is not None or added.delay is not None

    def _axis(self, site: Site, added: Contribution) -> str:
        """Time where the effect remembers or waits (a position where it is mechanical), else what
        its equation asks for first.
        """
        mechanical = site.kind in ("torque", "force")
        asked = sp.sympify(added.term).free_symbols
        if self._remembers(added) or _t in asked:
            return "position" if mechanical else "t"
        if site.kind in _PATHS:
            return "signal"
        # Frictions and drops are known by their curve against speed or current.
        if _direction in asked:
            return "velocity" if mechanical else "current"
        first = next((role for role in _ORDER if self._roles.get(role) in asked), None)
        return first or ("velocity" if mechanical else "t")
