"""What accepting a model for a machine would change: its diagnoser's thresholds, and the error of the model that is healthy.

The work of a job; nothing is stored here.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from residuum.diagnosis.diagnosers import DIAGNOSERS
from residuum.diagnosis.diagnosers.base import Diagnoser
from residuum.diagnosis.diagnosers.model_based import ModelBased
from residuum.diagnosis.finding import Finding, Verdict
from residuum.diagnosis.thresholds.tails import HealthyBand
from residuum.identification.errors import BadInput
from residuum.identification.physics import estimate, match
from residuum.identification.record import Record
from residuum.service.machines.adding.model_texts import ModelText
from residuum.service.machines.judging.kept_diagnosers import content_of, diagnoser_of_content
from residuum.service.views.model_view import model_of
from residuum.service.work.jobs import Progress
from residuum.service.work.record_parts import RecordParts

FALSE_ALARM = 1e-3
"""Share of healthy windows whose model error may exceed its limit."""
_MODELLED = 8
"""Healthy records, the newest, that both models are simulated beside: a movement at 5 kHz costs seconds a model."""
_FEWEST_MODELLED = 5


def propose(
    progress: Progress,
    diagnoser: str,
    baseline: bytes | None,
    learned: Sequence[RecordParts],
    checked: Sequence[RecordParts],
    models: tuple[ModelText | None, ModelText],
    mapping: Mapping[str, str],
) -> Mapping[str, Any]:
    """Learn a diagnoser's limits anew from healthy records, and hold old and new against each other on healthy windows.

    Parameters
    ----------
    baseline : bytes or None
        The stored diagnoser that is at work; None when there is none.
    learned, checked : records
        Healthy data to learn from, and later healthy windows that were not learned from.
    models : pair
        The active model (None: there is none yet) and the one to be accepted.

    Returns
    -------
    mapping
        `thresholds`, by name `old`, `new`, `unit`; `alarms`, how many of the checked windows each diagnoser would call faulty;
        `model_error`, by output the limit that a healthy window's RMS simulation error passes once in a thousand windows
        (Student's limit of a log-normal RMS), of both models, or `reason` why the windows cannot be simulated; `baseline`, the
        new diagnoser's file.

    Raises
    ------
    BadInput
        Records that the diagnoser cannot learn from.
    """
    progress(0.05, f"learning the limits of {diagnoser} from {len(learned)} healthy records")
    kind = DIAGNOSERS[diagnoser]
    records, windows = ([Record(*parts) for parts in each] for each in (learned, checked))
    old = None if baseline is None else diagnoser_of_content(kind, baseline)
    new = _relearned(old or kind(), records, models[1])
    progress(0.6, f"judging {len(windows)} healthy windows with both")
    before = [] if old is None else [old.score(window) for window in windows]
    after = [new.score(window) for window in windows]
    progress(0.8, "simulating healthy windows with both models")
    return {
        "diagnoser": diagnoser,
        "learned_from": len(learned),
        "thresholds": _thresholds(before, after),
        "alarms": {"windows": len(windows), "old": _faulty(before) if old else None, "new": _faulty(after)},
        "model_error": _model_errors(models, (records + windows)[-_MODELLED:], mapping),
        "baseline": content_of(new),
    }


def _relearned(old: Diagnoser, records: Sequence[Record], accepted: ModelText) -> Diagnoser:
    """Learned anew, where the diagnoser watches by a model with the one that is to be accepted."""
    if isinstance(old, ModelBased):
        return old.relearned(records, model_of(*accepted))
    return old.relearned(records)


def _faulty(findings: Sequence[Finding]) -> int:
    return sum(finding.verdict is Verdict.FAULTY for finding in findings)


def _thresholds(before: Sequence[Finding], after: Sequence[Finding]) -> dict[str, Any]:
    """The middle of each threshold over the checked windows, old against new."""
    old, new = _middle(before), _middle(after)
    units = {name: unit for finding in (*before, *after) for name, unit in finding.units.items()}
    return {name: {"old": old.get(name), "new": new.get(name), "unit": units.get(name, "")} for name in {**old, **new}}


def _middle(findings: Sequence[Finding]) -> dict[str, float]:
    found: dict[str, list[float]] = {}
    for finding in findings:
        for name, value in finding.thresholds.items():
            found.setdefault(name, []).append(value)
    return {name: float(np.median(values)) for name, values in found.items()}


def _model_errors(
    models: tuple[ModelText | None, ModelText], windows: Sequence[Record], mapping: Mapping[str, str]
) -> dict[str, Any]:
    try:
        old, new = (None if model is None else _limits(model, windows, mapping) for model in models)
    except BadInput as error:
        return {"reason": str(error), "outputs": {}}
    outputs = {
        name: {"unit": unit, "old": (old or {}).get(name, (None, unit))[0], "new": limit}
        for name, (limit, unit) in (new or {}).items()
    }
    return {"reason": None, "windows": len(windows), "outputs": outputs}


def _limits(model: ModelText, windows: Sequence[Record], mapping: Mapping[str, str]) -> dict[str, tuple[float, str]]:
    """Limit and unit of every measured output's RMS error in a healthy window."""
    if len(windows) < _FEWEST_MODELLED:
        raise BadInput(f"{len(windows)} healthy windows; at least {_FEWEST_MODELLED} are needed for a limit of the model's error")
    errors = []
    for window in windows:
        matched, experiments = match(model_of(*model), [window], mapping)
        errors.append(estimate(matched, experiments, free=()).rmse)
    outputs = list(matched.outputs.values())
    rms = np.array(errors)
    measured = [k for k in range(len(outputs)) if np.all(np.isfinite(rms[:, k]) & (rms[:, k] > 0))]
    limits = HealthyBand.of(rms[:, measured]).upper(FALSE_ALARM)
    return {outputs[k].name: (float(limit), outputs[k].unit) for k, limit in zip(measured, limits, strict=True)}
