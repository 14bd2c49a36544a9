"""`rs.control`: robust controllers of fixed structure from identified plants."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from residuum.identification.errors import BadInput
from residuum.identification.kernel_based.multivariable import load_multivariable
from residuum.identification.linear_models.identified_model import IdentifiedModel
from residuum.identification.linear_models.transfer_function import TransferFunction
from residuum.library.answers.control_design import (
    design_json,
    design_text,
    promise_and_measurement,
)
from residuum.library.answers.multivariable_control import design_json as multivariable_json
from residuum.library.answers.plain import to_plain
from residuum.library.picture import Curve, Panel, Picture
from residuum.library.plant import Plant, plant_of, to_control
from residuum.library.questions import asks
from residuum.library.questions.control_design import DesignController
from residuum.library.result import Result, Row
from residuum.library.whole_file import write_whole
from residuum.robust_control.certificates import Measured, StepResponse, step_response
from residuum.robust_control.control_problem import (
    STRUCTURES,
    ControlProblem,
    Solution,
    WeightChoice,
    Wishes,
)
from residuum.robust_control.controller_export import LANGUAGES, DifferenceEquation
from residuum.robust_control.multivariable_control import MultivariableProblem
from residuum.robust_control.synthesis.constrained_structure import Constrained, ControllerStructure
from residuum.robust_control.weights.performance_weight import Infeasible

__all__ = ["Controller", "Infeasible", "design"]

# Drawn plants whose steps are drawn as a range.
_SHOWN_PLANTS = 20
_NO_LIMITS = (-math.inf, math.inf)


@dataclass(frozen=True, eq=False, repr=False)
class Controller(Result):
    """A discrete-time controller with what it promises for the plant and for plants that the data
    do not exclude.

    Attributes
    ----------
    structure, aim : str
    plants : tuple of str
        What it was designed for.
    problem, found
        The control problem (plant, weights, grid), and the Pareto front with the point that was
        chosen.
    limits : (lower, upper)
        Of the actuator, in exported code.

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
    limits: tuple[float, float] = _NO_LIMITS

    @property
    def transfer_function(self) -> TransferFunction:
        """K(z), from control error to control signal."""
        return self.found.chosen.design.controller

    @property
    def parameters(self) -> dict[str, float]:
        """The structure's parameters by name."""
        synthesis = self.found.chosen.design
        return dict(zip(synthesis.structure.names, synthesis.rho.tolist(), strict=True))

    # Hundreds of plants are followed for it, and text, JSON and picture each ask.
    @cached_property
    def measured(self) -> Measured:
        """Step responses of the nominal loop, and of 200 or more plants drawn from their
        uncertainty that no design has seen.
        """
        return self.problem.measured(self.found, self.wishes)

    @property
    def figures(self) -> list[StepResponse]:
        """Overshoot, settling time and integral absolute error of the drawn plants."""
        return list(self.measured.drawn)

    def to_control(self) -> Any:
        """K(z) as a python-control `TransferFunction`; MissingPackage when `control` is not
        installed.

        Returns
        -------
        control.TransferFunction

        Examples
        --------
        >>> import residuum as rs
        >>> record = rs.simulate("process-plant", seed=1)
        >>> plant = rs.identify(record, input="u", output="y", method="arx", order=2)
        >>> controller = rs.control.design(plant)
        >>> type(controller.to_control()).__name__
        'TransferFunction'
        """
        return to_control(self.transfer_function)

    def difference_equation(self, limits: tuple[float, float] | None = None) -> DifferenceEquation:
        """What the target computes each sample; `limits` of the actuator are kept without wind-up.

        Parameters
        ----------
        limits : (lower, upper)
            Of the actuator, in the unit of the plant's input; None: those it was designed with.

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
        >>> record = rs.simulate("process-plant", seed=1)
        >>> plant = rs.identify(record, input="u", output="y", method="arx", order=2)
        >>> controller = rs.control.design(plant)
        >>> "u" in controller.difference_equation().text()
        True
        """
        return DifferenceEquation(
            self.transfer_function, *(self.limits if limits is None else limits)
        )

    def export_c(
        self, path: str | PathLike[str] | None = None, *, limits: tuple[float, float] | None = None
    ) -> str:
        """The controller as C99 without dependencies, with its self-test; written to `path` when
        one is given.

        Parameters
        ----------
        path : str or path
        limits : (lower, upper)
            Of the actuator, in the unit of the plant's input; None: those it was designed with.

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
        >>> record = rs.simulate("process-plant", seed=1)
        >>> plant = rs.identify(record, input="u", output="y", method="arx", order=2)
        >>> controller = rs.control.design(plant)
        >>> "controller_step" in controller.export_c(limits=(-10.0, 10.0))
        True
        """
        return self._exported("c", path, limits)

    def export_structured_text(
        self, path: str | PathLike[str] | None = None, *, limits: tuple[float, float] | None = None
    ) -> str:
        """The controller as IEC 61131-3 structured text; `path` and `limits` as in `export_c`.

        Parameters
        ----------
        path : str or path
        limits : (lower, upper)
            Of the actuator, in the unit of the plant's input; None: those it was designed with.

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
        >>> record = rs.simulate("process-plant", seed=1)
        >>> plant = rs.identify(record, input="u", output="y", method="arx", order=2)
        >>> controller = rs.control.design(plant)
        >>> "END_FUNCTION_BLOCK" in controller.export_structured_text()
        True
        """
        return self._exported("st", path, limits)

    def _exported(
        self, language: str, path: str | PathLike[str] | None, limits: tuple[float, float] | None
    ) -> str:
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
        return (
            f"<residuum Controller {self.structure}:"
            f" {', '.join(f'{n} = {v:.4g}' for n, v in self.parameters.items())}>"
        )

    def _rows(self) -> Sequence[Row]:
        return [{"parameter": name, "value": value} for name, value in self.parameters.items()]

    def _picture(self) -> Picture:
        # Three median settling times, or the horizon that the figures were taken over.
        duration = min(
            self.problem.horizon,
            3.0 * float(np.median([figure.settling_time for figure in self.figures])),
        )
        # Plants that never settle have no settling time by which to choose the picture's end.
        duration = duration if math.isfinite(duration) and duration > 0 else self.problem.horizon
        nominal = self._step(self.problem.plant, duration)
        drawn = np.array(
            [
                self._step(plant, duration)[: len(nominal)]
                for plant in self.problem.random_plants()[:_SHOWN_PLANTS]
            ]
        )
        time = float(self.problem.plant.sample_time or 1.0) * np.arange(len(nominal))
        # A range, not a band of chance: the lowest and highest of the drawn plants at each instant.
        curve = Curve("closed loop", time, nominal, drawn.min(axis=0), drawn.max(axis=0))
        return Picture(
            [Panel("step of the reference, and plants drawn", "time [s]", "output", [curve])]
        )

    def _step(
        self, plant: TransferFunction, duration: float
    ) -> np.ndarray[Any, np.dtype[np.float64]]:
        return step_response(plant, self.transfer_function, duration)


@asks(DesignController)
def design(
    plants: Plant | str | PathLike[str] | Sequence[Plant | str | PathLike[str]],
    *,
    joined: Plant | str | PathLike[str] | None = None,
    **given: Any,
) -> Controller:
    """A controller of fixed structure that keeps its promise for every plant that the data do not
    exclude.

    Parameters
    ----------
    plants : Plant, file, or a list of these
        One an operating point, of one sample time.
    joined : Plant or file
        The nominal plant: one model of all operating points' records; None: the models' mean.

    Returns
    -------
    Controller

    Raises
    ------
    Infeasible
        No controller of the structure meets the aim; says which constraint, where and by how much.
    BadInput
        An unknown aim or structure, different sample times, an uncertainty over 100 % at the lowest
        frequency.

    Examples
    --------
    See `Controller`.

    >>> import residuum as rs
    >>> record = rs.simulate("process-plant", seed=1)
    >>> plant = rs.identify(record, input="u", output="y", method="arx", order=2)
    >>> rs.control.design(plant, structure="pi").structure
    'pi'
    """
    asked = DesignController.of(given)
    listed: list[Plant | str | PathLike[str]] = (
        [plants] if isinstance(plants, Plant | str | PathLike) else list(plants)
    )
    names = [_described(plant) if isinstance(plant, Plant) else str(plant) for plant in listed]
    middle = None if joined is None else plant_of(joined).identified
    return designed(names, [plant_of(plant).identified for plant in listed], middle, asked)


def designed(
    names: Sequence[str],
    models: Sequence[IdentifiedModel],
    joined: IdentifiedModel | None,
    asked: DesignController,
) -> Controller:
    """The controller for models of these names; `joined` as in `design`."""
    problem = posed(models, joined, asked)
    wishes = asked.handed_to(Wishes)
    return Controller(
        asked.structure,
        asked.aim,
        tuple(names),
        problem,
        wishes,
        problem.solve(law(problem, asked), wishes),
        asked.actuator,
    )


def posed(
    models: Sequence[IdentifiedModel], joined: IdentifiedModel | None, asked: DesignController
) -> ControlProblem:
    """The control problem that is asked."""
    return ControlProblem(models, asked.seed, joined=joined, weight=asked.handed_to(WeightChoice))


def law(problem: ControlProblem, asked: DesignController) -> ControllerStructure:
    """The structure whose parameters are sought, those that are held or kept between limits among
    them.
    """
    whole: ControllerStructure = STRUCTURES[asked.structure](problem.loop.sample_time)
    return (
        Constrained(whole, fixed=asked.fix, within=asked.within)
        if asked.fix or asked.within
        else whole
    )


def _described(plant: Plant) -> str:
    return f"{plant.identified.input_name} → {plant.identified.output_name}"


def design_multivariable(file: str | PathLike[str], asked: DesignController) -> dict[str, Any]:
    """The `control design` object: a static decoupler, and a controller of the structure for every
    output.

    Raises
    ------
    BadInput, BadModel
        Another aim than the nominal one, what single loops have alone, a file or plant that does
        not suit.
    Infeasible
        No controller of the structure meets the aim in a loop.
    """
    for name in ("fix", "within", "limits"):
        if getattr(asked, name):
            raise BadInput("", name, "is for a plant of one input and one output; leave it out")
    problem = MultivariableProblem(
        load_multivariable(str(file)), asked.seed, asked.handed_to(WeightChoice)
    )
    design = problem.solve(
        STRUCTURES[asked.structure](problem.sample_time), asked.handed_to(Wishes)
    )
    described = {"aim": "nominal", "structure": asked.structure, "models": [str(file)]}
    plain: dict[str, Any] = to_plain(
        described | multivariable_json(problem, design) | {"file": None}
    )
    return plain
