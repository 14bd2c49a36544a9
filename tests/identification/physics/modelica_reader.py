"""Reads back the flat Modelica that is exported, and integrates it; shares nothing with the export."""

import math
import re

import numpy as np
from scipy.integrate import solve_ivp

_TOKEN = re.compile(
    r"\s*(\d+\.?\d*(?:[eE][+-]?\d+)?|\.\d+(?:[eE][+-]?\d+)?|[A-Za-z_]\w*|<=|>=|==|<>|[-+*/^(),<>])"
)
_WORDS = {"and": " and ", "or": " or ", "not": " not "}
_KNOWN = {
    "abs": abs, "min": min, "max": max, "sqrt": math.sqrt, "exp": math.exp, "log": math.log, "sin": math.sin, "cos": math.cos,
    "tan": math.tan, "asin": math.asin, "acos": math.acos, "atan": math.atan, "atan2": math.atan2, "sinh": math.sinh,
    "cosh": math.cosh, "tanh": math.tanh, "floor": math.floor, "sign": lambda a: (a > 0) - (a < 0), "noEvent": lambda a: a,
}  # fmt: skip


def python_of(text):
    """A Modelica expression as a Python one."""
    tokens = _TOKEN.findall(text)
    assert "".join(tokens) == re.sub(r"\s", "", text), text
    position = 0

    def until(*ends):
        nonlocal position
        parts, depth = [], 0
        while position < len(tokens) and (depth or tokens[position] not in ends):
            token = tokens[position]
            position += 1
            if token == "if":
                parts.append(choice())
                continue
            depth += (token == "(") - (token == ")")
            if depth < 0:
                position -= 1
                break
            parts.append(_WORDS.get(token, {"^": "**", "<>": "!="}.get(token, token)))
        return "".join(parts)

    def choice():
        nonlocal position
        condition = until("then")
        position += 1
        yes = until("elseif", "else")
        word = tokens[position]
        position += 1
        no = choice() if word == "elseif" else until(")", ",")
        return f"(({yes}) if ({condition}) else ({no}))"

    return until()


class ModelicaModel:
    """What the text declares and says."""

    def __init__(self, text):
        names = r"^  {} (\w+)(?: = ([^ ]+))? \""
        self.p = {n: float(v) for n, v in re.findall(names.format("parameter Real"), text, re.M)}
        self.inputs = [n for n, _ in re.findall(names.format("input Real"), text, re.M)]
        first, then = text.split("initial equation")[1].split("\nequation\n")
        self.first = dict(re.findall(r"^  (\w+) = (.*);$", first, re.M))
        self.rates = dict(re.findall(r"^  der\((\w+)\) = (.*);$", then, re.M))
        self.others = dict(re.findall(r"^  (\w+) = (.*);$", then, re.M))
        self.first, self.rates, self.others = (
            {n: compile(python_of(e), n, "eval") for n, e in part.items()}
            for part in (self.first, self.rates, self.others)
        )
        self.outputs = [n for n in self.others if n.startswith("y_")]

    def _values(self, t, x, u):
        known = {
            **_KNOWN,
            **self.p,
            **dict(zip(self.inputs, u, strict=True)),
            **dict(zip(self.rates, x, strict=True)),
            "time": t,
        }
        for name in [n for n in self.others if n not in self.outputs]:
            known[name] = eval(self.others[name], {"__builtins__": {}}, known)
        return known

    def run(self, U, step):
        """Outputs at the samples, inputs held."""
        start = {**_KNOWN, **self.p, **dict(zip(self.inputs, U[0], strict=True)), "time": 0.0}
        x = [float(eval(self.first[n], {"__builtins__": {}}, start)) for n in self.rates]
        found = []

        def rates(t, x, u):
            known = self._values(t, x, u)
            return [float(eval(code, {"__builtins__": {}}, known)) for code in self.rates.values()]

        for k, u in enumerate(U):
            known = self._values(k * step, x, u)
            found.append(
                [float(eval(self.others[n], {"__builtins__": {}}, known)) for n in self.outputs]
            )
            if self.rates:
                span = (k * step, (k + 1) * step)
                x = solve_ivp(rates, span, x, method="DOP853", rtol=1e-9, atol=1e-12, args=(u,)).y[
                    :, -1
                ]
        return np.array(found)
