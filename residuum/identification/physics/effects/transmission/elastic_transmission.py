"""Part of the inertia hangs on a spring."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from residuum.identification.physics.compile import symbolic as sp
from residuum.identification.physics.effects.base import Conditions, Parameter, Site, product
from residuum.identification.physics.effects.transmission.two_bodies import TwoBodies


class ElasticTransmission(TwoBodies):
    """A share r of the inertia J is driven through a stiffness with damping. With twist φ and its own velocity w, φ' = v − w
    and r·J·w' = k·φ + d·(v − w). The drive side keeps (1 − r)·J and feels −k·φ − d·(v − w).

    `k` [balance unit / position unit] > 0, `d` [balance unit / velocity unit] ≥ 0, `share` r [1] in 0.01 … 0.99. The
    resonance is at
    ω² = k/(r(1−r)J); above half the sampling rate nothing of it can be seen.
    """

    id = "elastic-transmission"
    title = "Elastic transmission"
    equation = "−k·φ − d·(v − w), φ' = v − w, r·J·w' = k·φ + d·(v − w)"
    reference = "D. Schröder, Elektrische Antriebe – Regelung von Antriebssystemen, ch. 19"
    follows = ("error",)

    def parameters(self, site: Site) -> tuple[Parameter, ...]:
        return (
            Parameter("k", 1.0, product(site.per("velocity"), "1/s"), lower=1e-12, meaning="stiffness"),
            Parameter("d", 0.0, site.per("velocity"), lower=0.0, meaning="damping"),
            Parameter("share", 0.5, "", lower=0.01, upper=0.99, meaning="share of the inertia beyond the spring"),
        )

    def transmitted(self, p: Mapping[str, sp.Expr], twist: sp.Expr, slip: sp.Expr) -> sp.Expr:
        return p["k"] * twist + p["d"] * slip

    def starts(self, conditions: Conditions) -> list[dict[str, float]]:
        found = []
        for frequency, share, damping in _shapes(conditions):
            omega = 2.0 * np.pi * frequency / conditions.sample_time
            k = omega**2 * share * (1.0 - share) * conditions.storage
            found.append({"k": k, "d": damping * k / omega, "share": share})
        return found


def _shapes(conditions: Conditions) -> list[tuple[float, float, float]]:
    """Resonances to try: (frequency times sample time, share of the inertia, damping); the error rings where there is one."""
    known = [(0.02, 0.5, 0.1), (0.04, 0.5, 0.1), (0.08, 0.5, 0.1), (0.2, 0.3, 0.1)]
    if conditions.missing is None:
        return known
    power = np.abs(np.fft.rfft(np.diff(conditions.missing) * np.hanning(conditions.missing.size - 1))) ** 2
    power = np.convolve(power, np.full(5, 0.2), mode="same")
    frequency = np.linspace(0.0, 0.5, power.size)
    ringing = float(frequency[np.argmax(np.where((frequency > 0.002) & (frequency < 0.25), power, 0.0))])
    if ringing == 0.0:  # nothing rings: a machine that stands still, or too short a record
        return known
    return known + [(ringing, share, damping) for share in (0.3, 0.7) for damping in (0.03, 0.2)]
