"""The `control design` object of a plant with as many outputs as inputs, and its short report."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from residuum.library.answers.plain import finite
from residuum.robust_control.certificates import StepResponse
from residuum.robust_control.multivariable_control import (
    SHARE,
    MeasuredLoop,
    MultivariableDesign,
    MultivariableProblem,
    reached,
)


def design_json(problem: MultivariableProblem, design: MultivariableDesign) -> dict[str, Any]:
    """Decoupler, loops with promise and measurement beside each other, and whether all loops
    together are certified.
    """
    measured = problem.measured(design)
    # A drawn plant is unstable where the error of any of its loops has no end.
    endless = [
        [not math.isfinite(step.integral_absolute_error) for step in loop.own.drawn]
        for loop in measured
    ]
    unstable = np.any(endless, axis=0)
    return {
        "feasible": True,
        "inputs": list(problem.model.inputs),
        "outputs": list(problem.model.outputs),
        "sample_time": problem.sample_time,
        "static_gain": problem.gains,
        "relative_gains": problem.relative_gains,
        "decoupler": design.decoupler,
        "loops": [_loop(design, k, loop) for k, loop in enumerate(measured)],
        "certified": design.certified,
        "samples": problem.choice.samples,
        "random_plants": {"count": len(unstable), "unstable": int(unstable.sum())},
    }


def _loop(design: MultivariableDesign, k: int, measured: MeasuredLoop) -> dict[str, Any]:
    point, bound = design.points[k], design.bounds[k]
    tuned = point.design
    overshoot, settling_time = measured.own.reached_by(SHARE)
    promise_kept, share = measured.own.kept(point.first, point.second)
    return {
        "output": design.loops[k].output,
        "parameters": dict(zip(tuned.structure.names, tuned.rho.tolist(), strict=True)),
        "equation": tuned.structure.equation,
        "controller": {"numerator": tuned.controller.num, "denominator": tuned.controller.den},
        "certified_cost": tuned.certified,
        "stability_bound": bound,
        "critical_frequency_rad_s": design.loops[k].crossing,
        "promised": {"overshoot": point.first, "settling_time_s": point.second},
        "measured": {
            "nominal": _figures(measured.own.nominal) | {"coupling": finite(measured.coupling)},
            "reached_by_95_percent": {
                "overshoot": finite(overshoot),
                "settling_time_s": finite(settling_time),
                "coupling": finite(reached(measured.drawn_coupling)),
            },
            "kept": promise_kept,
            "share_kept": share,
        },
    }


def design_text(result: dict[str, Any]) -> str:
    """The short human report."""
    rows = "; ".join(", ".join(f"{value:.4g}" for value in row) for row in result["decoupler"])
    plants = result["random_plants"]
    inputs = ", ".join(result["inputs"])
    certificate = "NOT certified"
    if result["certified"]:
        certificate = "all loops together are certified stable for every drawn model"
    lines = [
        f"{result['structure']} behind the decoupler D (rows: {inputs}) {rows}",
        f"  {certificate}; {plants['unstable']} of {plants['count']} further plants unstable",
    ]
    for loop in result["loops"]:
        measured, promised = loop["measured"], loop["promised"]
        nominal, most = measured["nominal"], measured["reached_by_95_percent"]
        lines += [
            f"  {loop['output']}: "
            + ", ".join(f"{name} = {value:.5g}" for name, value in loop["parameters"].items()),
            (
                f"    ‖T Σ W‖∞ = {loop['stability_bound']:.4g} (below 1 is asked); promised"
                f" {_step(promised)}: {'kept' if measured['kept'] else 'NOT kept'}"
            ),
            (
                f"    measured: nominal {_step(nominal)}, other outputs move by"
                f" {_size(nominal['coupling'])}; 95 % of plants {_step(most)},"
                f" {_size(most['coupling'])}"
            ),
        ]
    return "\n".join([*lines, *([f"  written to {result['file']}"] if result["file"] else [])])


def _figures(step: StepResponse) -> dict[str, float | None]:
    return {"overshoot": finite(step.overshoot), "settling_time_s": finite(step.settling_time)}


def _step(figures: dict[str, Any]) -> str:
    overshoot, settling = figures["overshoot"], figures["settling_time_s"]
    return (
        ("overshoot without end" if overshoot is None else f"overshoot {100 * overshoot:.3g} %")
        + ", "
        + ("never settled" if settling is None else f"settling {settling:.4g} s")
    )


def _size(value: float | None) -> str:
    return "without end" if value is None else f"{value:.3g}"
