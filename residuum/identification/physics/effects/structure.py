"""Effects that tie a balance to other signals: a forgotten input, a coupling of two balances, a
learned curve.
"""

from __future__ import annotations

import numpy as np

from residuum.identification.physics.compile import symbolic as sp
from residuum.identification.physics.effects.base import (
    Conditions,
    Contribution,
    JoiningEffect,
    Parameter,
    Scene,
    SignalEffect,
    Site,
    quotient,
)
from residuum.identification.physics.effects.example_models import (
    Example,
    axis_example,
    tank_example,
)


class ForgottenInput(SignalEffect):
    """g·s, s a signal of the record: a flow into the next tank, a load that somebody measured, the
    neighbour's heat.

    It stands at `balance(signal)`. `gain` g [balance unit / signal unit], −1 where the signal is
    the flow that leaves.
    """

    id = "forgotten-input"
    title = "Forgotten input"
    equation = "g·s"
    reference = "M. C. Kennedy, A. O'Hagan, J. R. Stat. Soc. B 63 (2001) 425"
    acts_on = ("torque", "force", "voltage", "heat", "volume", "signal")
    sizes = ("gain",)
    takes_columns = True

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        unit = quotient(site.unit, site.units[site.signals[0]]) if site.signals else ""
        return (Parameter("gain", 0.0, unit, meaning="of the signal in the balance"),)

    def contribution(self, scene: Scene) -> Contribution:
        return Contribution(term=scene.p["gain"] * scene[scene.site.signals[0]])

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        # The signal stands last among the variables. Both signs: a flow in, or one out.
        size = 0.1 * conditions.magnitude / conditions.largest(list(conditions.variables)[-1])
        return [{"gain": size}, {"gain": -size}]

    def examples(self) -> list[Example]:
        return [tank_example()]


ACROSS = {"heat": "temperature", "volume": "level", "torque": "velocity", "force": "velocity"}
"""Kind of balance → the quantity whose difference drives the exchange."""


class Coupling(JoiningEffect):
    """−k·(x − x′), taken from one balance and given to the other: heat exchange, flow between
    stores, friction between bodies.

    It stands at `balance(other)`, both of one kind. x is the balance's temperature, level or
    velocity, x′ the other's; `k` [balance unit / unit of x] ≥ 0.
    """

    id = "coupling"
    title = "Coupling of two balances"
    equation = "−k·(x − x′), and +k·(x − x′) in the other"
    reference = (
        "D. C. Karnopp, D. L. Margolis, R. C. Rosenberg, System Dynamics, Wiley, ch. 3 (one-port"
        " between two junctions)"
    )
    acts_on = tuple(ACROSS)
    sizes = ("k",)

    def fits(self, site: Site) -> bool:
        return super().fits(site) and ACROSS[site.kind] in site.units

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        return (
            Parameter(
                "k", 0.0, site.per(ACROSS[site.kind]), lower=0.0, meaning="exchange per difference"
            ),
        )

    def contribution(self, scene: Scene) -> Contribution:
        mine = ACROSS[scene.site.kind]
        partner = f"other:{ACROSS[scene.site.kind]}"
        exchange = scene.p["k"] * (scene[mine] - scene[partner])
        return Contribution(term=-exchange, elsewhere={scene.site.signals[0]: exchange})

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        # Of the variables the one that both balances have: temperature, level or velocity.
        role = next(
            role for role in conditions.variables if f"other:{role}" in conditions.variables
        )
        difference = conditions.variables[role] - conditions.variables[f"other:{role}"]
        return [{"k": 0.1 * conditions.magnitude / (float(abs(difference).max()) or 1.0)}]

    def examples(self) -> list[Example]:
        return [tank_example()]


# Eight straight pieces.
KNOTS_OF_A_CURVE = 9


class Learned(SignalEffect):
    """Σ vₖ·hatₖ(s): straight lines between the values vₖ [balance unit] at the knots aₖ [signal
    unit], level beyond the ends.

    It stands at `balance(signal)`. The knots are fixed, at even quantiles of the signal; the value
    at the knot in the middle is that of the balance's other terms (0), so that a constant is never
    learned twice.
    """

    id = "learned"
    title = "Learned curve"
    equation = "Σ vₖ·hatₖ(s)"
    reference = "C. de Boor, A Practical Guide to Splines, Springer 2001, ch. III"
    acts_on = ("torque", "force", "voltage", "heat", "volume", "signal")
    sizes = tuple(f"v{k}" for k in range(1, KNOTS_OF_A_CURVE + 1))
    curve = True

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        unit = site.units[site.signals[0]] if site.signals else ""
        knots = [
            Parameter(f"a{k}", float(k), unit, fixed=True, meaning="knot")
            for k in range(1, KNOTS_OF_A_CURVE + 1)
        ]
        return (
            *knots,
            *(Parameter(name, 0.0, site.unit, meaning="value at the knot") for name in self.sizes),
        )

    def contribution(self, scene: Scene) -> Contribution:
        s = scene[scene.site.signals[0]]
        knots = range(1, KNOTS_OF_A_CURVE + 1)
        a = [scene.p[f"a{k}"] for k in knots]
        v = [scene.p[f"v{k}"] for k in knots]
        # Straight lines between the knots, level beyond the ends.
        slopes = [(v[k + 1] - v[k]) / (a[k + 1] - a[k]) for k in range(KNOTS_OF_A_CURVE - 1)]
        lines = [(v[k] + slopes[k] * (s - a[k]), s < a[k + 1]) for k in range(KNOTS_OF_A_CURVE - 1)]
        return Contribution(term=sp.Piecewise((v[0], s < a[0]), *lines, (v[-1], True)))

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        """Knots at even quantiles of the signal, kept apart; values that any regression may
        change.
        """
        signal = conditions.variables[list(conditions.variables)[-1]]
        # Quantiles coincide where a signal rests: knots stay a fiftieth of the span apart.
        least = 0.02 * float(np.ptp(signal)) or 1.0
        # Half a per cent at each end is left beyond: outliers there would have a knot of their own.
        at = np.quantile(signal, np.linspace(0.005, 0.995, KNOTS_OF_A_CURVE))
        for k in range(1, KNOTS_OF_A_CURVE):
            at[k] = max(at[k], at[k - 1] + least)
        size = 0.1 * conditions.magnitude
        return [
            {f"a{k + 1}": float(at[k]) for k in range(KNOTS_OF_A_CURVE)}
            | dict.fromkeys(self.sizes, size)
        ]

    def examples(self) -> list[Example]:
        return [axis_example()]
