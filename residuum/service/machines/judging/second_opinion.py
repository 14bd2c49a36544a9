"""A second opinion on a window, beside the finding that decides."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

from residuum.diagnosis.finding import Finding
from residuum.identification.errors import BadInput
from residuum.service.fieldbus.settings import MachineSettings
from residuum.service.machines.baselines import baseline_name
from residuum.service.storage.disk_store import DiskStore


def with_second_opinion(finding: Finding, second: Finding) -> Finding:
    """The first finding with the second as evidence: verdict and alarms are the first one's."""
    opinion = {
        "diagnoser": second.diagnoser,
        "verdict": second.verdict.value,
        "class": second.fault_class,
        "reason": second.reason,
        "indicators": dict(second.indicators),
        "thresholds": dict(second.thresholds),
        "causes": second.evidence.get("causes", []),
        "agrees": second.verdict is finding.verdict,
    }
    return replace(finding, evidence={**finding.evidence, "second_opinion": opinion})


def second_name(store: DiskStore, asset: str, wanted: str | None) -> str:
    """The name under which the baseline of a machine's second opinion is stored."""
    return baseline_name(store, f"{asset}.second", wanted)


class Trained(NamedTuple):
    """What is trained: which diagnoser, stored under which name, with which model."""

    diagnoser: str
    name: str
    model: str | None


def what_is_trained(store: DiskStore, settings: MachineSettings, *, second: bool) -> Trained:
    """The machine's own diagnoser, or its second opinion; BadInput where it has none."""
    if not second:
        return Trained(
            settings.diagnoser,
            baseline_name(store, settings.asset, settings.baseline),
            settings.model,
        )
    if settings.second is None:
        raise BadInput(f"machine {settings.asset!r}: has no second opinion in its settings")
    name = second_name(store, settings.asset, settings.second.baseline)
    return Trained(settings.second.diagnoser, name, settings.second.model)
