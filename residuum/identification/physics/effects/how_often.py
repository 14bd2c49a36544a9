"""How often public machines really lacked an effect that their textbook model does not have.

Counted on recordings of 25 drives and arms, 12 heaters and ovens, 3 tanks and 2 coils, each with
its makers' or experimenters' word on what is missing. An effect with several descriptions (dry
friction: Coulomb, directional, Stribeck, Dahl) counts with each of them. A machine may lack
several.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from types import MappingProxyType

# Drives and arms (25): 14 rubbed dryly, 6 had drag, a lag or a delay, 2 a viscous friction that
# their model left out.
_DRIVES: Mapping[str, int] = MappingProxyType(
    dict.fromkeys(
        ("coulomb-friction", "directional-friction", "stribeck-friction", "hysteresis"), 14
    )
    | dict.fromkeys(
        (
            "quadratic-drag",
            "input-lag",
            "input-delay",
            "output-lag",
            "input-dead-zone",
            "input-power",
        ),
        6,
    )
    | dict.fromkeys(("viscous-friction", "directional-viscous"), 2)
    | dict.fromkeys(
        ("load-friction", "elastic-transmission", "cubic-spring", "constant-load", "input-offset"),
        1,
    )
    | dict.fromkeys(
        ("tooth-ripple", "cogging", "position-load", "brush-drop", "input-saturation"), 1
    )
)
# Heaters and ovens (12): in 7 a second body stored heat, in 5 a sensor or an actuator lagged.
_HEATERS: Mapping[str, int] = MappingProxyType(
    {"second-heat-store": 7, "output-lag": 5, "input-lag": 5, "coupling": 2}
    | dict.fromkeys(
        ("ambient-loss", "convection", "radiation", "constant-heat", "input-saturation"), 1
    )
)
_TANKS: Mapping[str, int] = MappingProxyType(
    dict.fromkeys(("forgotten-input", "pump-nonlinearity", "overflow"), 1)
)
_COILS: Mapping[str, int] = MappingProxyType({"inductance": 2})
COUNTED: Mapping[str, tuple[int, Mapping[str, int]]] = MappingProxyType(
    {
        "torque": (25, _DRIVES),
        "force": (25, _DRIVES),
        "heat": (12, _HEATERS),
        "volume": (3, _TANKS),
        "voltage": (2, _COILS),
    }
)
"""By kind of balance, how many machines there were and how many lacked which effect."""


def share_lacking(effect: str, kinds: Iterable[str]) -> float | None:
    """Largest share, by these kinds of balances, of the machines that lacked the effect; None where
    none was counted.

    >>> share_lacking("coulomb-friction", ["torque", "signal"])
    0.56
    >>> share_lacking("output-drift", ["heat"])
    0.0
    >>> share_lacking("coulomb-friction", ["signal"])
    """
    counted = [COUNTED[kind] for kind in kinds if kind in COUNTED]
    return max((lacking.get(effect, 0) / machines for machines, lacking in counted), default=None)
