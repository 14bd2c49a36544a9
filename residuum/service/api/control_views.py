"""Robust controllers to look at: the front of what is possible, bounds, step responses, and code
for the target.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

from fastapi import APIRouter, Response
from pydantic import model_validator

from residuum.library.questions import OLD_SPELLINGS, part_of
from residuum.library.questions.control_design import DesignController
from residuum.service.api.analyses import ControlDesign, models_of
from residuum.service.api.answers import PROBLEMS, JobAnswer
from residuum.service.api.responses import StrictRoute, accepted
from residuum.service.services import Running
from residuum.service.views.control_view import view_control_design

router = APIRouter(tags=["analyses"], route_class=StrictRoute, responses=PROBLEMS)


class ControlView(ControlDesign):
    """The same question, to look at; source text in every language comes with it."""

    # Names of before the question was declared once for all doors; read for one more release, with
    # a word to the client.
    renamed: ClassVar[Mapping[str, str]] = {
        "low_gain_db": "low_gain",
        "smallest_high_gain_db": "high_gain",
        "lowest_critical_frequency": "critical_frequency",
    }

    @model_validator(mode="before")
    @classmethod
    def _limits_as_before(cls, given: Any) -> Any:
        """The limits were two fields."""
        if not (isinstance(given, dict) and given.keys() & {"lower", "upper"}):
            return given
        OLD_SPELLINGS.get()("lower, upper: will not be read much longer; say limits")
        fields = {name: value for name, value in given.items() if name not in ("lower", "upper")}
        return {"limits": [given.get("lower"), given.get("upper")]} | fields


@router.post("/control-designs/views", status_code=202, response_model=JobAnswer)
def view(running: Running, asked: ControlView) -> Response:
    """Controllers along the front of what is possible: bounds, open loop, step responses of drawn
    plants, code to download.
    """
    # Without `export`: the source in each language comes with every point.
    work = (*models_of(running, asked), part_of(asked, DesignController))
    return accepted(running.jobs.submit("control-view", view_control_design, *work))
