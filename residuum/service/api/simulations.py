"""Records of virtual machines, stored beside uploaded ones: something to try every analysis on,
with a truth that is known.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

from fastapi import APIRouter, Response
from pydantic import Field

from residuum.identification.record import Record
from residuum.library.questions import part_of
from residuum.library.questions.simulate import Simulate
from residuum.service.api.answers import PROBLEMS, JobAnswer
from residuum.service.api.responses import StrictRoute, accepted
from residuum.service.services import Running
from residuum.service.views.analyses import simulate

router = APIRouter(prefix="/records", tags=["records"], route_class=StrictRoute, responses=PROBLEMS)


class Simulation(Simulate):
    """Which virtual machine runs, for how long, and what is hidden in it."""

    machine: Annotated[str, Field(min_length=1, max_length=64)] = Field(
        description="Name of the virtual machine, such as gate-drive."
    )


@router.post("/simulations", status_code=202, response_model=JobAnswer)
def add_simulated_record(running: Running, asked: Simulation) -> Response:
    """Run a virtual machine and store its record; the result is the record as `GET
    /records/{record}` has it.
    """

    def keep(outcome: Mapping[str, Any]) -> Mapping[str, Any]:
        # Without its truth: what is hidden in it is to be found.
        number = running.store.add_record(f"simulated {asked.machine}", Record(*outcome["record"]))
        return running.store.record(number).to_json()

    work = (asked.machine, part_of(asked, Simulate))
    return accepted(running.jobs.submit("simulate", simulate, *work, then=keep))
