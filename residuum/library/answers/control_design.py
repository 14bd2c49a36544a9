"""The `control design` object and its short report."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from residuum.identification.errors import said
from residuum.identification.linear_models.transfer_function import TransferFunction
from residuum.library.answers.plain import finite
from residuum.robust_control.certificates import (
    Measured,
    StepResponse,
    disk_margin,
    h_infinity_norm,
)
from residuum.robust_control.control_problem import ControlProblem, Solution, Wishes
from residuum.robust_control.loop import weighted_loop

# What a control design promises in time beside what is measured, for the console and the page.

# Share of the drawn plants that stay below what is told as reached: that which `in_time` holds a
# design to.
_SHARE = 0.95


def promise_and_measurement(
    solution: Solution, wishes: Wishes, responses: Measured
) -> dict[str, Any]:
    """`promised` (None with the robust aim: it promises nothing in time) and `measured`, whose
    `kept` says whether they agree.

    `kept` is of the nominal loop, `share_kept` of the drawn plants; `reached_by_95_percent` is what
    95 % of these stay below.
    """
    overshoot, settling_time = responses.reached_by(_SHARE)
    measured: dict[str, Any] = {
        "nominal": _figures(responses.nominal),
        "random_plants": {
            "count": len(responses.drawn),
            "median": _figures(
                StepResponse(
                    *(
                        float(np.median([getattr(step, name) for step in responses.drawn]))
                        for name in _NAMES
                    )
                )
            ),
            "reached_by_95_percent": {
                "overshoot": finite(overshoot),
                "settling_time_s": finite(settling_time),
            },
        },
    }
    # The robust aim shapes weights alone: it promises nothing in time.
    if wishes.aim != "nominal":
        return {"promised": None, "measured": measured}
    promised = {
        "overshoot": solution.chosen.first,
        "settling_time_s": solution.chosen.second,
        "in_time": wishes.in_time,
    }
    promise_kept, share = responses.kept(solution.chosen.first, solution.chosen.second)
    return {
        "promised": promised,
        "measured": measured | {"kept": promise_kept, "share_kept": share},
    }


def says(result: Mapping[str, Any]) -> list[str]:
    """The same in lines for people."""
    measured, promised = result["measured"], result["promised"]
    nominal = measured["nominal"]
    lines = [
        f"  measured on the nominal loop: overshoot {_percent(nominal)}, settling"
        f" {_seconds(nominal)}"
    ]
    if promised is None:
        return lines
    verdict = "kept" if measured["kept"] else "NOT kept"
    if not measured["kept"] and not promised["in_time"]:
        verdict += (
            " (the weight promises this of its reference model alone;"
            f" {said('in_time', True)} holds the loop to it)"
        )
    reached = measured["random_plants"]["reached_by_95_percent"]
    return [
        f"  promised: overshoot {_percent(promised)}, settling {_seconds(promised)}: {verdict}",
        *lines,
        (
            f"  95 % of the random plants: overshoot up to {_percent(reached)}, settling up to"
            f" {_seconds(reached)}; {100 * measured['share_kept']:.0f} % keep the promise"
        ),
    ]


# Figures of a step response, in the order in which `StepResponse` takes them.
_NAMES = ("overshoot", "settling_time", "integral_absolute_error")


def _figures(step: StepResponse) -> dict[str, float | None]:
    return {
        "overshoot": finite(step.overshoot),
        "settling_time_s": finite(step.settling_time),
        "integral_absolute_error_s": finite(step.integral_absolute_error),
    }


def _percent(figures: Mapping[str, Any]) -> str:
    value = figures["overshoot"]
    return "without end" if value is None else f"{100 * value:.3g} %"


def _seconds(figures: Mapping[str, Any]) -> str:
    value = figures["settling_time_s"]
    return "never" if value is None else f"{value:.4g} s"


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
            # The norm of a loop that is not stable bounds nothing; neither has it a margin.
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
    # A controller cannot answer a measurement within the sample that its own signal moves: an
    # algebraic loop of gains of thousands looked stable, and diverged on the true plant.
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
