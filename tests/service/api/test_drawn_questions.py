"""Questions drawn over all their fields, good and bad, are read and refused alike by every door.

What is asked of a question that was read is one function's, whose answers `test_three_doors.py` compares. `RESIDUUM_DRAWN`
is how many are drawn of each question.
"""

import asyncio
import os
import warnings
from types import NoneType
from typing import Annotated, get_args, get_origin, get_type_hints

import httpx
import numpy as np
import pytest
import typer
from fastapi import APIRouter, FastAPI, Query, Response
from typer.main import get_command

import residuum as rs
from residuum.identification.errors import SAID_IN
from residuum.library.answers.plain import to_plain
from residuum.library.questions import choices, kinds, part_of, written
from residuum.library.questions.compare import Compare
from residuum.library.questions.control_design import DesignController
from residuum.library.questions.estimate import Estimate
from residuum.library.questions.identify import Identify
from residuum.library.questions.missing_effect import Explain, Improve
from residuum.library.questions.residual import DesignResidual, RunResidual
from residuum.library.questions.simulate import Simulate
from residuum.library.questions.uncertainty import Uncertainty
from residuum.service import problems
from residuum.service.api import analyses, simulations
from residuum.service.api.responses import Json, StrictRoute
from residuum.service.api.uncertainties import StoredUncertainty
from residuum.service.commands import as_option
from residuum.service.commands.asked import asks
from residuum.service.remedies_over_http import as_key
from tests.service.api.doors import AXIS, OWN, options

DRAWN = int(os.environ.get("RESIDUUM_DRAWN", "34"))
QUESTIONS = (
    Identify,
    Compare,
    Estimate,
    Explain,
    Improve,
    DesignResidual,
    RunResidual,
    Uncertainty,
    DesignController,
    Simulate,
)
WEIGHT = {"epsilon": [0.1, 0.2], "zeta": [0.1, 0.2], "points": [60, 80], "lowest": [0.05, 0.2]}
EFFECTS = [
    "viscous-friction",
    ["viscous-friction", "linear-spring"],
    ["own-drag"],
    "no-effect",
    ["viscous-friction@axis"],
]
GOOD = WEIGHT | {
    "input": ["force", ["force", "position"], "none"],
    "output": ["velocity", "position", ["position", "velocity"], ["velocity"]],
    "order": [1, 2, 6],
    "delay": [0, 1, 3, "estimate"],
    "noise_variance": ["marginal", 1e-6, "1e-5", "residuals", -1.0],
    "noise_bound": [0.02, 5],
    "effects": EFFECTS,
    "add": [*EFFECTS, "backlash@nowhere", "a@b@c"],
    "free": ["M", ["M"], "Q"],
    "seconds": [600, 1e5],
    "catalogue": [OWN],
    "unknown_input": [["force"]],
    "weight_order": [0, 1, 2],
    "gamma": [0.05, 0.3],
    "overshoot": [0.02, 0.2],
    "settling_time": [50, 500.0],
    "slack": [0.2, 0.5],
    "low_gain": [40, 60],
    "high_gain": [-6, -20.5],
    "critical_frequency": [0.02, 0.1],
    "fix": [{"k_d": 0}, {"k_d": 0, "N_d": 1}, {"k_x": 1}],
    "within": [{"k_i": [0, 5000]}, {"k_i": [3, 1]}],
    "limits": [[-2.5, 2.5], [3, 2]],
    "steps": [10, 30],
}
"""Values of fields that no bounds and names draw; a few break a rule that no declaration says."""


SIMULATED = {
    "effects": [["coulomb-friction:large"], ["a:b=2,c=3", "d"], ["a:huge"], ["a:b=x"]],
    "faults": [["worn:2", "dry"], ["worn:much"]],
    "events": [["start"], ["stop:0.5"]],
    "settings": [{"rate": 250}, {"pwm": "true", "profile": "rich"}],
    "profile": ["rich", "duty-cycle"],
}
"""Of a virtual machine, whose effects are other ones; several are said in texts."""
OTHER_KINDS = {
    "fix": {"k_d": "none"},
    "within": {"k_i": ["low", 3]},
    "limits": [1.5, "soon"],
    "unknown_input": [""],
    "settings": {"pwm": "sometimes"},
}
"""Bad values of fields that take several; an empty text is one of the others."""


BODIES = {
    Identify: (analyses.Identification, "POST"),
    Compare: (analyses.Comparison, "POST"),
    Estimate: (analyses.Estimation, "POST"),
    Explain: (analyses.Explanation, "POST"),
    Improve: (analyses.Improvement, "POST"),
    DesignResidual: (analyses.Residuals, "POST"),
    RunResidual: (analyses.Residuals, "POST"),
    Uncertainty: (StoredUncertainty, "GET"),
    DesignController: (analyses.ControlDesign, "POST"),
    Simulate: (simulations.Simulation, "POST"),
}
OF_RECORDS = {"records": [1]}
OF_DESIGNS = {"model": "short", "healthy": [1], "records": [1]}
NEEDED = dict.fromkeys(QUESTIONS, OF_RECORDS) | {
    DesignResidual: OF_DESIGNS,
    RunResidual: OF_DESIGNS,
    DesignController: {"models": ["short"]},
    Simulate: {"machine": "oven"},
}


def drawn(rng, question):
    """A question: what it needs, and up to three fields more, about one in seven bad."""
    hints = get_type_hints(question, include_extras=True)
    needed = {Identify: AXIS, DesignController: {"structure": "pi"}}.get(question, {})
    asked = dict(needed) | ({"epsilon": 0.1, "zeta": 0.1} if "epsilon" in hints else {})
    for name in rng.choice(sorted(hints), int(rng.integers(0, 4)), replace=False).tolist():
        if name not in question.model_fields:
            continue
        make = bad if rng.random() < 0.15 else good
        asked[name] = make(rng, name, question.model_fields[name], hints[name])
    return asked


def good(rng, name, field, hint):
    if names := choices(field):
        return str(rng.choice(names))
    named = SIMULATED if written(field) or name in ("settings", "profile") else GOOD
    if name in named:
        return named[name][int(rng.integers(len(named[name])))]
    if bool in kinds_of(hint):
        return bool(rng.integers(2))
    low, high = bounds(field)
    value = float(np.clip(field.default if field.default is not None else 1.0, low, high))
    value = float(np.clip(value * rng.uniform(0.5, 2.0) + rng.integers(0, 2), low, high))
    return int(value) if int in kinds_of(hint) else value


def bad(rng, name, field, hint):
    """A name that is none, a number out of bounds, or another kind."""
    if names := choices(field):
        return f"{rng.choice(names)}x"
    kinds_taken, (low, high) = kinds_of(hint), bounds(field)
    if bool in kinds_taken:
        return True
    if not {int, float} & set(kinds_taken) or name == "noise_variance":
        return OTHER_KINDS.get(name, "")
    excluded = [getattr(rule, "gt", np.inf) for rule in field.metadata]
    outside = [bound for bound in (low - 1, high + 1, *excluded) if np.isfinite(bound)]
    others = ["soon", *(int(edge) if int in kinds_taken else edge for edge in outside)]
    others += [1.5] if int in kinds_taken else []
    return others[int(rng.integers(len(others)))]


def kinds_of(hint):
    while get_origin(hint) is not None and hasattr(hint, "__metadata__"):
        hint = get_args(hint)[0]
    return [kind for kind in kinds(hint) if kind is not NoneType]


def bounds(field):
    rules = {
        key: getattr(rule, key)
        for rule in field.metadata
        for key in ("ge", "gt", "le", "lt")
        if hasattr(rule, key)
    }
    return rules.get("ge", rules.get("gt", -np.inf)), rules.get("le", rules.get("lt", np.inf))


def values(asked):
    """The fields; a name that is written alone is a list of one."""
    fields = asked.model_dump()
    return fields | {
        name: list(np.ravel(fields[name])) for name in ("input", "output") if fields.get(name)
    }


def probe_of_command(question):
    app = typer.Typer(add_completion=False)

    @app.command()
    @asks()
    def probe(asked: question) -> None:
        read.append(asked)

    read = []
    command = get_command(app)

    def ask(words):
        read.clear()
        before = SAID_IN.set(as_option)
        try:
            command(args=list(map(str, words)), standalone_mode=False)
        except rs.BadInput as refused:
            return str(refused)
        finally:
            SAID_IN.reset(before)
        return values(read[0])

    return ask


def probe_of_service(question):
    """A route that gives back the question in the body, or query, of the service's own route."""
    body, method = BODIES[question]
    app = FastAPI()
    problems.install(app)
    router = APIRouter(route_class=StrictRoute)
    if question is Uncertainty:
        body = Annotated[body, Query()]

    def route(asked: body) -> Response:
        read.append(values(part_of(asked, question)))
        return Json({})

    route.__annotations__["asked"] = body
    read = []
    router.add_api_route("/probe", route, methods=[method])
    app.include_router(router)

    async def answered(**said):
        transport = httpx.ASGITransport(app)
        async with httpx.AsyncClient(transport=transport, base_url="http://here") as client:
            return await client.request(method, "/probe", **said)

    def ask(asked):
        read.clear()
        needed = NEEDED[question]
        said = {"params": asked} if method == "GET" else {"json": to_plain(needed | asked)}
        answer = asyncio.run(answered(**said))
        return read[0] if answer.is_success else answer.json()["detail"]

    return ask


@pytest.mark.parametrize("question", QUESTIONS, ids=lambda question: question.__name__)
def test_a_drawn_question_is_read_alike(question):
    by_command, by_service = probe_of_command(question), probe_of_service(question)
    differ, refused = [], 0
    for number in range(DRAWN):
        asked = drawn(np.random.default_rng([9, number]), question)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", FutureWarning)
            try:
                python = question.of(asked)
            except rs.BadInput as error:
                python = error
            if isinstance(python, rs.BadInput):
                refused += 1
                expected = [python.told(named) for named in (as_option, as_key)]
            else:
                expected = [values(python)] * 2
            told = [by_command(options(asked)), by_service(asked)]
        differ += [(asked, a, b) for a, b in zip(expected, told, strict=True) if a != b]
    assert not differ, "\n".join(map(str, [len(differ), *differ]))
    assert refused > 0
