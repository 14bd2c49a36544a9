"""The ten worked models of the how-to follow data that SciPy makes from the same balances, from other values than the file's."""

import math
import re
from pathlib import Path

import numpy as np
import pytest
import yaml
from scipy.integrate import solve_ivp

import residuum as rs

PAGE = Path(__file__).parents[2] / "docs" / "how-to" / "write-a-model.md"
FILES = [
    text
    for text in re.findall(r"```yaml\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    if text.startswith("name:")
]
FUNCTIONS = {"sqrt": math.sqrt, "abs": abs, "max": max, "min": min, "__builtins__": {}}
SIZES = {
    "torque": 2.0,
    "force": 100.0,
    "voltage": 6.0,
    "power": 5e3,
    "ambient": 20.0,
    "inflow": 2e-3,
    "duty": 50.0,
}
SIZES |= {"T_in": 15.0, "flow": 0.2}
"""About how large each input is."""
DURATIONS = {
    "belt drive": 0.4,
    "suspension": 4.0,
    "cart": 4.0,
    "heated tank": 4e3,
    "two tanks": 200.0,
    "heat exchanger": 600.0,
}
DURATIONS |= {"vessel": 600.0, "heater by its step response": 600.0, "dc motor": 1.0}
N = 400


def inputs(described, t):
    """Every input moves in steps and a sine; a temperature of the surroundings and a flow only a little."""
    found = {}
    for k, (name, size) in enumerate((name, SIZES[name]) for name in described["inputs"]):
        swing = 0.05 if name in ("ambient", "T_in", "flow") else 0.5
        step = (t > 0.6 * t[-1]) * (swing > 0.1)
        found[name] = size * (
            1 + swing * np.sin(2 * np.pi * (k + 2) * t / t[-1]) - 2 * swing * step
        )
    return found


def followed(described, values, record, t):
    """States at the instants t, by SciPy; between two samples the inputs move in straight lines."""
    states = list(described["states"])

    def names(at, x):
        now = {name: float(np.interp(at, t, u)) for name, u in record.items()}
        known = FUNCTIONS | values | now | dict(zip(states, map(float, x), strict=True))
        for balance in described["balances"].values():
            if str(balance["storage"]) == "0":
                missing = [0.0, 1.0]
                at_zero, at_one = (
                    total(balance, known | {balance["current"]: value}) for value in missing
                )
                known[balance["current"]] = at_zero / (at_zero - at_one)
        return known

    def total(balance, known):
        return sum(eval(term, dict(known)) for term in balance["terms"].values())

    def rates(at, x):
        known = names(at, x)
        found = {s: known[d["rate"]] for s, d in described["states"].items() if "rate" in d}
        for balance in described["balances"].values():
            if match := re.fullmatch(r"(.*) \* der\((\w+)\)", str(balance["storage"])):
                found[match[2]] = total(balance, known) / eval(match[1], dict(known))
        return [found[s] for s in states]

    start = [
        described.get("initial", {}).get(
            s, {"°C": 20.0, "m": 0.2}.get(described["states"][s]["unit"], 0.0)
        )
        for s in states
    ]
    start = [
        0.0 if "rate" in described["states"][s] else value
        for s, value in zip(states, start, strict=True)
    ]
    run = solve_ivp(rates, (0.0, t[-1]), start, t_eval=t, rtol=1e-8, atol=1e-10, max_step=t[1])
    known = [names(at, x) for at, x in zip(t, run.y.T, strict=True)]
    outputs = {
        o: np.array([eval(d["value"], dict(k)) for k in known])
        for o, d in described["outputs"].items()
    }
    return outputs, dict(zip(states, start, strict=True))


def test_there_are_ten():
    assert len(FILES) == 10


@pytest.mark.parametrize(
    "text", FILES, ids=lambda text: text.splitlines()[0].removeprefix("name: ")
)
def test_a_worked_model_follows_data(text):
    described = yaml.safe_load(text)
    model = rs.model(text)
    t = np.linspace(0.0, DURATIONS.get(described["name"], 4.0), N)
    values = {
        n: float(p["value"]) * (1.0 if p.get("fixed") else 1.1)
        for n, p in described["parameters"].items()
    }
    record = inputs(described, t)
    outputs, start = followed(described, values, record, t)
    units = {n: (d if isinstance(d, str) else d["unit"]) for n, d in described["inputs"].items()}
    units |= {n: d["unit"] for n, d in described["outputs"].items()}
    measured = rs.from_arrays(record | outputs, units=units, sample_time=t[1])
    free = {n: v for n, v in values.items() if not described["parameters"][n].get("fixed")}
    simulated = model.with_values(**free).simulate(measured, initial=start)
    for name, truth in outputs.items():
        away = np.sqrt(np.mean((simulated[name] - truth) ** 2)) / np.std(truth)
        assert np.std(truth) > 0 and away < 0.01, f"{name} is {100 * away:.2g} % away"
