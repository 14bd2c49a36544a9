"""Missing physics in real recordings: the Silverbox (an electronic Duffing oscillator) and a lamp that heats a plate (DaISy).

`python -m benchmarks real_records`; needs the recordings of ../shared/data. The Silverbox's linear model is explained and
improved on its training data, then simulated over the three test sets that the literature uses; of the plate, the verdict and
its evidence are shown, once with the catalogue and once for a lamp whose power is the square of its voltage.
"""

import time
from pathlib import Path

import numpy as np
from scipy.io import loadmat

from residuum.identification.discrepancy.explain import Explanation, explain
from residuum.identification.discrepancy.improve import improve
from residuum.identification.physics import PhysicalModel, estimate, load_model, match, read_model
from residuum.identification.record import Record
from residuum.identification.residual_analysis.compare import compare

DATA = Path(__file__).parents[1] / "../shared/data"
RATE = 610.35
TRAINING = slice(40650, 40650 + 65062)
TESTS = {
    "multisine": slice(105712, 127400),
    "arrow": slice(100, 40575),
    "arrow without extrapolation": slice(100, 32000),
}
PUBLISHED = {"multisine": 1.05, "arrow": 1.77, "arrow without extrapolation": 1.04}
SETTLING = 50

LAMP = """
name: lamp and plate
inputs:      {u: V}
states:      {T: {unit: °C}}
parameters:
  P: {value: 1.0, unit: UNIT, lower: 0}
  C: {value: 100, unit: J/K, fixed: true}
  h: {value: 0.5, unit: W/K, lower: 0}
  T_a: {value: 20, unit: °C}
balances:
  plate: {kind: heat, storage: C * der(T), terms: {lamp: LAW, loss: -h * (T - T_a)}, temperature: T, ambient: T_a}
outputs:     {temperature: {value: T, unit: °C}}
"""
LAWS = {
    "power linear in the voltage": ("P * u", "W/V"),
    "power as the square of the voltage": ("P * u**2", "W/V**2"),
}


def silverbox(part: slice) -> Record:
    data = loadmat(DATA / "silverbox/SNLS80mV.mat")
    channels = {"force": data["V1"].ravel()[part], "position": data["V2"].ravel()[part]}
    return Record(channels, {"force": "V", "position": "V"}, 1 / RATE, source="Silverbox")


def plate() -> Record:
    t, u, y = np.loadtxt(DATA / "daisy/heating_system.dat").T
    return Record(
        {"u": u, "temperature": y},
        {"u": "V", "temperature": "degC"},
        float(t[1] - t[0]),
        source="DaISy heating",
    )


def tested(model: PhysicalModel, part: slice) -> float:
    """RMS simulation error on a test set from its own initial state, the first samples not counted [V]."""
    matched, experiments = match(model, [silverbox(part)])
    residual = estimate(matched, experiments, free=()).residuals[0][SETTLING:, 0]
    return float(np.sqrt(np.mean(residual**2)))


def verdict(explanation: Explanation) -> str:
    named = ", ".join(
        f"{c.effect} (p = {c.probability:.2f})"
        for c in explanation.candidates[:3]
        if c.probability > 0.01
    )
    return f"{explanation.verdict}; {named or 'nothing named'}; unexplained share {explanation.unexplained_share:.2f}"


def main() -> None:
    if not DATA.exists():
        print("skipped: no real recordings here")
        return
    print("### Silverbox\n")
    began = time.perf_counter()
    found = explain(load_model("oscillator"), [silverbox(TRAINING)])
    print(
        f"explain on the training multisines: {verdict(found)} ({time.perf_counter() - began:.1f} s)\n"
    )
    spring = improve(load_model("oscillator"), [silverbox(TRAINING)], add=["cubic-spring"])
    print(
        "| test set | linear [mV] | with the cubic spring [mV] | published for this structure [mV] |\n|---|---|---|---|"
    )
    linear = estimate(*_matched(load_model("oscillator"))).model
    for name, part in TESTS.items():
        errors = [1e3 * tested(model, part) for model in (linear, spring.model)]
        print(f"| {name} | {errors[0]:.2f} | {errors[1]:.3f} | {PUBLISHED[name]} |")
    print("\n### Lamp and plate\n")
    for law, (text, unit) in LAWS.items():
        model = read_model(LAMP.replace("LAW", text).replace("UNIT", unit))
        compared = compare(model, [plate()])
        outputs = compared.outputs["temperature"]
        print(f"- {law}: fit {outputs.fit_percent:.1f} %; {verdict(explain(model, [plate()]))}")


def _matched(model: PhysicalModel):
    return match(model, [silverbox(slice(TRAINING.start, TRAINING.start + 12000))])
