"""The `compare` object and its short report."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from residuum.identification.errors import said
from residuum.identification.physics.simulate.experiment import PART
from residuum.identification.residual_analysis.compare import Comparison
from residuum.identification.residual_analysis.locate import Region
from residuum.library.answers.plain import chance


def comparison_json(model: str, records: list[str], comparison: Comparison) -> dict[str, Any]:
    """The `compare` object of the command line and the HTTP interface."""
    return {
        "model": model,
        "records": records,
        "outputs": {
            name: {
                "unit": output.unit,
                "rmse": output.rmse,
                "fit_percent": output.fit_percent,
                "bias": output.bias,
                "noise_floor": output.noise_floor,
                "noise_at_most": output.noise_at_most,
                "k_step": [
                    {"samples": steps, "rmse": rmse} for steps, rmse in output.k_step.items()
                ],
            }
            for name, output in comparison.outputs.items()
        },
        "balances": {
            name: {
                "unit": balance.unit,
                "missing_rms": balance.missing_rms,
                "relative_percent": balance.relative_percent,
            }
            for name, balance in comparison.balances.items()
        },
        "structured_error": {
            "present": comparison.present,
            "p_value": comparison.p_value,
            "share": comparison.share,
            "outputs": {
                name: {
                    "present": test.present,
                    "p_value": test.p_value,
                    "share": test.share,
                    "times_noise": comparison.times_noise(name),
                }
                for name, test in comparison.structured.items()
            },
        },
        "where": [region_json(region) for region in comparison.where],
        "not_recorded": comparison.not_recorded,
        "warnings": comparison.warnings,
    }


def region_json(region: Region) -> dict[str, Any]:
    """One entry of `where`."""
    return {
        "axis": region.axis,
        "from": region.start,
        "to": region.stop,
        "unit": region.unit,
        "times_noise": region.times_noise,
        "share": region.share,
        "time_share": region.time_share,
        "direction": region.direction,
        "of": region.of,
        "says": region.says,
    }


def _percent(fit: float) -> str:
    # A channel that stands still has no deviation from its mean to hold the error against.
    return f"{fit:.1f} %" if math.isfinite(fit) else "unknown (the record stands still)"


def comparison_text(comparison: Comparison) -> str:
    """The short human report."""
    lines = [
        f"{name}: simulated by itself, because an input is missing before or after it"
        for name in _parts(comparison)
    ]
    lines += warning_lines(comparison.warnings)
    lines += [_lacking(comparison, name) for name in comparison.not_recorded]
    for name, output in comparison.outputs.items():
        # Under an error that drifts the noise may be a bound alone: 6.97 once stood beside a true
        # 0.2.
        noise = "at most" if output.noise_at_most else "floor"
        lines.append(
            f"{name}: RMS error {output.rmse:.4g} {output.unit}, fit"
            f" {_percent(output.fit_percent)}, bias {output.bias:.3g} {output.unit}, noise {noise}"
            f" {output.noise_floor:.3g} {output.unit}"
        )
    for name, balance in comparison.balances.items():
        lines.append(
            f"balance {name}: missing term of {balance.missing_rms:.3g} {balance.unit} RMS"
            + (
                f", {balance.relative_percent:.1f} % of what drives it"
                if math.isfinite(balance.relative_percent)
                else ""
            )
        )
    lines.append(_structured(comparison))
    lines += [
        f"  {region.says} (of {region.of}; {100 * region.share:.0f} % of its power)"
        for region in comparison.where
    ]
    return "\n".join(lines)


def warning_lines(warnings: Sequence[str]) -> list[str]:
    """Warnings as the reports show them."""
    return [f"warning: {text}" for text in warnings]


def _lacking(comparison: Comparison, name: str) -> str:
    """Which output is not compared, in which records."""
    records = comparison.not_recorded[name]
    where = f" in {', '.join(records)}" if len(records) < len(comparison.records) else ""
    way_to_map = said("map", {name: "COLUMN"})
    return f"{name}: not compared{where}, for no column holds it (map one: {way_to_map})"


def _structured(comparison: Comparison) -> str:
    """Whether the error is structured, in a line."""
    if not comparison.structured:
        return "structured error: not told; the records are too short to tell an error from noise"
    # Readings that are odd were left out, so that nothing is said of them either way.
    if not comparison.present and comparison.odd_samples:
        return "structured error: not told; the sensor's readings are odd where the warning says so"
    if not comparison.present:
        return (
            f"structured error: no ({chance(comparison.p_value)}; noise alone explains the error)"
        )
    percent = 100 * comparison.share
    # A share below 1 % rounded to a whole number would be told as none.
    share = f"{percent:.0f}" if percent >= 1.0 else f"{percent:.1g}"
    says = f"structured error: yes ({chance(comparison.p_value)}, {share} % of the error's power)"
    present = [name for name, test in comparison.structured.items() if test.present]
    times = max(comparison.times_noise(name) for name in present)
    return says if times > 1.0 else f"{says}; it is within the noise, {times:.2g} times as large"


def _parts(comparison: Comparison) -> list[str]:
    """Names of records that are parts of one with holes."""
    return [name for name in comparison.records if PART in name]
