"""Records of virtual machines, stored beside uploaded ones: something to try every analysis on,
with a truth that is known.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Response
from pydantic import BaseModel, Field

from residuum.identification.record import Record
from residuum.library.questions import Either
from residuum.service.api.answers import PROBLEMS, JobAnswer
from residuum.service.api.jobs import accepted
from residuum.service.api.json_response import StrictRoute
from residuum.service.services import Running
from residuum.service.work.analyses import simulate

router = APIRouter(prefix="/records", tags=["records"], route_class=StrictRoute, responses=PROBLEMS)

Text = Annotated[str, Field(min_length=1, max_length=64)]
Size = Literal["small", "medium", "large"]
Parameters = Annotated[dict[Text, float], Field(max_length=20)]
Hidden = Annotated[
    Size | Parameters, Either("must be small, medium or large, or names of parameters with numbers")
]


class Simulation(BaseModel, extra="forbid"):
    """Which virtual machine runs, for how long, and what is hidden in it."""

    machine: Text = Field(description="Name of the virtual machine, such as gate-drive.")
    effects: dict[Text, Hidden] = Field(
        default={},
        max_length=20,
        description="Hidden physics: effect → its parameters, or small, medium, large.",
    )
    duration: float | None = Field(
        None, gt=0, le=120, description="Length [s]; null: the machine's own."
    )
    seed: int = Field(0, ge=0, le=2**32 - 1, description="Of noise, disturbances and start values.")


@router.post("/simulations", status_code=202, response_model=JobAnswer)
def add_simulated_record(running: Running, asked: Simulation) -> Response:
    """Run a virtual machine and store its record; the result is the record as `GET
    /records/{record}` has it.
    """

    def keep(outcome: Mapping[str, Any]) -> Mapping[str, Any]:
        number = running.store.add_record(f"simulated {asked.machine}", Record(*outcome["record"]))
        return running.store.record(number).to_json()

    work = (asked.machine, asked.effects, asked.duration, asked.seed)
    return accepted(running.jobs.submit("simulate", simulate, *work, then=keep))
