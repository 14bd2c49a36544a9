"""What is found, in sentences that a maintenance engineer understands."""

from __future__ import annotations

from residuum.diagnosis.model_based.causes import Cause

_SENSOR = {
    "offset": "{place} reads {value} too much",
    "gain": "{place} reads {percent} of what it measures too much",
    "delay": "{place} comes {value} late",
    "noise": "{place} is noisier than when healthy: {value}",
    "stuck": "{place} stands at {value} although the machine moves",
    "drop-out": "{place} loses {percent} of its readings",
}
_ACTUATOR = {
    "offset": "{place} acts as if it were {value} more than commanded",
    "gain": "{place} acts {percent} more than commanded",
    "limit": "{place} no longer reaches its largest values: {value} are lacking",
    "stuck": "{place} does not follow its command",
}


def number(value: float, std: float | None = None) -> str:
    """A number with as many figures as its doubt leaves.

    >>> number(0.03124, 0.0021), number(1234.5, 20.0), number(0.5)
    ('0.0312 ± 0.0021', '1234 ± 20', '0.5')
    """
    if not std:
        return f"{value:.4g}"
    figures = max(2, min(6, 2 + round(_decades(value) - _decades(std))))
    shown = f"{value:.{figures}g}"
    return f"{float(shown):g} ± {std:.2g}" if "e" not in shown else f"{float(shown):.0f} ± {std:.2g}"


def _decades(value: float) -> float:
    return float(len(f"{abs(value):e}") and int(f"{abs(value):e}".partition("e")[2])) if value else 0.0


def said(cause: Cause, value: float | None, low: float | None, high: float | None, since: str) -> str:
    """One sentence: what, how much, what is usual when healthy, since when."""
    unit = "" if cause.unit in ("", "1") else f" {cause.unit}"
    width = 1.96 * cause.std if cause.std else None
    size = "" if value is None else number(value, width) + unit
    percent = "" if value is None else f"{100 * value:.3g} %"
    words = {"place": cause.place, "value": size, "percent": percent}
    if cause.kind == "unknown":
        return f"something that no single parameter, effect, sensor or actuator explains{since}"
    if cause.kind == "sensor":
        return f"sensor {_SENSOR[cause.name].format(**words)}{since}"
    if cause.kind == "actuator":
        return f"actuator {_ACTUATOR[cause.name].format(**words)}{since}"
    if cause.name == "rough-load":
        return f"a load that changes at random by {size} from sample to sample acts on the {cause.place}{since}"
    if cause.kind == "disturbance":
        return f"a load of {size} acts on the {cause.place}{since}"
    where = f" of the {cause.place}" if cause.place else ""
    usual = "" if low is None or high is None else f", healthy {number(low)} to {number(high)}"
    return f"{cause.name.replace('-', ' ')}{where} {size}{usual}{since}"
