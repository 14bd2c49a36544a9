"""Whether the service lives and can take windows."""

from __future__ import annotations

from importlib.metadata import version

from fastapi import APIRouter, Response

from residuum.service.api.json_response import Json
from residuum.service.services import Running

router = APIRouter(tags=["health"])


@router.get("/health/live")
async def live() -> Response:
    """The process answers."""
    return Json({"status": "live", "version": version("residuum")})


@router.get("/health/ready")
def ready(running: Running) -> Response:
    """Windows can be stored; 503 or 507 with the reason when not."""
    running.store.check()
    return Json({"status": "ready", "version": version("residuum")})


@router.get("/metrics", response_class=Response)
def metrics(running: Running) -> Response:
    """Prometheus metrics, text format; with API keys set they ask for one, of the role monitor or above."""
    return Response(running.metrics.render(), media_type="text/plain; version=0.0.4; charset=utf-8")
