"""Loads: constant, over the travel, with every tooth."""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from residuum.identification.physics.compile import symbolic as sp
from residuum.identification.physics.effects.base import (
    RESTS,
    Array,
    Conditions,
    Contribution,
    Effect,
    Parameter,
    Scene,
    Site,
    quotient,
)
from residuum.identification.physics.effects.example_models import (
    Example,
    axis_example,
    drive_example,
)


class ConstantLoad(Effect):
    """Weight, preload, inclination: −τ_0.

    `tau_0` [balance unit], either sign.
    """

    id = "constant-load"
    title = "Constant load"
    equation = "−τ_0"
    reference = "Newton 1687"
    acts_on = ("torque", "force")
    needs = ("velocity",)
    sizes = ("tau_0",)

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        return (Parameter("tau_0", 0.0, site.unit, meaning="load against positive motion"),)

    def contribution(self, scene: Scene) -> Contribution:
        return Contribution(term=-scene.p["tau_0"])

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        return [{"tau_0": 0.1 * conditions.magnitude}]

    def examples(self) -> list[Example]:
        return [axis_example(), drive_example()]


class PositionLoad(Effect):
    """Unbalanced arms, slopes, cranks: −(a·sin κq + b·cos κq), a wave of at most a few periods over
    the travel.

    `a`, `b` [balance unit]; `kappa` [rad / position unit] > 0, the wave number. Over less than half
    a period it cannot be told from a spring with preload.
    """

    id = "position-load"
    title = "Position-dependent load"
    equation = "−(a·sin κq + b·cos κq)"
    reference = "J. Norton, Design of Machinery, McGraw-Hill, ch. 11"
    acts_on = ("torque", "force")
    needs = ("position",)
    sizes = ("a", "b")
    generalises = "linear-spring"

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        return (
            Parameter("a", 0.0, site.unit, meaning="sine amplitude"),
            Parameter("b", 0.0, site.unit, meaning="cosine amplitude"),
            Parameter(
                "kappa",
                1.0,
                quotient("rad", site.units["position"]),
                lower=1e-9,
                meaning="wave number",
            ),
        )

    def contribution(self, scene: Scene) -> Contribution:
        p = scene.p
        angle = scene.p["kappa"] * scene["position"]
        return Contribution(term=-(p["a"] * sp.sin(angle) + p["b"] * sp.cos(angle)))

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        size = 0.1 * conditions.magnitude
        travel = conditions.span("position")
        # Half a period, one and two over the travel.
        # the last: once a turn, an arm's own weight
        waves = [*(np.pi * periods / travel for periods in (1.0, 2.0, 4.0)), 1.0]
        return [{"a": size, "b": size, "kappa": float(kappa)} for kappa in waves]

    def grown(self, special: Mapping[str, float], conditions: Conditions) -> list[dict[str, float]]:
        """Waves that have the spring's stiffness at q = 0: of about half a period, and of one a
        radian (an arm's own weight).
        """
        waves = (1.0, 2.0 / conditions.span("position"))
        return [
            {"a": special["k"] / kappa, "b": special["tau_0"], "kappa": kappa} for kappa in waves
        ]

    def examples(self) -> list[Example]:
        return [axis_example(), drive_example()]


_FEWEST, _MANY = 5.0, 12.0
"""Periods over the travel from which on a wave may be a ripple, and up to which it may be a load
that depends on the position.
"""
_MOVES, _SLOWLY = 0.01, 0.25
"""Part of the largest speed from which on a machine moves, and of that time in which it is slow."""
_REFINED_ON = 10_000
"""Samples on which a wave number is refined."""


def strongest_wave_numbers(
    position: Array, signal: Array, count: int = 3, fewest_periods: float = _FEWEST
) -> list[float]:
    """Wave numbers [rad / position unit] at which a signal varies most along the position.

    The signal is averaged in cells of position, a slow trend over the travel is taken out, and the
    highest separate peaks of the cells' spectrum are returned, strongest first; waves with under
    `fewest_periods` over the travel are left out.
    """
    travel = float(np.ptp(position))
    if travel <= RESTS:
        return []
    # Some samples a cell, and cells enough for a wave of many periods.
    cells = int(min(4096, max(64, position.size // 4)))
    cell = np.minimum(((position - position.min()) / travel * cells).astype(int), cells - 1)
    weight = np.bincount(cell, minlength=cells)
    mean = np.bincount(cell, weights=signal - signal.mean(), minlength=cells) / np.maximum(
        weight, 1
    )
    # Padded four times: peaks stand between the lines of the plain transform.
    spectrum = np.abs(np.fft.rfft(mean * np.hanning(cells), 4 * cells))
    first = int(4 * fewest_periods)
    wave_numbers: list[float] = []
    for index in np.argsort(spectrum[first:])[::-1] + first:
        wave_number = 2.0 * np.pi * index / (4.0 * travel)
        # Within two lines it is the slope of a peak that is counted already (Hann's main lobe).
        if all(abs(wave_number - peak) > 4.0 * np.pi / travel for peak in wave_numbers):
            wave_numbers.append(float(wave_number))
        if len(wave_numbers) == count:
            break
    every = slice(None, None, max(1, position.size // _REFINED_ON))
    return [
        _refined(position[every], signal[every], wave_number, np.pi / (2.0 * travel))
        for wave_number in wave_numbers
    ]


def _refined(position: Array, signal: Array, wave_number: float, width: float) -> float:
    """The wave number within ± `width` at which the samples themselves, not their cells, vary
    most.
    """
    tried = wave_number + width * np.linspace(-1.0, 1.0, 9)
    # Each wave number is the one before, turned on by a constant step: one product instead of an
    # exponential.
    turned = np.exp(-1j * tried[0] * position) * signal
    turn = np.exp(-1j * (tried[1] - tried[0]) * position)
    sizes = [abs(turned.sum())]
    for _ in tried[1:]:
        turned *= turn
        sizes.append(abs(turned.sum()))
    return float(tried[np.argmax(sizes)])


class ToothRipple(Effect):
    """Gear meshing, cogging, ball passages: −(a·sin nq + b·cos nq) with many periods over the
    travel.

    `a`, `b` [balance unit]; `n` [rad / position unit] > 0, ripples a radian of angle (2π over the
    pitch of a length). The first values of n are the strongest periods over position of what is
    missing, where that is known.
    """

    id = "tooth-ripple"
    title = "Tooth ripple"
    equation = "−(a·sin nq + b·cos nq)"
    reference = "R. G. Munro, Transmission error, in: Dudley's Gear Handbook"
    acts_on = ("torque", "force")
    needs = ("position",)
    sizes: ClassVar[tuple[str, ...]] = ("a", "b")
    follows = ("innovations", "lack")
    generalises = "position-load"

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        return (
            Parameter("a", 0.0, site.unit, meaning="sine amplitude"),
            Parameter("b", 0.0, site.unit, meaning="cosine amplitude"),
            Parameter(
                "n",
                1.0,
                quotient("rad", site.units["position"]),
                lower=1e-9,
                meaning="ripples per radian or 2π per pitch",
            ),
        )

    def contribution(self, scene: Scene) -> Contribution:
        p = scene.p
        angle = scene.p["n"] * scene["position"]
        return Contribution(term=-(p["a"] * sp.sin(angle) + p["b"] * sp.cos(angle)))

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        size = 0.1 * conditions.magnitude
        travel = conditions.span("position")
        if conditions.missing is None:
            orders = [2.0 * np.pi * periods / travel for periods in (10.0, 40.0)]
            orders += [order for order in (1.0, 2.0, 6.0, 12.0) if order * travel > 8.0 * np.pi]
        else:
            orders = strongest_wave_numbers(conditions.variables["position"], conditions.missing)
            if len(orders) > 1 and abs(orders[0] - orders[1]) < 24.0 * np.pi / travel:
                # a response that lags differently both ways splits the peak
                orders.append(0.5 * (orders[0] + orders[1]))
        return [{"a": size, "b": size, "n": float(order)} for order in orders]

    def shows(self, values: Mapping[str, float], conditions: Conditions) -> bool:
        """Whether samples tell the wave: where the machine moves slowly, no more than half a period
        passes between two. Of a shorter one each sample sees another phase, as of noise.
        """
        speed = np.abs(conditions.variables.get("velocity", np.zeros(1)))
        moving = speed[speed > _MOVES * speed.max()]
        slow = float(np.quantile(moving, _SLOWLY)) if len(moving) else 0.0
        return values["n"] * slow * conditions.sample_time < np.pi

    def grown(self, special: Mapping[str, float], conditions: Conditions) -> list[dict[str, float]]:
        """The same wave, where it is short."""
        short = special["kappa"] * conditions.span("position") > 2.0 * np.pi * _FEWEST
        return [{"a": special["a"], "b": special["b"], "n": special["kappa"]}] if short else []

    def specialised(self, general: Mapping[str, float], conditions: Conditions) -> dict[str, float]:
        """The same wave, where it is long."""
        long = general["n"] * conditions.span("position") < 2.0 * np.pi * _MANY
        return {"a": general["a"], "b": general["b"], "kappa": general["n"]} if long else {}

    def examples(self) -> list[Example]:
        return [axis_example(), drive_example()]


class Cogging(ToothRipple):
    """−(a·sin nq + b·cos nq + a₂·sin 2nq + b₂·cos 2nq): magnets over iron, whose ripple is no sine.

    Amplitudes [balance unit]; `n` [rad / position unit] > 0. A tooth ripple has the first wave
    alone.
    """

    id = "cogging"
    title = "Cogging"
    equation = "−Σ (aₖ·sin knq + bₖ·cos knq), k = 1, 2"
    reference = "D. C. Hanselman, Brushless Permanent Magnet Motor Design, ch. 10"
    sizes = ("a", "b", "a2", "b2")
    generalises = "tooth-ripple"

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        first, second, wave = super().parameters(site)
        more = [
            Parameter(name, 0.0, site.unit, meaning="amplitude of the harmonic")
            for name in ("a2", "b2")
        ]
        return (first, second, *more, wave)

    def contribution(self, scene: Scene) -> Contribution:
        p = scene.p
        angle = scene.p["n"] * scene["position"]
        harmonic = p["a2"] * sp.sin(2 * angle) + p["b2"] * sp.cos(2 * angle)
        return Contribution(term=-(p["a"] * sp.sin(angle) + p["b"] * sp.cos(angle) + harmonic))

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        return [
            start | {"a2": 0.3 * start["a"], "b2": 0.3 * start["b"]}
            for start in super().starts(conditions)
        ]

    def grown(self, special: Mapping[str, float], conditions: Conditions) -> list[dict[str, float]]:
        """The same wave with a small harmonic."""
        size = 0.1 * float(np.hypot(special["a"], special["b"]))
        return [dict(special) | {"a2": size, "b2": size}]

    def specialised(self, general: Mapping[str, float], conditions: Conditions) -> dict[str, float]:
        """The first wave."""
        return {name: general[name] for name in ("a", "b", "n")}

    def says_more(self, general: Mapping[str, float], std: Mapping[str, float]) -> bool:
        """Not without a harmonic."""
        return any(abs(general[name]) > 2.0 * std[name] for name in ("a2", "b2"))
