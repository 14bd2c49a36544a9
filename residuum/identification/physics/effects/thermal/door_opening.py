"""A door that stands open for a while."""

import numpy as np

from residuum.identification.physics.compile import symbolic as sp
from residuum.identification.physics.effects.base import Array, Conditions, Contribution, Parameter, Scene, Site
from residuum.identification.physics.effects.thermal.heat_loss import HeatLoss


def lowest_stretch(signal: Array) -> tuple[int, int]:
    """Samples [begin, end) of the stretch where the signal stays furthest below its median (largest partial sum)."""
    below = np.median(signal) - signal
    below = below - 0.25 * np.std(below)
    total = np.concatenate([[0.0], np.cumsum(below)])
    before = np.minimum.accumulate(total)
    end = int(np.argmax(total - before))
    return int(np.argmin(total[: end + 1])), end


class DoorOpening(HeatLoss):
    """−G·(T − T_a) while open: by the input `door` where the model has one, else once, from t_open for t_length.

    `G` [balance unit / K] ≥ 0; `t_open`, `t_length` [s] since the record's start (edges of a twentieth of t_length); `T_a`
    as in the ambient loss.
    Without a door signal it describes a single record.
    """

    id = "door-opening"
    title = "Door opening"
    equation = "−G·(T − T_a)·open(t)"
    reference = "ASHRAE Handbook Refrigeration, ch. 24"
    sizes = ("G",)

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        times = (
            Parameter("t_open", 0.0, "s", lower=0.0, meaning="when it opens"),
            Parameter("t_length", 60.0, "s", lower=1e-3, meaning="how long it stays open"),
        )
        G = Parameter("G", 0.0, site.per("temperature"), lower=0.0, meaning="exchange while open")
        return (G, *(() if "door" in site.units else times), *self.surroundings(site))

    def recorded(self, site: Site) -> bool:
        """Where there is a door signal: else it is heat that was lost for a while, whoever took it."""
        return "door" in site.units

    def contribution(self, scene: Scene) -> Contribution:
        p = scene.p
        if "door" in scene.variables:
            opened = scene["door"]
        else:
            edge = p["t_length"] / 20
            begin, end = (scene.t - p["t_open"]) / edge, (scene.t - p["t_open"] - p["t_length"]) / edge
            opened = (sp.tanh(begin) - sp.tanh(end)) / 2
        return Contribution(term=-p["G"] * (scene["temperature"] - self.ambient(scene)) * opened)

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        base = {"G": 0.3 * conditions.magnitude / conditions.span("temperature"), **self.first_ambient(conditions)}
        if "door" in conditions.variables:
            return [base]
        if conditions.missing is not None:
            begin, end = lowest_stretch(conditions.missing)
            scale = conditions.duration / conditions.missing.size
            return [base | {"t_open": begin * scale, "t_length": max(end - begin, 1) * scale}]
        length = 0.1 * conditions.duration
        return [base | {"t_open": k * length, "t_length": length} for k in range(0, 10, 2)]
