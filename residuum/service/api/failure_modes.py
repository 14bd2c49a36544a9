"""Failure modes, effects and criticality of the gate actuator, and what watches each."""

from __future__ import annotations

from typing import Any

from fastapi import APIRouter, Response

from residuum.diagnosis.diagnosers import DIAGNOSERS
from residuum.diagnosis.gate.fmeca import (
    MACHINE,
    PROBABILITIES,
    SEVERITIES,
    FailureMode,
    coverage,
    criticality_matrix,
    load_fmeca,
    risk,
)
from residuum.service.api.responses import Json

router = APIRouter(tags=["score"])


@router.get("/failure-modes")
def list_failure_modes() -> Response:
    """Every mode of the machine with its risk and the diagnosers that report it; the cells of the
    criticality matrix.
    """
    modes = load_fmeca()
    # From what the diagnosers declare: a class that is renamed leaves a gap here, not a wrong
    # claim.
    covered = coverage(modes, {name: diagnoser.classes for name, diagnoser in DIAGNOSERS.items()})
    cells = [
        {
            "probability": p,
            "severity": s,
            "risk": risk(p, s).value,
            "modes": [mode.id for mode in in_cell],
        }
        for (p, s), in_cell in criticality_matrix(modes).items()
    ]
    items = [_mode(mode, covered.get(mode.id, [])) for mode in modes]
    return Json(
        {
            "machine": MACHINE,
            "items": items,
            "next_cursor": None,
            "cells": cells,
            "probabilities": PROBABILITIES,
            "severities": SEVERITIES,
        }
    )


def _mode(mode: FailureMode, covered: list[tuple[str, str]]) -> dict[str, Any]:
    by = [
        {"diagnoser": diagnoser, "fault_class": fault_class} for diagnoser, fault_class in covered
    ]
    return {**vars(mode), "covered_by": by, "risk": mode.risk.value}
