"""The live side: sources on the buses, the machines' pipeline, and the faults of the demo's
machines.
"""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Path, Request, Response
from pydantic import BaseModel, Field

from residuum.identification.discrepancy.compile_ahead import is_compiled
from residuum.service.api.answers import PROBLEMS
from residuum.service.api.parameters import NAME
from residuum.service.api.responses import Json, StrictRoute
from residuum.service.security.access import Caller
from residuum.service.services import Running, Services, caller_of

router = APIRouter(tags=["live"], route_class=StrictRoute, responses=PROBLEMS)

Machine = Annotated[str, Path(description="Name of the demo's machine.", pattern=NAME)]


class FaultSwitch(BaseModel, extra="forbid"):
    """A fault to switch."""

    fault: str = Field(
        description="Fault of the machine, or `none` to switch all off.",
        min_length=1,
        max_length=64,
    )
    size: float | None = Field(
        None, ge=0, le=1e6, description="In the fault's unit; default: its own; 0 switches it off."
    )


@router.get("/status")
def get_status(running: Running, request: Request) -> Response:
    """State of every machine's pipeline (training, running) and of every source; to a key of some
    sites, of theirs.

    `compiled`: whether all is compiled that explanations need; until then the first one waits for
    it.
    """
    return Json({**_status(running, caller_of(request)), "compiled": is_compiled()})


@router.get("/sources")
def list_sources(running: Running, request: Request) -> Response:
    """Sources with their rates and every loss counter; to a key of some sites, those of its
    machines.
    """
    sources = _status(running, caller_of(request))["sources"]
    return Json(
        {"items": [{"name": name, **state} for name, state in sources.items()], "next_cursor": None}
    )


def _status(running: Services, caller: Caller) -> dict[str, Any]:
    """What the pipeline tells, of the machines that the caller may see."""
    status = running.pipeline.status()
    return {
        "machines": {
            name: state for name, state in status["machines"].items() if caller.may_see(name)
        },
        "sources": {
            name: state
            for name, state in status["sources"].items()
            # A source without a machine is nobody's site: keys of some sites do not see it.
            if caller.may_see(str(state.get("machine", "")))
        },
    }


@router.get("/demo/machines/{machine}/fault")
def list_faults(running: Running, machine: Machine) -> Response:
    """Faults of a demo machine with default size, unit and meaning, and which are on."""
    return Json(running.pipeline.faults(machine))


@router.post("/demo/machines/{machine}/fault")
async def switch_fault(running: Running, machine: Machine, switch: FaultSwitch) -> Response:
    """Switch a fault of a demo machine, over its own bus."""
    # By the machine's own bus, as a fault of a real one comes: nothing is told to the diagnosers
    # beside it.
    await running.pipeline.switch_fault(machine, switch.fault, switch.size)
    return Json(running.pipeline.faults(machine))
