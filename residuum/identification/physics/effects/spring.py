"""Springs, and restoring forces with a memory."""

from collections.abc import Mapping

from residuum.identification.physics.compile import symbolic as sp
from residuum.identification.physics.effects.base import (
    Conditions,
    Contribution,
    Effect,
    Parameter,
    Scene,
    Site,
    product,
    quotient,
)
from residuum.identification.physics.effects.example_models import (
    Example,
    axis_example,
    drive_example,
)


class LinearSpring(Effect):
    """Return springs, elastic hoses and cables: −k·q − τ_0.

    `k` [balance unit / position unit] ≥ 0; `tau_0` [balance unit], the preload at q = 0.
    """

    id = "linear-spring"
    title = "Linear spring"
    equation = "−k·q − τ_0"
    reference = "Hooke 1678"
    acts_on = ("torque", "force")
    needs = ("position",)
    sizes = ("k", "tau_0")

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        return (
            Parameter("k", 0.0, site.per("position"), lower=0.0, meaning="stiffness"),
            Parameter("tau_0", 0.0, site.unit, meaning="preload at q = 0"),
        )

    def contribution(self, scene: Scene) -> Contribution:
        return Contribution(term=-scene.p["k"] * scene["position"] - scene.p["tau_0"])

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        # A tenth of the driving force over the whole travel.
        return [{"k": 0.1 * conditions.magnitude / conditions.span("position"), "tau_0": 0.0}]

    def examples(self) -> list[Example]:
        return [axis_example(), drive_example()]


class CubicSpring(Effect):
    """Membranes, Duffing oscillators: −k₃·d³ − k₂·d² with the deflection d = q − q_0.

    `k_3` [balance unit / position unit³], negative for a softening spring; `k_2` [balance unit /
    position unit²], its asymmetry; `q_0` [position unit] fixed, where it is at rest.
    """

    id = "cubic-spring"
    title = "Cubic spring"
    equation = "−k₃·(q − q_0)³ − k₂·(q − q_0)²"
    reference = "G. Duffing, Erzwungene Schwingungen bei veränderlicher Eigenfrequenz, 1918"
    acts_on = ("torque", "force")
    needs = ("position",)
    sizes = ("k_3", "k_2")

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        return (
            Parameter("k_3", 0.0, site.per("position", 3), meaning="cubic stiffness"),
            Parameter("k_2", 0.0, site.per("position", 2), meaning="asymmetry"),
            Parameter(
                "q_0", 0.0, site.units["position"], fixed=True, meaning="where it is at rest"
            ),
        )

    def contribution(self, scene: Scene) -> Contribution:
        p = scene.p
        deflection = scene["position"] - scene.p["q_0"]
        return Contribution(term=-p["k_3"] * deflection**3 - p["k_2"] * deflection**2)

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        position = conditions.variables["position"]
        # A tenth of the driving force at the ends of the travel, from its middle.
        size = 0.1 * conditions.magnitude / (0.5 * conditions.span("position")) ** 3
        # Deflections count from where the spring is at rest: zero, or the middle of the travel.
        middle = 0.5 * float(position.min() + position.max())
        return [{"k_3": size, "k_2": 0.0, "q_0": 0.0}, {"k_3": size, "k_2": 0.0, "q_0": middle}]

    def examples(self) -> list[Example]:
        return [axis_example(), drive_example()]


class Hysteresis(Effect):
    """Dahl's presliding friction: −f_c·z with x_0·z' = v − |v|·z; after a reversal the friction
    returns over the distance x_0.

    `f_c` [balance unit] ≥ 0; `x_0` [position unit] > 0. With x_0 → 0 it is Coulomb friction.
    """

    id = "hysteresis"
    title = "Presliding hysteresis"
    equation = "−f_c·z, x_0·z' = v − |v|·z"
    reference = "P. R. Dahl, The Aerospace Corporation TOR-158, 1968"
    acts_on = ("torque", "force")
    needs = ("velocity",)
    sizes = ("f_c",)

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        return (
            Parameter("f_c", 0.0, site.unit, lower=0.0, meaning="friction once built up"),
            Parameter(
                "x_0",
                0.01,
                product(site.units["velocity"], "s"),
                lower=1e-9,
                meaning="distance over which it builds up",
            ),
        )

    def states(self, site: Site) -> Mapping[str, str]:
        return {"z": ""}

    def contribution(self, scene: Scene) -> Contribution:
        v = scene["velocity"]
        z = scene.x["z"]
        return Contribution(
            term=-scene.p["f_c"] * z,
            rates={"z": (v - sp.Abs(v) * z) / scene.p["x_0"]},
            initial={"z": sp.S.Zero},
        )

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        # How far the machine goes in a sample at its fastest: what builds up within less shows as
        # Coulomb friction.
        travelled = conditions.largest("velocity") * conditions.sample_time
        return [
            {"f_c": 0.1 * conditions.magnitude, "x_0": steps * travelled}
            for steps in (2.0, 10.0, 50.0)
        ]

    def examples(self) -> list[Example]:
        return [axis_example(), drive_example()]


class BoucWen(Effect):
    """−z, z' = A·v − β·|v|·z − γ·v·|z| (exponent one): joints, mounts, steel, piezos.

    `A` [balance unit / position unit] ≥ 0; `beta` ≥ 0 and `gamma`, either sign [1 / position unit].
    With γ = 0 it is Dahl's presliding friction of size A/β.
    """

    id = "bouc-wen"
    title = "Bouc–Wen hysteresis"
    equation = "−z, z' = A·v − β·|v|·z − γ·v·|z|"
    reference = "Y. K. Wen, J. Eng. Mech. Div. 102 (1976) 249"
    acts_on = ("torque", "force")
    needs = ("velocity",)
    sizes = ("A",)
    generalises = "hysteresis"

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        length = product(site.units["velocity"], "s")
        return (
            Parameter(
                "A",
                0.0,
                quotient(site.unit, length),
                lower=0.0,
                meaning="stiffness after a reversal",
            ),
            Parameter("beta", 1.0, quotient("1", length), lower=0.0, meaning="how fast it is lost"),
            Parameter(
                "gamma",
                0.0,
                quotient("1", length),
                meaning="how fast it softens (or, negative, hardens)",
            ),
        )

    def states(self, site: Site) -> Mapping[str, str]:
        return {"z": site.unit}

    def contribution(self, scene: Scene) -> Contribution:
        p = scene.p
        v = scene["velocity"]
        z = scene.x["z"]
        rate = p["A"] * v - p["beta"] * sp.Abs(v) * z - p["gamma"] * v * sp.Abs(z)
        return Contribution(term=-z, rates={"z": rate}, initial={"z": sp.S.Zero})

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        # As of the presliding friction: distances of some samples at the fastest, d = 1/β; then A/β
        # is the friction.
        travelled = conditions.largest("velocity") * conditions.sample_time
        size = 0.2 * conditions.magnitude
        return [
            {"A": size / d, "beta": 1.0 / d, "gamma": 0.0}
            for d in (5.0 * travelled, 20.0 * travelled, 80.0 * travelled)
        ]

    def grown(self, special: Mapping[str, float], conditions: Conditions) -> list[dict[str, float]]:
        """The presliding friction that it contains."""
        return [{"A": special["f_c"] / special["x_0"], "beta": 1.0 / special["x_0"], "gamma": 0.0}]

    def specialised(self, general: Mapping[str, float], conditions: Conditions) -> dict[str, float]:
        """The presliding friction with its stiffness and its loss."""
        return (
            {"f_c": general["A"] / general["beta"], "x_0": 1.0 / general["beta"]}
            if general["beta"] > 0.0
            else {}
        )

    def says_more(self, general: Mapping[str, float], std: Mapping[str, float]) -> bool:
        """Not without a γ of its own."""
        return abs(general["gamma"]) > 2.0 * std["gamma"]

    def examples(self) -> list[Example]:
        return [axis_example(), drive_example()]
