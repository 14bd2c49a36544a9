"""Transmissions: elasticity, play and stops."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping

import numpy as np

from residuum.identification.physics.compile import symbolic as sp
from residuum.identification.physics.effects.base import (
    Array,
    Conditions,
    Contribution,
    Effect,
    Parameter,
    Scene,
    Site,
    product,
)
from residuum.identification.physics.effects.example_models import (
    Example,
    axis_example,
    drive_example,
)


class TwoBodies(Effect):
    """A share r of the inertia J has a velocity w of its own and is driven through what the twist φ
    transmits. φ' = v − w and r·J·w' = transmitted. The drive side keeps (1 − r)·J and feels
    −transmitted.

    A record, or a window of one, may begin while the contact is twisted or the far body still
    swings: where is estimated.
    """

    acts_on = ("torque", "force")
    needs = ("velocity",)

    def states(self, site: Site) -> Mapping[str, str]:
        return {
            "twist": product(site.units["velocity"], "s"),
            "far_velocity": site.units["velocity"],
        }

    @abstractmethod
    def transmitted(self, p: Mapping[str, sp.Expr], twist: sp.Expr, slip: sp.Expr) -> sp.Expr:
        """What the contact transmits at this twist and velocity difference."""

    def contribution(self, scene: Scene) -> Contribution:
        p = scene.p
        v = scene["velocity"]
        twist = scene.x["twist"]
        w = scene.x["far_velocity"]
        transmitted = self.transmitted(p, twist, v - w)
        return Contribution(
            term=-transmitted,
            rates={"twist": v - w, "far_velocity": transmitted / (p["share"] * scene["storage"])},
            initial={"twist": sp.S.Zero, "far_velocity": v},
            deviating=("twist", "far_velocity"),
            storage_factor=1 - p["share"],
        )

    def shows(self, values: Mapping[str, float], conditions: Conditions) -> bool:
        """Whether the bodies swing against each other once at least, or come to rest as fast. A far
        body that begins anywhere on a softer spring, or creeps back, is a load and its slope.
        """
        # the storage is what stays on this side of the spring
        # Two bodies swing against each other with their reduced inertia r·(1 − r)·J; the storage is
        # (1 − r)·J already.
        reduced = values["share"] * conditions.storage
        frequency = np.sqrt(values["k"] / reduced)
        # Damping ratio: above 1 the slower of the two real modes decides.
        ratio = max(1.0, values["d"] / (2.0 * np.sqrt(values["k"] * reduced)))
        return bool(
            frequency / (ratio + np.sqrt(ratio**2 - 1.0)) * conditions.duration > 2.0 * np.pi
        )

    def examples(self) -> list[Example]:
        return [axis_example(), drive_example()]


class ElasticTransmission(TwoBodies):
    """A share r of the inertia J is driven through a stiffness with damping. With twist φ and its
    own velocity w, φ' = v − w and r·J·w' = k·φ + d·(v − w). The drive side keeps (1 − r)·J and
    feels −k·φ − d·(v − w).

    `k` [balance unit / position unit] > 0, `d` [balance unit / velocity unit] ≥ 0, `share` r [1] in
    0.01 … 0.99. The resonance is at ω² = k/(r(1−r)J); above half the sampling rate nothing of it
    can be seen.
    """

    id = "elastic-transmission"
    title = "Elastic transmission"
    equation = "−k·φ − d·(v − w), φ' = v − w, r·J·w' = k·φ + d·(v − w)"
    reference = "D. Schröder, Elektrische Antriebe – Regelung von Antriebssystemen, ch. 19"
    follows = ("error",)

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        return (
            Parameter(
                "k", 1.0, product(site.per("velocity"), "1/s"), lower=1e-12, meaning="stiffness"
            ),
            Parameter("d", 0.0, site.per("velocity"), lower=0.0, meaning="damping"),
            Parameter(
                "share",
                0.5,
                "",
                lower=0.01,
                upper=0.99,
                meaning="share of the inertia beyond the spring",
            ),
        )

    def transmitted(self, p: Mapping[str, sp.Expr], twist: sp.Expr, slip: sp.Expr) -> sp.Expr:
        return p["k"] * twist + p["d"] * slip

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        first_values = []
        for frequency, share, damping in _shapes(conditions):
            omega = 2.0 * np.pi * frequency / conditions.sample_time
            k = omega**2 * share * (1.0 - share) * conditions.storage
            first_values.append({"k": k, "d": damping * k / omega, "share": share})
        return first_values


def _shapes(conditions: Conditions) -> list[tuple[float, float, float]]:
    """Resonances to try: (frequency times sample time, share of the inertia, damping); the error
    rings where there is one.
    """
    # Where nothing is known: resonances from a fiftieth to a fifth of the sampling rate.
    known = [(0.02, 0.5, 0.1), (0.04, 0.5, 0.1), (0.08, 0.5, 0.1), (0.2, 0.3, 0.1)]
    if conditions.missing is None:
        return known
    power = (
        np.abs(np.fft.rfft(np.diff(conditions.missing) * np.hanning(conditions.missing.size - 1)))
        ** 2
    )
    # A mean of five lines: a single line of noise is no resonance.
    power = np.convolve(power, np.full(5, 0.2), mode="same")
    frequency = np.linspace(0.0, 0.5, power.size)
    ringing = float(
        frequency[np.argmax(np.where((frequency > 0.002) & (frequency < 0.25), power, 0.0))]
    )
    if ringing == 0.0:  # nothing rings: a machine that stands still, or too short a record
        return known
    return known + [(ringing, share, damping) for share in (0.3, 0.7) for damping in (0.03, 0.2)]


_CROSSINGS = (4.0, 12.0, 36.0)
"""Samples in which the drive side alone, pushed as it is on average, crosses the play."""
_SOFT = (10.0, 30.0)
"""Samples in which the machine at its fastest crosses a play whose contact gives way by half of it,
pushed on average.
"""


class Backlash(TwoBodies):
    """A share r of the inertia is driven through a contact with play. Nothing is transmitted while
    |φ| < gap/2. Beyond it acts a stiff, damped contact, k·(φ ∓ gap/2) + d·(v − w).

    `gap` [position unit] ≥ 0, `k`, `d`, `share` as in the elastic transmission. Only motion that
    reverses, or torque that does, shows it.
    """

    id = "backlash"
    title = "Backlash"
    equation = "−contact(φ), φ' = v − w, r·J·w' = contact(φ)"
    reference = "M. Nordin, P.-O. Gutman, Automatica 38 (2002) 1633"
    generalises = "elastic-transmission"

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        return (
            Parameter("gap", 0.0, product(site.units["velocity"], "s"), lower=0.0, meaning="play"),
            Parameter(
                "k",
                1.0,
                product(site.per("velocity"), "1/s"),
                lower=1e-12,
                meaning="contact stiffness",
            ),
            Parameter("d", 0.0, site.per("velocity"), lower=0.0, meaning="contact damping"),
            Parameter(
                "share",
                0.5,
                "",
                lower=0.01,
                upper=0.99,
                meaning="share of the inertia beyond the play",
            ),
        )

    def transmitted(self, p: Mapping[str, sp.Expr], twist: sp.Expr, slip: sp.Expr) -> sp.Expr:
        half = p["gap"] / 2
        damping = p["d"] * slip
        return sp.Piecewise(
            (p["k"] * (twist - half) + damping, twist > half),
            (p["k"] * (twist + half) + damping, twist < -half),
            (0, True),
        )

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        first_values = []
        travelled = conditions.largest("velocity") * conditions.sample_time
        # ½·a·Ts²: how far the drive side alone gets in one sample, pushed as on average.
        crossed = 0.5 * conditions.magnitude / conditions.storage * conditions.sample_time**2
        # The contact's resonance at a twentieth of the sampling rate.
        omega = 0.4 * np.pi / conditions.sample_time / 4.0
        plays = [(2.0 * travelled, 0.5), (10.0 * travelled, 0.5), (50.0 * travelled, 0.3)]
        plays += [(samples**2 * crossed / 0.5, 0.5) for samples in _CROSSINGS]
        for gap, share in plays:
            k = omega**2 * share * (1.0 - share) * conditions.storage
            first_values.append({"gap": gap, "k": k, "d": 0.3 * k / omega, "share": share})
        for samples in _SOFT if travelled > 0.0 else ():
            gap = samples * travelled
            k = 2.0 * conditions.magnitude / gap
            first_values.append(
                {
                    "gap": gap,
                    "k": k,
                    "d": 0.5 * float(np.sqrt(k * conditions.storage)),
                    "share": 0.5,
                }
            )
        return first_values

    def specialised(self, general: Mapping[str, float], conditions: Conditions) -> dict[str, float]:
        """The contact without play."""
        return {name: general[name] for name in ("k", "d", "share")}

    def says_more(self, general: Mapping[str, float], std: Mapping[str, float]) -> bool:
        """Not without play."""
        return general["gap"] > 2.0 * std["gap"]

    def grown(self, special: Mapping[str, float], conditions: Conditions) -> list[dict[str, float]]:
        """A spring that is soft because part of its travel is play."""
        # The whole twist, both ways: what part of it is play is tried.
        travel = 2.0 * float(np.max(np.abs(conditions.variables["twist"])))
        first_values = []
        for share in (0.3, 0.8):
            stiffer = {
                "k": special["k"] / (1.0 - share),
                "d": special["d"],
                "share": special["share"],
            }
            first_values.append({"gap": share * travel, **stiffer})
        return first_values


_DEPTHS = np.array([0.001, 0.005, 0.03])
"""Shares of the travel that may lie beyond a stop."""


def _bend(position: Array, force: Array) -> float:
    """Where, in the upper half of the travel, a force that falls evenly from there on explains most
    of the force.

    A machine that is at this end for more than half of the time has no upper half: then the end
    itself.
    """
    middle = float(np.median(position))
    end = float(np.max(position))
    if middle == end:
        return end
    q = np.linspace(middle, end, 60, endpoint=False)
    beyond = [np.maximum(position - knee, 0.0) for knee in q]
    # a travel of 1e-160 m squares to 0
    explained = [min(float(force @ b), 0.0) ** 2 / max(float(b @ b), 1e-300) for b in beyond]
    return float(q[int(np.argmax(explained))])


class EndStop(Effect):
    """Pushes back beyond either end, as a spring with a damper that never pulls. It adds −max(k·(q
    − q_max) + d·v, 0) above q_max, max(k·(q_min − q) − d·v, 0) below q_min.

    `k` [balance unit / position unit] ≥ 0, `d` [balance unit / velocity unit] ≥ 0; `q_max`, `q_min`
    [position unit].
    """

    id = "end-stop"
    title = "End stop"
    equation = (
        "−max(k·(q − q_max) + d·v, 0) for q > q_max, max(k·(q_min − q) − d·v, 0) for q < q_min"
    )
    reference = "W. J. Stronge, Impact Mechanics, Cambridge 2000 (Kelvin–Voigt contact)"
    acts_on = ("torque", "force")
    needs = ("position", "velocity")
    sizes = ("k", "d")
    natural_bounds = ("d",)
    follows = ("lack",)
    generalises = "end-stop"
    rest = 0.001

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        return (
            Parameter("k", 0.0, site.per("position"), lower=0.0, meaning="stiffness of the stop"),
            Parameter("d", 0.0, site.per("velocity"), lower=0.0, meaning="damping of the stop"),
            Parameter("q_max", 1.0, site.units["position"], meaning="upper end"),
            Parameter("q_min", -1.0, site.units["position"], meaning="lower end", below="q_max"),
        )

    def contribution(self, scene: Scene) -> Contribution:
        p = scene.p
        q = scene["position"]
        damped = scene.p["d"] * scene["velocity"]
        above = sp.Piecewise(
            (sp.Max(p["k"] * (q - p["q_max"]) + damped, 0), q > p["q_max"]), (0, True)
        )
        below = sp.Piecewise(
            (sp.Max(p["k"] * (p["q_min"] - q) - damped, 0), q < p["q_min"]), (0, True)
        )
        return Contribution(term=below - above)

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        """One end at a time; how far the motion goes beyond it nobody knows, unless what is missing
        shows it.
        """
        q = conditions.variables["position"]
        span = conditions.span("position")
        low = float(np.min(q))
        high = float(np.max(q))
        # Each upper end with a lower one far outside, and the other way round.
        ends = [(high - depth, low - span) for depth in _DEPTHS * span] + [
            (high + span, low + depth) for depth in _DEPTHS * span
        ]
        if conditions.missing is not None and np.any(conditions.missing):
            above = _bend(q, conditions.missing)
            below = _bend(-q, -conditions.missing)
            ends += [(above, low - span), (high + span, -below), (above, -below)]
        first_values = []
        for q_max, q_min in ends:
            if not q_min < q_max:  # both bends at the middle of the travel: a spring
                continue
            # The stop holds the driving force at what the motion goes beyond it.
            k = conditions.magnitude / max(high - q_max, q_min - low, 1e-6 * span)
            first_values.append(
                {
                    "k": k,
                    # Critical damping: an impact without rebound.
                    "d": 2.0 * float(np.sqrt(k * conditions.storage)),
                    "q_max": q_max,
                    "q_min": q_min,
                }
            )
        return first_values

    def grown(self, special: Mapping[str, float], conditions: Conditions) -> list[dict[str, float]]:
        """The stops moved by parts of what the machine travels in a sample: each moment of contact
        is a small summit.
        """
        # Nearly the fastest travel of a sample: a single jump in the record does not count.
        motion = float(np.quantile(np.abs(np.diff(conditions.variables["position"])), 0.9))
        moves = [part * motion for part in (-0.3, -0.05, 0.05, 0.3)]
        moved = []
        for move in moves:
            ends = {name: special[name] + move for name in ("q_max", "q_min")}
            moved.append(dict(special) | ends)
        return moved

    def shows(self, values: Mapping[str, float], conditions: Conditions) -> bool:
        """Whether the machine leaves a stop within the record: one that it always touches is a
        spring, a load and a damping.
        """
        q = conditions.variables["position"]
        return bool(np.any((q <= values["q_max"]) & (q >= values["q_min"])))

    def examples(self) -> list[Example]:
        return [axis_example(), drive_example()]
