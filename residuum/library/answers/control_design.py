"""The `control design` object and its short report."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from residuum.identification.linear_models.transfer_function import TransferFunction
from residuum.library.answers.control_promise import says
from residuum.robust_control.certificates import StepResponse, disk_margin, h_infinity_norm
from residuum.robust_control.control_problem import ControlProblem, Solution
from residuum.robust_control.loop import weighted_loop


def design_json(
    solution: Solution,
    names: tuple[str, str],
    figures: Sequence[StepResponse],
    problem: ControlProblem,
) -> dict[str, Any]:
    """The `control design` object of a feasible design, without its question."""
    chosen, W_T = solution.chosen, problem.W_T
    design = chosen.design
    return {
        "feasible": True,
        "parameters": dict(zip(design.structure.names, design.rho.tolist(), strict=True)),
        "equation": design.structure.equation,
        "controller": {
            "numerator": design.controller.num,
            "denominator": design.controller.den,
            "sample_time": design.controller.sample_time,
        },
        "cost": design.cost,
        "certified_cost": design.certified,
        "worst_frequency_rad_s": design.worst_frequency,
        "stable": design.stable,
        "robust_stability_norm": (
            h_infinity_norm(weighted_loop(problem.plant, design.controller, W_T=W_T))[0]
            if design.stable
            else None
        ),
        "disk_margin": _margin(problem, design.controller) if design.stable else None,
        "chosen": {names[0]: chosen.first, names[1]: chosen.second},
        "pareto_front": [
            {names[0]: point.first, names[1]: point.second} for point in solution.front
        ],
        "uncertainty_weight": {
            "numerator": W_T.num,
            "denominator": W_T.den,
            "critical_frequency_rad_s": problem.crossing,
        },
        "largest_uncertainty": float(problem.largest.max()),
        "random_plants": {
            "count": len(figures),
            "unstable": sum(
                not math.isfinite(figure.integral_absolute_error) for figure in figures
            ),
            "overshoot_median": float(np.median([figure.overshoot for figure in figures])),
            "settling_time_median_s": float(
                np.median([figure.settling_time for figure in figures])
            ),
            "integral_absolute_error_median_s": float(
                np.median([figure.integral_absolute_error for figure in figures])
            ),
        },
    }


def _margin(problem: ControlProblem, controller: TransferFunction) -> dict[str, float | None]:
    """By which factors the gain and by which angle the phase of the nominal loop may vary, at
    once.
    """
    margin = disk_margin(problem.plant, controller)
    return {
        "gain_low": margin.gain_low,
        "gain_high": margin.gain_high if math.isfinite(margin.gain_high) else None,
        "phase_deg": math.degrees(margin.phase),
        "frequency_rad_s": margin.frequency,
    }


def _margin_text(margin: dict[str, float | None] | None) -> list[str]:
    if margin is None:
        return []
    high = "without limit" if margin["gain_high"] is None else f"{margin['gain_high']:.3g} times"
    return [
        f"  nominal loop's disk margin: gain {margin['gain_low']:.3g} to {high} and phase ±"
        f" {margin['phase_deg']:.3g}° at once"
    ]


def _about(result: dict[str, Any]) -> list[str]:
    about, lines = result["largest_uncertainty_about"], []
    if result["computation_samples"]:
        lines = [
            "  the plant acts within its sample: the loop is closed one sample later, as a"
            " controller can answer"
        ]
    if about["joined"] is None:
        return lines
    return [
        *lines,
        (
            f"  largest uncertainty about the joined model {about['joined']:.4g}, about the models'"
            f" mean {about['mean']:.4g}"
        ),
    ]


def design_text(result: dict[str, Any]) -> str:
    """The short human report; `file` says where the controller was written."""
    plants, control_law = result["random_plants"], result["parameters"]
    wishes = ", ".join(f"{name} = {value:.4g}" for name, value in result["chosen"].items())
    written = [
        f"  written to {result['file']}"
        + (f" and {result['exported']}" if "exported" in result else "")
    ]
    return "\n".join(
        [
            f"{result['structure']}: K = {result['equation']}",
            "  " + ", ".join(f"{name} = {value:.5g}" for name, value in control_law.items()),
            *_about(result),
            f"  aim {result['aim']}: {wishes}",
            (
                f"  cost {result['certified_cost']:.4g}, largest at"
                f" {result['worst_frequency_rad_s']:.4g} rad/s; robust stability ‖W_T T‖∞ ="
                f" {result['robust_stability_norm'] or math.inf:.6g}"
            ),
            (
                f"  nominal loop {'stable' if result['stable'] else 'UNSTABLE'}; {plants['count']}"
                f" random plants: {plants['unstable']} unstable, median overshoot"
                f" {100 * plants['overshoot_median']:.2g} %, settling"
                f" {plants['settling_time_median_s']:.3g} s"
            ),
            *_margin_text(result["disk_margin"]),
            *says(result),
            *(written if result["file"] else []),
        ]
    )
