"""A finding as the short report shows it."""

from __future__ import annotations

from typing import Any


def finding_text(finding: dict[str, Any]) -> str:
    """The verdict with its reason, and a line an indicator; `record` names the window."""
    kind = f" ({finding['class']})" if finding["class"] else ""
    headline = f"{finding.get('record', finding['diagnoser'])}: {finding['verdict']}{kind}" + (
        f": {finding['reason']}" if finding["reason"] else ""
    )
    numbers = [
        _indicator(finding, name, value)
        for name, value in finding["indicators"].items()
        if value is not None
    ]
    return "\n  ".join([headline, *numbers])


def _indicator(finding: dict[str, Any], name: str, value: Any) -> str:
    unit = finding["units"].get(name, "")
    limit = finding["thresholds"].get(name)
    shown = f"{value:.4g}" if isinstance(value, int | float) else str(value)
    # A pure number has the unit 1, which is not written.
    return f"{name} = {shown}{'' if unit in ('', '1') else ' ' + unit}" + (
        f" (threshold {limit:.4g})" if isinstance(limit, int | float) else ""
    )
