"""What every physical effect is: one more term in one balance, or one more stage on the path of an
input or output.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import TYPE_CHECKING, ClassVar

import numpy as np
import numpy.typing as npt

from residuum.identification.physics.compile import symbolic as sp
from residuum.identification.units import Unit, parse_unit

if TYPE_CHECKING:
    from residuum.identification.physics.effects.example_models import Example

Array = npt.NDArray[np.float64]
# 1e-60³ = 1e-180, far above the smallest double (2e-308).
RESTS = 1e-60
"""Below it a variable does not move; its cube is still a number. Chosen."""


@dataclass(frozen=True)
class Prior:
    """What was known of a number before any record: normal, `mean` ± `std`."""

    mean: float
    std: float

    def __str__(self) -> str:
        return f"{self.mean!r} ± {self.std!r}"


@dataclass(frozen=True)
class Parameter:
    """A number of a model: value, unit, bounds, meaning; `fixed` keeps it out of the estimation, a
    `prior` draws it. An effect's parameter may have to lie `below` another of its parameters (the
    ends of a travel): where it does not there is no such machine, and no estimate comes out.
    """

    name: str
    value: float
    unit: str = ""
    lower: float = -np.inf
    upper: float = np.inf
    fixed: bool = False
    meaning: str = ""
    prior: Prior | None = None
    below: str = ""


@dataclass(frozen=True)
class Site:
    """Where an effect is attached, as the effect sees it.

    Parameters
    ----------
    kind : str
        Balance kind (`torque`, `force`, `voltage`, `heat`, `volume`, `signal`), or `input` or
        `output`.
    name : str
        Name of the balance, input or output.
    unit : str
        Unit of the balance's terms, or of the signal.
    units : mapping of role to unit
        The variables there are: `velocity`, `position`, `current`, `temperature`, `ambient`,
        `level`, `supply` (the input that drives the balance); the effect's `needs` must be among
        them.
    signals : tuple of str
        What the effect is tied to besides, by name: signals of the model, or another balance;
        signals are in `units` too.
    """

    kind: str
    name: str
    unit: str
    units: Mapping[str, str] = field(default_factory=dict)
    signals: tuple[str, ...] = ()

    def per(self, role: str, power: float = 1.0) -> str:
        """The balance's unit divided by a power of a variable's unit.

        >>> Site("torque", "shaft", "N*m", {"velocity": "rad/s"}).per("velocity")
        'N*m*s/rad'
        """
        return quotient(self.unit, self.units[role], power)


@dataclass(frozen=True)
class Scene:
    """The symbols an effect writes its equation with.

    `p` and `x` are the effect's own parameters and states by name; `variables` has, by role, the
    balance's variables and in addition `supply` (the input), `supply_terms` and `drive` (sums of
    the balance's terms that contain an input, an input or a current) and `storage` (what multiplies
    the derivative); `direction` is the sign of the velocity or current, zero at standstill;
    `signal` is the path's signal so far, `t` the time since the record's start [s].
    """

    site: Site
    p: Mapping[str, sp.Symbol]
    x: Mapping[str, sp.Symbol]
    variables: Mapping[str, sp.Expr]
    direction: sp.Expr
    signal: sp.Expr
    t: sp.Symbol

    def __getitem__(self, role: str) -> sp.Expr:
        return self.variables[role]


@dataclass(frozen=True)
class Contribution:
    """What an effect adds to the equations.

    Parameters
    ----------
    term : expression
        Added to the balance's sum of terms.
    elsewhere : mapping of balance to expression
        Added to the terms of other balances.
    rates, initial : mapping of own state to expression
        Time derivative and initial value of the effect's own states.
    deviating : tuple of own state
        Those that may begin away from their initial value (a sensor that has not settled); by how
        much is estimated.
    storage_factor : expression
        Multiplies the balance's storage.
    inductance : expression
        Storage that a balance without storage receives: the variable that it defined becomes a
        state.
    signal : expression or None
        A path's signal after this stage.
    delay : symbol or None
        The parameter by which a recorded input is delayed [s].
    """

    term: sp.Expr = field(default_factory=lambda: sp.S.Zero)
    elsewhere: Mapping[str, sp.Expr] = field(default_factory=dict)
    rates: Mapping[str, sp.Expr] = field(default_factory=dict)
    initial: Mapping[str, sp.Expr] = field(default_factory=dict)
    deviating: tuple[str, ...] = ()
    storage_factor: sp.Expr = field(default_factory=lambda: sp.S.One)
    inductance: sp.Expr | None = None
    signal: sp.Expr | None = None
    delay: sp.Symbol | None = None


@dataclass(frozen=True)
class Conditions:
    """What is known of the operation when an effect is about to be tried: scales for its first
    values.

    Parameters
    ----------
    sample_time, duration : float
        Of the record [s].
    magnitude : float
        RMS of the balance's driving terms, or of the path's signal, in the site's unit.
    storage : float
        The balance's storage coefficient (inertia, mass, heat capacity, area), in the site's unit a
        unit of rate.
    variables : mapping of role to array
        The balance's variables along the simulation of the present model.
    missing : array or None
        What the effect `follows`, along the same samples: the balance's smoothed missing term, or
        what is left of an output.
    """

    sample_time: float
    duration: float
    magnitude: float
    storage: float = 1.0
    variables: Mapping[str, Array] = field(default_factory=dict)
    missing: Array | None = None

    def largest(self, role: str) -> float:
        """Largest magnitude of a variable (1 when it never moves)."""
        return _or_one(float(np.max(np.abs(self.variables[role]))))

    def span(self, role: str) -> float:
        """Largest minus smallest value of a variable (1 when it never moves)."""
        return _or_one(float(np.ptp(self.variables[role])))

    def quantile(self, role: str, fraction: float) -> float:
        """The value below which a variable spends `fraction` of the time."""
        return float(np.quantile(self.variables[role], fraction))


def _or_one(size: float) -> float:
    """A size that effects divide by, also by its powers: what a simulation of a machine at rest
    leaves of it is none.
    """
    return size if size > RESTS else 1.0


class Effect(ABC):
    """A physical effect of the catalogue.

    One of a kind that has a base class (`Friction`, `Drain`, `HeatLoss`, …) takes that as its own:
    it brings the balances, the variables, the examples and the law of its sign.

    Class attributes
    ----------------
    id : str
        Its name in model files, and its key in `EFFECTS`.
    title, equation, reference : str
        What is shown to the user.
    acts_on : tuple of str
        Balance kinds, or `input` / `output`.
    needs : tuple of str
        Roles of the variables its equation uses.
    sizes : tuple of str
        Parameters that all vanish when there is no effect. Empty: the effect has no zero (a delay
        of one sample, a limit) and is screened by trying its `starts`.
    rest : float
        Fraction of the starting size at which derivatives "at zero" are taken. Zero where the
        equation is smooth in the size; a small number for friction, whose standstill (an exactly
        zero velocity) exists only once there is some.
    follows : tuple of str
        What its `starts` look at, one after the other, as the conditions' `missing`: `lack` (what
        its balance lacked), `innovations` (what the noise cannot predict of an output), `error`
        (all the error of an output).
    natural_bounds : tuple of str
        Parameters that may well lie on a bound; any other estimate on a bound is another effect, or
        none, in disguise.
    generalises : str
        Effect that this one contains as a special case (or itself): where that one fits, this one
        is tried from there as well (`grown`).
    shifts : str
        Parameter that says by how much it shifts a signal in time [s]; empty: none does.
    """

    id: ClassVar[str]
    title: ClassVar[str]
    equation: ClassVar[str]
    reference: ClassVar[str]
    acts_on: ClassVar[tuple[str, ...]]
    needs: ClassVar[tuple[str, ...]] = ()
    sizes: ClassVar[tuple[str, ...]] = ()
    rest: ClassVar[float] = 0.0
    follows: ClassVar[tuple[str, ...]] = ()
    natural_bounds: ClassVar[tuple[str, ...]] = ()
    generalises: ClassVar[str] = ""
    shifts: ClassVar[str] = ""

    @property
    def vanishes(self) -> bool:
        """Whether a zero of all `sizes` removes the effect, so that derivatives at zero screen
        it.
        """
        return bool(self.sizes)

    def is_tied(self, target: str) -> bool:
        """Whether at this target it is tied to what the target names in brackets."""
        return False

    def joins(self, target: str) -> bool:
        """Whether it stands between two balances at this target."""
        return False

    @property
    def place(self) -> str:
        """Where it stands: `balance`, `input` or `output`."""
        # Effects on paths act on no balance, so the first kind tells.
        return self.acts_on[0] if self.acts_on[0] in ("input", "output") else "balance"

    def fits(self, site: Site) -> bool:
        """Whether the effect can stand at this site."""
        # A balance may not name its position, or have no ambient: effects that need it do not fit.
        return site.kind in self.acts_on and all(role in site.units for role in self.needs)

    @abstractmethod
    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        """Its parameters with default value, unit, bounds and meaning."""

    def states(self, site: Site) -> Mapping[str, str]:
        """Its own states: name → unit."""
        return {}

    @abstractmethod
    def contribution(self, scene: Scene) -> Contribution:
        """Its equation, of the parameters `scene.p` and the variables `scene[role]`.

        Estimation needs its slopes at every sample. `Abs`, `Max` and `Min` may kink. A dry
        friction's sign is `scene.direction`, which the integrator switches at standstill. A root,
        another power below one, or a quotient has no slope where its base is zero, and a NaN there
        spreads over the record: let it go evenly over a small width, as `Orifice` does.
        """

    @abstractmethod
    def starts(self, conditions: Conditions) -> Sequence[Mapping[str, float]]:
        """Values to try first: one mapping (of every parameter) for each shape worth trying. The
        catalogue's begin where the effect is a tenth of what drives its balance.
        """

    def grown(
        self, special: Mapping[str, float], conditions: Conditions
    ) -> Sequence[Mapping[str, float]]:
        """Values to try near an estimate of the effect that it `generalises`, in the conditions of
        that estimate.
        """
        return []

    def specialised(
        self, general: Mapping[str, float], conditions: Conditions
    ) -> Mapping[str, float]:
        """Values of the effect that it `generalises` at an estimate of its own; empty where they do
        not follow.
        """
        return {}

    def says_more(self, general: Mapping[str, float], std: Mapping[str, float]) -> bool:
        """Whether an estimate of its own differs from the effect that it `generalises` by more than
        twice its doubt.
        """
        return True

    def recorded(self, site: Site) -> bool:
        """Whether the record says when the effect acts; an event that nobody recorded may have been
        something else.
        """
        return True

    def shows(self, values: Mapping[str, float], conditions: Conditions) -> bool:
        """Whether the effect can be told, where it has these values and within the conditions'
        duration, from an unknown load.
        """
        return True

    def at_rest(self, start: Mapping[str, float]) -> dict[str, float]:
        """A start with its sizes shrunk to where screening takes derivatives."""
        return {
            # Shapes (a width, a speed over which friction fades) stay: they have no zero to go to.
            name: value * self.rest if name in self.sizes else value
            for name, value in start.items()
        }

    @abstractmethod
    def examples(self) -> Sequence[Example]:
        """Cases for the conformance test: models of `example_models` in which it has a place and
        shows.
        """


class SignalEffect(Effect):
    """An effect that is tied to a signal of the model; its target is `balance(signal)`.

    Class attributes
    ----------------
    takes_columns : bool
        Whether it is tried with columns of the record that the model does not use.
    curve : bool
        Whether it is a curve to be learned: tried where nothing with a name is real, and begun
        where what its balance lacks lies.
    """

    takes_columns: ClassVar[bool] = False
    curve: ClassVar[bool] = False

    def is_tied(self, target: str) -> bool:
        return True


class JoiningEffect(Effect):
    """An effect between two balances of one kind; its target is `balance(other)`.

    Class attributes
    ----------------
    reaches : bool
        Whether it takes from the first balance and gives to the other one, never back. It may then
        stand at `balance` alone too: what it takes is lost.
    """

    reaches: ClassVar[bool] = False

    def is_tied(self, target: str) -> bool:
        return self.joins(target)

    def joins(self, target: str) -> bool:
        return not self.reaches or target.endswith(")")


@lru_cache(maxsize=1024)
def quotient(numerator: str, denominator: str, power: float = 1.0) -> str:
    """Unit `numerator / denominator**power` in short symbols; temperatures count as differences
    (K).

    >>> quotient("W", "°C", 4)
    'W/K**4'
    """
    below = parse_unit(_DIFFERENCE.get(denominator, denominator))
    return _short(parse_unit(_DIFFERENCE.get(numerator, numerator)) / below**power)


@lru_cache(maxsize=1024)
def product(first: str, second: str) -> str:
    """Unit `first * second` in short symbols.

    >>> product("W", "s")
    'W*s'
    """
    return _short(
        parse_unit(_DIFFERENCE.get(first, first)) * parse_unit(_DIFFERENCE.get(second, second))
    )


def _short(unit: Unit) -> str:
    """Short symbols, force and voltage before lengths and times: N*m*s/rad."""
    symbols = list(unit.symbols.items())
    # By the table below, then by name: one unit is always spelled one way.
    symbols.sort(
        key=lambda item: (_ORDER.index(item[0]) if item[0] in _ORDER else len(_ORDER), item[0])
    )
    above = [_raised(name, exponent) for name, exponent in symbols if exponent > 0]
    below = [_raised(name, -exponent) for name, exponent in symbols if exponent < 0]
    # 1/s, where nothing stands above.
    return "/".join(["*".join(above) or "1", *below]) if symbols else ""


def _raised(name: str, exponent: float) -> str:
    return name if exponent == 1 else f"{name}**{exponent:g}"


# As a textbook writes them: forces, voltages and powers above, times and angles last.
_ORDER = (
    "kN",
    "N",
    "mN",
    "V",
    "W",
    "kW",
    "J",
    "A",
    "ohm",
    "kg",
    "K",
    "m",
    "cm",
    "mm",
    "l",
    "s",
    "min",
    "h",
    "rad",
)
# A quotient by a temperature is one by a difference, in kelvin whatever the scale.
_DIFFERENCE = {"°C": "K", "degC": "K", "C": "K"}
