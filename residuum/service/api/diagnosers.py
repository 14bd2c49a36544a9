"""The catalogue of diagnosers."""

from __future__ import annotations

from fastapi import APIRouter, Response

from residuum.diagnosis.diagnosers import DIAGNOSERS
from residuum.service.api.responses import Json
from residuum.service.services import Running

router = APIRouter(tags=["score"])


@router.get("/diagnosers")
def list_diagnosers(running: Running) -> Response:
    """All diagnosers with the channels they read, in which units, and the classes they tell
    apart.
    """
    return Json(
        {
            "items": [running.judges.untrained(name).describe() for name in DIAGNOSERS],
            "next_cursor": None,
        }
    )
