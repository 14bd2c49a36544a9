"""Analyses as the work of jobs: records and models in, the contract's object out, by the functions
that a notebook calls, too.

Each is told where to say how far it is, and is called in a worker process, which ends when the job
is cancelled.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from residuum.identification.record import Record
from residuum.library import control
from residuum.library.model import Model
from residuum.library.plant import identified
from residuum.library.questions.compare import Compare
from residuum.library.questions.control_design import DesignController
from residuum.library.questions.estimate import Estimate
from residuum.library.questions.identify import Identify
from residuum.library.questions.missing_effect import Explain, Improve
from residuum.library.questions.residual import DesignResidual, RunResidual, residual_for
from residuum.library.questions.simulate import Simulate
from residuum.library.residual import Residual
from residuum.library.residual import judged as run_of
from residuum.library.virtual_machine import simulated
from residuum.robust_control.controller_export import LANGUAGES
from residuum.robust_control.weights.performance_weight import Infeasible
from residuum.service.views.model_view import model_of
from residuum.service.views.signal_view import read_identified
from residuum.service.work.jobs import Progress
from residuum.service.work.worker_pool import RecordParts, keep_large_arrays, parts_of

# Running a virtual machine as the work of a job.


def simulate(progress: Progress, machine: str, asked: Simulate) -> Mapping[str, Any]:
    """`record`: the parts of the machine's record."""
    progress(0.0, "running the virtual machine")
    record, _ = simulated(machine, asked)
    return {"record": parts_of(record)}


MODEL_FILE = "model.yaml"
"""What results and messages call a stored model's file."""


@dataclass(frozen=True)
class Asked:
    """A model (its text, or the built-in one of this name), the records it is held against, and
    model name → channel.
    """

    model: str
    text: bytes | None
    records: Sequence[RecordParts]
    mapping: Mapping[str, str]

    def opened(self, progress: Progress, work: str) -> tuple[Model, list[Record]]:
        """Model and records as the library takes them, as the work begins; BadModel for a text that
        is none.
        """
        progress(0.0, work)
        # a process of its own that computes for seconds: see `keep_large_arrays`
        keep_large_arrays()
        name = self.model if self.text is None else MODEL_FILE
        return Model(model_of(name, self.text), name), _records(self.records)


def compare(progress: Progress, asked: Asked, question: Compare) -> Mapping[str, Any]:
    """`result`: the `compare` object."""
    model, records = asked.opened(progress, "compare")
    return {"result": model.compare(records, map=asked.mapping, **question.model_dump()).to_dict()}


def explain(progress: Progress, asked: Asked, question: Explain) -> Mapping[str, Any]:
    """`result`: the `explain` object."""
    model, records = asked.opened(progress, "explain")
    return {
        "result": (
            model.explain(
                records, map=asked.mapping, progress=progress, **question.model_dump()
            ).to_dict()
        )
    }


def improve(progress: Progress, asked: Asked, question: Improve) -> Mapping[str, Any]:
    """`result`: the `improve` object; `file`: the larger model's text."""
    model, records = asked.opened(progress, "improve")
    improved = model.improve(records, map=asked.mapping, progress=progress, **question.model_dump())
    return {"result": improved.to_dict(), "file": improved.model.text.encode()}


def estimate(progress: Progress, asked: Asked, question: Estimate) -> Mapping[str, Any]:
    """`result`: the `estimate` object; `file`: the model's text, where its values have not settled
    only with `anyway`.
    """
    model, records = asked.opened(progress, "estimate")
    fitted = model.estimate(records, map=asked.mapping, **question.model_dump())
    # Values that a search left on its way are no model: from true values of a pendulum in its loop
    # one walked to numbers 170 times off. One that ends at a bound is an answer and is written.
    written = question.anyway or not fitted.unsettled
    return {"result": fitted.to_dict(), "file": None if not written else fitted.model.text.encode()}


def identify(
    progress: Progress, records: Sequence[RecordParts], asked: Identify
) -> Mapping[str, Any]:
    """`result`: the `identify` object; `file`: the identified model's."""
    progress(0.0, "identify")
    plant = identified(_records(records), asked, progress)
    return {"result": plant.to_dict(), "file": plant.text().encode()}


def residuals(
    progress: Progress,
    model: bytes,
    healthy: Sequence[RecordParts],
    records: Sequence[RecordParts],
    asked: DesignResidual,
    judged: RunResidual,
) -> Mapping[str, Any]:
    """`design`: the `residual design` object; `runs`: the `residual run` object of each record.
    `judged` is asked of these.
    """
    steps = 1 + len(records)
    progress(0.0, "residual")
    known = _records(healthy)
    design = Residual(residual_for(read_identified(model), known, asked), tuple(known))
    runs = []
    for number, record in enumerate(_records(records), start=1):
        progress(number / steps, "residual")
        runs.append(run_of(design.design, record, judged).to_dict())
    return {
        "design": design.to_dict() | {"identified": "model.json", "file": "design.json"},
        "runs": runs,
    }


def design_controller(
    progress: Progress,
    names: Sequence[str],
    models: Sequence[bytes],
    joined: bytes | None,
    asked: DesignController,
    export: str | None = None,
) -> Mapping[str, Any]:
    """`result`: the `control design` object, infeasible or with the controller, and its source text
    in the language `export`.
    """
    progress(0.0, "control")
    middle = None if joined is None else read_identified(joined)
    try:
        controller = control.designed(
            names, [read_identified(text) for text in models], middle, asked
        )
    # An answer and no failure of the job: the reason says which constraint asks for too much.
    except Infeasible as no:
        described = {"aim": asked.aim, "structure": asked.structure, "models": list(names)}
        return {"result": described | {"feasible": False, "reason": str(no)}}
    answer = controller.to_dict() | {"file": "controller.json"}
    if export is not None:
        answer["exported"] = LANGUAGES[export](controller.difference_equation())
    # through JSON: an answer's own types do not travel between processes
    return {"result": json.loads(json.dumps(answer))}


def _records(records: Sequence[RecordParts]) -> list[Record]:
    return [Record(*parts) for parts in records]
