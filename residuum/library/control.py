"""`rs.control`: robust controllers of fixed structure from identified plants."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from residuum.identification.errors import BadInput
from residuum.identification.linear_models.transfer_function import TransferFunction
from residuum.library.answers.control_design import design_json, design_text
from residuum.library.answers.control_promise import promise_and_measurement
from residuum.library.picture import Curve, Panel, Picture
from residuum.library.plant import Plant, load_plant, to_control
from residuum.library.result import Result, Row
from residuum.library.whole_file import write_whole
from residuum.nearest_names import known_names
from residuum.robust_control.certificates.time_domain import Measured, StepResponse, step_response
from residuum.robust_control.control_problem import STRUCTURES, ControlProblem, Solution, WeightChoice, Wishes
from residuum.robust_control.controller_export import LANGUAGES, DifferenceEquation
from residuum.robust_control.synthesis.constrained_structure import Constrained
from residuum.robust_control.synthesis.controller_structure import ControllerStructure
from residuum.robust_control.weights.nominal_performance import Infeasible

__all__ = ["Controller", "Infeasible", "design"]

_SHOWN_PLANTS = 20
_NO_LIMITS = (-math.inf, math.inf)


@dataclass(frozen=True, eq=False, repr=False)
class Controller(Result):
    """A discrete-time controller with what it promises for the plant and for plants that the data do not exclude.

    Attributes
    ----------
    structure, aim : str
    plants : tuple of str
        What it was designed for.
    problem, found
        The control problem (plant, weights, grid), and the Pareto front with the point that was chosen.

    Examples
    --------
    >>> import residuum as rs
    >>> plant = rs.identify(rs.simulate("process-plant", seed=1), input="u", output="y", order=40)
    >>> controller = rs.control.design(plant, structure="pi", aim="robust")
    >>> controller.to_dict()["stable"], "controller_step" in controller.export_c()
    (True, True)
    """

    structure: str
    aim: str
    plants: tuple[str, ...]
    problem: ControlProblem
    wishes: Wishes
    found: Solution

    @property
    def transfer_function(self) -> TransferFunction:
        """K(z), from control error to control signal."""
        return self.found.chosen.design.controller

    @property
    def parameters(self) -> dict[str, float]:
        """The structure's parameters by name."""
        made = self.found.chosen.design
        return dict(zip(made.structure.names, made.rho.tolist(), strict=True))

    @cached_property
    def measured(self) -> Measured:
        """Step responses of the nominal loop, and of 200 or more plants drawn from their uncertainty that no design has seen."""
        return self.problem.measured(self.found, self.wishes)

    @property
    def figures(self) -> list[StepResponse]:
        """Overshoot, settling time and integral absolute error of the drawn plants."""
        return list(self.measured.drawn)

    def to_control(self) -> Any:
        """K(z) as a python-control `TransferFunction`; MissingPackage when `control` is not installed.

        Returns
        -------
        control.TransferFunction

        Examples
        --------
        >>> import residuum as rs
        >>> plant = rs.identify(rs.simulate("process-plant", seed=1), input="u", output="y", method="arx", order=2)
        >>> controller = rs.control.design(plant)
        >>> type(controller.to_control()).__name__
        'TransferFunction'
        """
        return to_control(self.transfer_function)

    def difference_equation(self, limits: tuple[float, float] = _NO_LIMITS) -> DifferenceEquation:
        """What the target computes each sample; `limits` of the actuator are kept without wind-up.

        Parameters
        ----------
        limits : (lower, upper)
            Of the actuator, in the unit of the plant's input.

        Returns
        -------
        DifferenceEquation

        Raises
        ------
        BadInput
            A lower limit that is not below the upper one.

        Examples
        --------
        >>> import residuum as rs
        >>> plant = rs.identify(rs.simulate("process-plant", seed=1), input="u", output="y", method="arx", order=2)
        >>> controller = rs.control.design(plant)
        >>> "u" in controller.difference_equation().text()
        True
        """
        return DifferenceEquation(self.transfer_function, *limits)

    def export_c(self, path: str | PathLike[str] | None = None, *, limits: tuple[float, float] = _NO_LIMITS) -> str:
        """The controller as C99 without dependencies, with its self-test; written to `path` when one is given.

        Parameters
        ----------
        path : str or path
        limits : (lower, upper)
            Of the actuator, in the unit of the plant's input.

        Returns
        -------
        str

        Raises
        ------
        BadInput
            A folder that does not exist; a lower limit that is not below the upper one.

        Examples
        --------
        >>> import residuum as rs
        >>> plant = rs.identify(rs.simulate("process-plant", seed=1), input="u", output="y", method="arx", order=2)
        >>> controller = rs.control.design(plant)
        >>> "controller_step" in controller.export_c(limits=(-10.0, 10.0))
        True
        """
        return self._exported("c", path, limits)

    def export_structured_text(self, path: str | PathLike[str] | None = None, *, limits: tuple[float, float] = _NO_LIMITS) -> str:
        """The controller as IEC 61131-3 structured text; `path` and `limits` as in `export_c`.

        Parameters
        ----------
        path : str or path
        limits : (lower, upper)
            Of the actuator, in the unit of the plant's input.

        Returns
        -------
        str

        Raises
        ------
        BadInput
            As `export_c`.

        Examples
        --------
        >>> import residuum as rs
        >>> plant = rs.identify(rs.simulate("process-plant", seed=1), input="u", output="y", method="arx", order=2)
        >>> controller = rs.control.design(plant)
        >>> "END_FUNCTION_BLOCK" in controller.export_structured_text()
        True
        """
        return self._exported("st", path, limits)

    def _exported(self, language: str, path: str | PathLike[str] | None, limits: tuple[float, float]) -> str:
        text = LANGUAGES[language](self.difference_equation(limits))
        if path is not None:
            write_whole(Path(path), text)
        return text

    def _answer(self) -> dict[str, Any]:
        described = {"aim": self.aim, "structure": self.structure, "models": list(self.plants)}
        answer = described | design_json(self.found, self.wishes.names, self.figures, self.problem)
        answer |= self.problem.nominal_plants() | {"samples": self.problem.choice.samples}
        answer |= promise_and_measurement(self.found, self.wishes, self.measured)
        return answer | {"file": None, "difference_equation": self.difference_equation().text()}

    def __str__(self) -> str:
        return design_text(self._answer())

    def __repr__(self) -> str:
        return f"<residuum Controller {self.structure}: {', '.join(f'{n} = {v:.4g}' for n, v in self.parameters.items())}>"

    def _rows(self) -> Sequence[Row]:
        return [{"parameter": name, "value": value} for name, value in self.parameters.items()]

    def _picture(self) -> Picture:
        duration = min(self.problem.horizon, 3.0 * float(np.median([figure.settling_time for figure in self.figures])))
        duration = duration if math.isfinite(duration) and duration > 0 else self.problem.horizon
        nominal = self._step(self.problem.plant, duration)
        drawn = np.array([self._step(plant, duration)[: len(nominal)] for plant in self.problem.random_plants()[:_SHOWN_PLANTS]])
        time = float(self.problem.plant.sample_time or 1.0) * np.arange(len(nominal))
        curve = Curve("closed loop", time, nominal, drawn.min(axis=0), drawn.max(axis=0))
        return Picture([Panel("step of the reference, and plants drawn", "time [s]", "output", [curve])])

    def _step(self, plant: TransferFunction, duration: float) -> np.ndarray[Any, np.dtype[np.float64]]:
        return step_response(plant, self.transfer_function, duration)


def design(
    plants: Plant | str | PathLike[str] | Sequence[Plant | str | PathLike[str]],
    *,
    aim: str = "nominal",
    structure: str = "pidn",
    overshoot: float = 0.01,
    settling_time: float | None = None,
    slack: float = 0.1,
    only: str | None = None,
    in_time: bool = False,
    low_gain: float = 120.0,
    high_gain: float = -50.0,
    critical_frequency: float | None = None,
    joined: Plant | str | PathLike[str] | None = None,
    weight: WeightChoice | None = None,
    fix: Mapping[str, float] | None = None,
    within: Mapping[str, tuple[float, float]] | None = None,
    seed: int = 0,
) -> Controller:
    """A controller of fixed structure that keeps its promise for every plant that the data do not exclude.

    Parameters
    ----------
    plants : Plant, file, or a list of these
        One an operating point, of one sample time.
    aim : str
        `nominal` (performance of the plant in the middle, Algorithm 2) or `robust` (of all of them, Algorithm 3).
    structure : str
        `pidn`, `pid`, `pi`, `lead-lag` or `rational`.
    overshoot : float
        Nominal aim: the least that is worth having (0.01 = 1 %).
    settling_time : float
        Nominal aim: the longest [s]; None: ten times the longest impulse response.
    slack : float
        Nominal aim: γ of the mixed-sensitivity bound 1 + γ.
    only : str
        One wish alone: `overshoot` or `settling-time`; with the robust aim `high-gain` or `critical-frequency`.
    in_time : bool
        Nominal aim: overshoot and settling time hold in time, on the nominal loop and 95 % of the drawn plants.
    low_gain, high_gain : float
        Robust aim: l_g, and the smallest h_g, of the performance weight [dB].
    critical_frequency : float
        Robust aim: the lowest ω_c [rad/s]; None: a thousandth of where |W_T| reaches 1.
    joined : Plant or file
        The nominal plant: one model of all operating points' records; None: the models' mean.
    weight : WeightChoice
        ε, ζ, the rule of the number of plants, the order and the grid of the uncertainty weight; None: the defaults.
    fix, within : mapping of name to value, or to (low, high)
        Parameters of the controller to hold, or to keep between limits.
    seed : int
        Of the drawn plants.

    Returns
    -------
    Controller

    Raises
    ------
    Infeasible
        No controller of the structure meets the aim; says which constraint, where and by how much.
    BadInput
        An unknown aim or structure, different sample times, an uncertainty over 100 % at the lowest frequency.

    Examples
    --------
    See `Controller`.

    >>> import residuum as rs
    >>> plant = rs.identify(rs.simulate("process-plant", seed=1), input="u", output="y", method="arx", order=2)
    >>> rs.control.design(plant, structure="pi").structure
    'pi'
    """
    if structure not in STRUCTURES:
        raise BadInput(f"structure {structure!r}: there is none of this name; {known_names(structure, STRUCTURES)}")
    wishes = Wishes(aim, overshoot, settling_time, slack, only, in_time, low_gain, high_gain, critical_frequency)
    given: list[Plant | str | PathLike[str]] = [plants] if isinstance(plants, Plant | str | PathLike) else list(plants)
    loaded = [plant if isinstance(plant, Plant) else load_plant(plant) for plant in given]
    names = [_described(plant) if isinstance(plant, Plant) else str(plant) for plant in given]
    middle = joined if joined is None or isinstance(joined, Plant) else load_plant(joined)
    nominal = None if middle is None else middle.identified
    problem = ControlProblem([plant.identified for plant in loaded], seed, joined=nominal, weight=weight)
    law: ControllerStructure = STRUCTURES[structure](problem.loop.sample_time)
    if fix or within:
        law = Constrained(law, fixed=dict(fix or {}), within=dict(within or {}))
    return Controller(structure, aim, tuple(names), problem, wishes, problem.solve(law, wishes))


def _described(plant: Plant) -> str:
    return f"{plant.identified.input_name} → {plant.identified.output_name}"
