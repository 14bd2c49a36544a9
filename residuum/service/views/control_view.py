"""What a page draws of a robust controller: the front of what is possible, and for each of its
points bounds, loops and steps.

The work of a job.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
import numpy.typing as npt

from residuum.array_types import FloatArray
from residuum.identification.linear_models.transfer_function import TransferFunction
from residuum.library.answers.control_design import promise_and_measurement
from residuum.library.answers.plain import finite
from residuum.library.control import law, posed
from residuum.library.questions.control_design import DesignController
from residuum.robust_control.certificates import (
    StepResponse,
    control_response,
    h_infinity_norm,
    over_plants,
    step_response,
)
from residuum.robust_control.control_problem import ControlProblem, Wishes
from residuum.robust_control.controller_export import LANGUAGES, DifferenceEquation
from residuum.robust_control.loop import weighted_loop
from residuum.robust_control.synthesis.constrained_structure import Point
from residuum.robust_control.synthesis.structured_synthesis import Synthesis
from residuum.robust_control.weights.performance_weight import Infeasible, refined
from residuum.service.views.signal_view import read_identified
from residuum.service.work.jobs import Progress

# Frequencies, moments and drawn plants of a picture at most: all points of the front travel in one
# answer, so that a click on the front costs no request. Medians are of all drawn plants.
_FREQUENCIES, _TIMES, _SHOWN_PLANTS = 200, 200, 40
# Median settling times that a step response is shown for, and samples at least.
_SHOWN_SETTLING_TIMES, _FEWEST_SAMPLES = 3.0, 40
# Of each number that is drawn. More than a screen resolves, at a third of the bytes of a float's
# 17.
_DIGITS = 6

Follow = Callable[[TransferFunction, TransferFunction, float], FloatArray]
"""What follows a unit step of the reference: (plant, controller, seconds)."""


def view_control_design(
    progress: Progress,
    contents: Sequence[bytes],
    joined: bytes | None,
    asked: DesignController,
) -> Mapping[str, Any]:
    """Design controllers along the Pareto front, and say of each what it promises and how it
    behaves on drawn plants.

    Parameters
    ----------
    contents : sequence of bytes
        Files of identified models, one an operating point.
    joined : bytes or None
        File of the nominal plant; None: the models' mean.
    asked : DesignController

    Returns
    -------
    mapping
        `feasible`, else `reason`; `frequency` [Hz] of all that is drawn; `uncertainty`; `input` and
        `output` of the plant; `points` of the front with `chosen`, the index of the preferred one.
        A point has its `controller`, certified `cost`, |S|, |T|, |W_S|, |W_T| and their `total`,
        the open `loop` with the range over drawn plants, step responses (`time` [s], `nominal`,
        `drawn`, and the same of the `control` signal u), their `figures`, and `exports`.

    Raises
    ------
    BadInput
        Models of different sample times, too large an uncertainty.
    """
    wanted = asked.handed_to(Wishes)
    progress(0.05, "drawing models for the uncertainty weight")
    middle = None if joined is None else read_identified(joined)
    problem = posed([read_identified(content) for content in contents], middle, asked)
    progress(0.15, "searching for the front")
    structure = law(problem, asked)
    described = {
        "structure": asked.structure,
        "equation": structure.equation,
        "aim": wanted.aim,
        "wishes": wanted.names,
        "limit": wanted.limit,
    }
    # What an infeasible design can be told with, too: how large the uncertainty is.
    described |= {
        "sample_time": problem.loop.sample_time,
        "uncertainty": _uncertainty(problem),
        **_signals(problem),
    }
    try:
        solution = problem.solve(structure, wanted)
    except Infeasible as no:
        return described | {"feasible": False, "reason": str(no)}
    points, chosen = _with_chosen(problem, wanted, solution.front, solution.chosen)
    plants = problem.random_plants()
    measured = problem.measured(solution, wanted)
    figures = []
    for index, point in enumerate(points):
        progress(
            0.5 + 0.4 * index / len(points),
            f"following {len(plants)} drawn plants, point {index + 1} of {len(points)}",
        )
        figures.append(over_plants(plants, point.design.controller, problem.horizon))
    progress(0.9, "preparing the charts")
    picture = _Picture(problem, plants)
    drawn = [
        {
            **_promises(problem, point),
            **picture.of(wanted, point, responses),
            **_exports(point, asked.actuator),
            "figures": _figures(responses),
        }
        for point, responses in zip(points, figures, strict=True)
    ]
    common: dict[str, Any] = {"frequency": _plain(picture.frequency), "drawn_plants": len(plants)}
    common |= promise_and_measurement(solution, wanted, measured)
    return described | {"feasible": True, **common, "points": drawn, "chosen": chosen}


def _with_chosen(
    problem: ControlProblem,
    wishes: Wishes,
    front: Sequence[Point[Synthesis]],
    chosen: Point[Synthesis],
) -> tuple[list[Point[Synthesis]], int]:
    """The front with every cost minimised to the end, and where on it the chosen point is."""
    index = next(
        k
        for k, point in enumerate(front)
        if (point.first, point.second) == (chosen.first, chosen.second)
    )
    return [
        # The search for the front stops as soon as a pair is feasible: the others are minimised
        # here.
        chosen if k == index else refined(problem.loop, problem.weights(wishes, point), point)
        for k, point in enumerate(front)
    ], index


def _signals(problem: ControlProblem) -> dict[str, Any]:
    first = problem.models[0]
    return {
        "input": {"name": first.input_name, "unit": first.input_unit},
        "output": {"name": first.output_name, "unit": first.output_unit},
    }


def _uncertainty(problem: ControlProblem) -> dict[str, Any]:
    shown = _spread(len(problem.loop.omega), _FREQUENCIES)
    return {
        "frequency": _plain(problem.loop.omega[shown] / (2 * np.pi)),
        "weight": _plain(problem.magnitude[shown]),
        "largest": _plain(problem.largest[shown]),
        "critical_frequency": problem.crossing / (2 * np.pi),
        "samples": problem.choice.samples,
        "order": len(problem.W_T.den) - 1,
    }


def _promises(problem: ControlProblem, point: Point[Synthesis]) -> dict[str, Any]:
    design = point.design
    # The certificate of robust stability, ‖W_T T‖∞ < 1, means nothing for an unstable loop.
    norm = (
        h_infinity_norm(weighted_loop(problem.plant, design.controller, W_T=problem.W_T))[0]
        if design.stable
        else None
    )
    return {
        "first": point.first,
        "second": point.second,
        "parameters": dict(zip(design.structure.names, design.rho.tolist(), strict=True)),
        "controller": {
            "numerator": design.controller.num.tolist(),
            "denominator": design.controller.den.tolist(),
            "sample_time": design.controller.sample_time,
        },
        "cost": design.certified,
        "worst_frequency": design.worst_frequency / (2 * np.pi),
        "stable": design.stable,
        "robust_stability_norm": norm,
    }


def _exports(point: Point[Synthesis], limits: tuple[float, float]) -> dict[str, Any]:
    equation = DifferenceEquation(point.design.controller, *limits)
    exports = {name: source(equation) for name, source in LANGUAGES.items()}
    return {
        "difference_equation": equation.text(),
        "b": equation.b.tolist(),
        "a": equation.a.tolist(),
        "exports": exports,
    }


def _figures(steps: Sequence[StepResponse]) -> dict[str, Any]:
    """Medians over the drawn plants, and how many are unstable."""
    rows = [asdict(step) for step in steps]
    medians = {name: finite(float(np.median([row[name] for row in rows]))) for name in rows[0]}
    return {
        **medians,
        "unstable": sum(not math.isfinite(step.integral_absolute_error) for step in steps),
    }


class _Picture:
    """Curves of one controller after the other over the same frequencies and drawn plants."""

    def __init__(self, problem: ControlProblem, plants: Sequence[TransferFunction]) -> None:
        self._problem = problem
        self._plants = plants[:: max(1, len(plants) // _SHOWN_PLANTS)]
        self._omega = problem.loop.omega[_spread(len(problem.loop.omega), _FREQUENCIES)]
        self._G = np.array([plant.frequency_response(self._omega) for plant in self._plants])
        self._nominal = problem.plant.frequency_response(self._omega)

    @property
    def frequency(self) -> FloatArray:
        """[Hz]."""
        return np.asarray(self._omega / (2 * np.pi))

    def of(
        self, wishes: Wishes, point: Point[Synthesis], figures: Sequence[StepResponse]
    ) -> dict[str, Any]:
        """|S|, |T| and their weights, the open loop with the range over the drawn plants, and the
        step responses.
        """
        K = point.design.controller.frequency_response(self._omega)
        L = self._nominal * K
        S = 1.0 / (1.0 + L)
        weights = self._problem.weights(wishes, point)
        W_S = np.interp(self._omega, self._problem.loop.omega, weights.W_S)
        W_T = np.interp(self._omega, self._problem.loop.omega, weights.W_T)
        parts = [W_S * np.abs(S), W_T * np.abs(L * S)]
        # |W_S S| + |W_T T| where both stand in one entry, else the norm of the column (W_S S, W_T
        # T).
        total = parts[0] + parts[1] if weights.entries == "1" else np.hypot(*parts)
        return {
            "S": _plain(np.abs(S)),
            "T": _plain(np.abs(L * S)),
            "W_S": _plain(W_S),
            "W_T": _plain(W_T),
            "total": _plain(total),
            "loop": self._loop(L, self._G * K),
            "steps": self._steps(point.design.controller, figures),
        }

    def _loop(
        self, nominal: npt.NDArray[np.complex128], drawn: npt.NDArray[np.complex128]
    ) -> dict[str, Any]:
        """Bode points of the open loop; drawn phases are counted from the nominal one, so that none
        is a turn away.
        """
        phase = np.unwrap(np.angle(nominal))
        turned = phase + np.angle(drawn / nominal)
        size = np.abs(drawn)
        return {
            "magnitude": _plain(np.abs(nominal)),
            "lowest": _plain(size.min(axis=0)),
            "highest": _plain(size.max(axis=0)),
            "phase": _plain(np.degrees(phase)),
            "lowest_phase": _plain(np.degrees(turned.min(axis=0))),
            "highest_phase": _plain(np.degrees(turned.max(axis=0))),
        }

    def _steps(
        self, controller: TransferFunction, figures: Sequence[StepResponse]
    ) -> dict[str, Any]:
        """Responses until three median settling times, or the horizon that the figures were taken
        over.
        """
        sample_time = self._problem.loop.sample_time
        settling = float(np.median([step.settling_time for step in figures]))
        end = max(
            min(_SHOWN_SETTLING_TIMES * settling, self._problem.horizon),
            _FEWEST_SAMPLES * sample_time,
        )
        shown = _spread(max(2, round(end / sample_time)), _TIMES)

        def responses(follow: Follow) -> dict[str, Any]:
            nominal, *drawn = [
                _plain(follow(plant, controller, end)[shown])
                for plant in (self._problem.plant, *self._plants)
            ]
            return {"nominal": nominal, "drawn": drawn}

        time = _plain(np.asarray(shown * sample_time, dtype=float))
        return {"time": time, **responses(step_response), "control": responses(control_response)}


def _spread(n: int, most: int) -> npt.NDArray[np.intp]:
    """At most `most` indices out of n, both ends among them."""
    return np.unique(np.linspace(0, n - 1, min(n, most)).round().astype(np.intp))


def _plain(values: FloatArray) -> list[float | None]:
    return [finite(float(f"{value:.{_DIGITS}g}")) for value in values]
