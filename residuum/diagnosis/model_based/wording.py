"""What is found, in sentences that a maintenance engineer understands."""

from __future__ import annotations

from residuum.diagnosis.model_based.hypotheses import Hypothesis

_SENSOR = {
    "offset": "{place} reads {value} too much",
    "gain": "{place} reads {percent} of what it measures too much",
    "delay": "{place} comes {value} late",
    "noise": "{place} is noisier than when healthy by {value}",
    "stuck": "{place} stands at {value} although the machine moves",
    "drop-out": "{place} loses {percent} of its readings",
    "drift": "{place} drifts by {value}",
}
_ACTUATOR = {
    "offset": "{place} acts as if it were {value} more than commanded",
    "gain": "{place} acts {percent} more than commanded",
    "stuck": "{place} does not follow its command",
    "delay": "{place} acts {value} late",
}


def number(value: float, std: float | None = None) -> str:
    """A number with as many figures as its doubt leaves.

    >>> number(0.03124, 0.0021), number(1234.5, 20.0), number(0.5)
    ('0.0312 ± 0.0021', '1234 ± 20', '0.5')
    """
    if not std:
        return f"{value:.4g}"
    figures = max(2, min(6, 2 + _decades(value) - _decades(std)))
    shown = f"{value:.{figures}g}"
    return f"{float(shown):g} ± {std:.2g}" if "e" not in shown else f"{float(shown):.0f} ± {std:.2g}"


def _decades(value: float) -> int:
    return int(f"{abs(value):e}".partition("e")[2]) if value else 0


def said(
    hypothesis: Hypothesis | None, value: float | None, std: float | None, healthy: tuple[float, float] | None, since: str
) -> str:
    """One sentence: what, how much, what is usual when healthy, since when."""
    if hypothesis is None:
        return "something that no single parameter, effect, sensor or actuator explains"
    h = hypothesis
    unit = "" if h.unit in ("", "1") else f" {h.unit}"
    size = "" if value is None else number(value, 1.96 * std if std else None) + unit
    words = {"place": h.place, "value": size, "percent": "" if value is None else f"{100 * value:.3g} %"}
    templates = {"sensor": _SENSOR, "actuator": _ACTUATOR}.get(h.kind, {})
    if h.name in templates:
        return f"{h.kind} {templates[h.name].format(**words)}{since}"
    if h.kind == "disturbance":
        return f"a load that nobody recorded acts on the {h.place}{since}"
    where = f" of the {h.place}" if h.place else ""
    usual = "" if healthy is None else f", healthy {number(healthy[0])} to {number(healthy[1])}"
    much = f" {size}" if size else ", of a size that the window leaves open"
    return f"{h.name.replace('-', ' ')}{where}{much}{usual}{since}"
