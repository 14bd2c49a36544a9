"""What a control design promises in time beside what is measured, for the console and the page."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from residuum.library.answers.plain import finite
from residuum.robust_control.certificates import Measured, StepResponse
from residuum.robust_control.control_problem import Solution, Wishes

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
    if wishes.aim != "nominal":
        return {"promised": None, "measured": measured}
    promised = {
        "overshoot": solution.chosen.first,
        "settling_time_s": solution.chosen.second,
        "in_time": wishes.in_time,
    }
    kept, share = responses.kept(solution.chosen.first, solution.chosen.second)
    return {"promised": promised, "measured": measured | {"kept": kept, "share_kept": share}}


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
            " (the weight promises this of its reference model alone; --in-time holds the loop"
            " to it)"
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
