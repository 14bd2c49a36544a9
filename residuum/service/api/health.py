"""Whether the service lives, can take windows, and judges its machines."""

from __future__ import annotations

from importlib.metadata import version

from fastapi import APIRouter, Request, Response

from residuum.service.api.responses import Json
from residuum.service.machines.machine_state import counted, troubled
from residuum.service.services import Running, caller_of

router = APIRouter(tags=["health"])


@router.get("/health/live")
async def live() -> Response:
    """The process answers."""
    # Nothing is asked of the database: a service whose database is away is to wait, not to be
    # restarted.
    return Json({"status": "live", "version": version("residuum")})


@router.get("/health/ready")
def ready(running: Running, request: Request) -> Response:
    """Windows can be stored; 503 or 507 with the reason when not. With machines that are not judged
    it is 200, `degraded`.

    `machines` says of each of these why, and what can be done, `storage` what is wrong although
    windows are stored, `alarms` of which machines a state that suppresses alarms cannot be told,
    `receivers` which of them refused a notification or take none. Who has no key where keys are
    needed is told only how many machines are in which state.
    """
    # A write, not a question: a disk that is full or read-only is told by a write alone. At most
    # one a second, whoever asks.
    running.store.check()
    states = running.pipeline.status()["machines"]
    sees = caller_of(request).may_see
    visible = {name: state for name, state in states.items() if sees(name)}
    untold = {name: why for name, why in running.store.untold_states.now().items() if sees(name)}
    named = troubled(visible)
    storing, receivers = running.store.troubles(), running.receiver_troubles()
    # Still 200 where a machine is not judged: nothing is gained by a restart.
    answer = {
        "status": "degraded" if named or storing or untold or receivers else "ready",
        "version": version("residuum"),
        "states": counted(visible),
    }
    # The gate lets anybody ask here.
    # Names of machines, and what they lack, are for holders of a key.
    stranger = running.keys.needed and not hasattr(request.state, "caller")
    if stranger:
        return Json(answer)
    told = {"machines": named, "storage": storing, "alarms": untold, "receivers": receivers}
    return Json({**answer, **{subject: dict(whys) for subject, whys in told.items()}})


@router.get("/metrics", response_class=Response)
def metrics(running: Running) -> Response:
    """Prometheus metrics, text format; with API keys set they ask for one, of the role monitor or
    above.
    """
    return Response(running.metrics.render(), media_type="text/plain; version=0.0.4; charset=utf-8")
