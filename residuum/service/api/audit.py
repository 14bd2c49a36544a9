"""The audit trail."""

from __future__ import annotations

from fastapi import APIRouter, Response

from residuum.service.api.answers import PROBLEMS, AuditAnswer, PageOf
from residuum.service.api.parameters import Cursor, Limit
from residuum.service.api.responses import page_answer
from residuum.service.services import Running

router = APIRouter(prefix="/audit", tags=["audit"], responses=PROBLEMS)


@router.get("", response_model=PageOf[AuditAnswer])
async def list_audit(running: Running, cursor: Cursor = None, limit: Limit = 100) -> Response:
    """What was done to alarms and models, and by whom, newest first; `residuum doctor` verifies the
    chain of digests.
    """
    return await page_answer(running, running.store.audit, cursor, limit)
