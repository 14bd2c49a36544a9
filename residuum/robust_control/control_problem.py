"""A control problem from identified models, and its solution by Algorithm 2 or 3, for the console
and the page.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from residuum.array_types import FloatArray
from residuum.identification.blas_threads import LARGEST_FOR_ONE_THREAD, one_thread_if_small
from residuum.identification.errors import BadInput
from residuum.identification.linear_models.error_bounds.error_models import (
    DrawnErrors,
    refined_grid,
)
from residuum.identification.linear_models.identified_model import IdentifiedModel
from residuum.identification.linear_models.transfer_function import TransferFunction
from residuum.identification.linear_models.uncertainty import (
    SAMPLE_SIZE_RULES,
    chernoff_samples,
    weight_above,
)
from residuum.robust_control.certificates import (
    Measured,
    RobustAim,
    design_for_robust_performance,
    measured,
)
from residuum.robust_control.loop import Loop, Weights, frequency_grid
from residuum.robust_control.synthesis.constrained_structure import (
    PI,
    PID,
    PIDN,
    ControllerStructure,
    LeadLag,
    Point,
    Rational,
)
from residuum.robust_control.synthesis.structured_synthesis import Synthesis
from residuum.robust_control.synthesis.time_domain_design import TimeAim, design_in_time
from residuum.robust_control.weights.performance_weight import (
    MonotoneWeight,
    NominalAim,
    ReferenceModel,
    design_for_nominal_performance,
)

# Several operating points as one uncertain system: average model and overall weight (Algorithm
# 4).


def average_plant(models: Sequence[IdentifiedModel]) -> TransferFunction:
    """The plant in the middle: one model's own, or the mean impulse response of several, as an FIR
    system.

    An experiment that joins the configurations identifies this same mean (footnote 3 of chapter 3
    of the source).

    Raises BadInput for no model or different sample times.
    """
    if not models:
        raise BadInput("average plant: no identified model was given")
    steps = {model.sample_time for model in models}
    if len(steps) > 1:
        raise BadInput(
            f"average plant: models have sample times {sorted(steps)}; all must be equal; identify"
            " them from records of one rate"
        )
    if len(models) == 1:
        return models[0].transfer_function()
    length = max(model.delay + model.order for model in models)
    mean = np.zeros(length)
    for model in models:
        mean[model.delay : model.delay + model.order] += model.impulse_response / len(models)
    return TransferFunction(mean, np.r_[1.0, np.zeros(length - 1)], models[0].sample_time)


@one_thread_if_small(LARGEST_FOR_ONE_THREAD)
def overall_uncertainty(
    models: Sequence[IdentifiedModel],
    average: TransferFunction,
    omega: FloatArray,
    *,
    n_samples: int | None = None,
    order: int | None = 2,
    seed: int = 0,
) -> tuple[TransferFunction, FloatArray]:
    """(Ŵ_T(z), Ω): a weight above the largest relative error of random plants of every model,
    (3.2).

    Ω is returned on `omega`; the weight lies above it between these frequencies too
    (`weight_above`).

    Parameters
    ----------
    n_samples : int or None
        Random plants in all, shared equally; None: (2.24) at ε = ζ = 0.05, 738.
    """
    share = int(np.ceil((n_samples or chernoff_samples(0.05, 0.95)) / len(models)))
    nominal = average.frequency_response(omega)
    if np.any(np.abs(nominal) < 1e-12 * np.abs(nominal).max()):
        raise BadInput(
            "overall uncertainty: the average plant has a zero on the grid, where a relative error"
            " means nothing"
        )
    sample_time = float(average.sample_time or 0.0)
    lag = len(average.den) - len(average.num)
    middle = np.r_[np.zeros(lag), average.num][None], np.trim_zeros(average.den, "b")[None]
    errors = DrawnErrors.joined(
        [
            DrawnErrors.of(
                model.sample_polynomials(share, np.random.default_rng([seed, number])),
                middle,
                sample_time,
                "multiplicative",
            )
            for number, model in enumerate(models)
        ]
    )
    grid, largest = refined_grid(
        errors.envelope, average.frequency_response, errors.lags, sample_time, omega
    )
    weight, _ = weight_above(errors, grid, largest, order)
    return weight, largest[np.searchsorted(grid, omega)]


AIMS = ("nominal", "robust")
STRUCTURES: dict[str, type[ControllerStructure]] = {
    "pidn": PIDN,
    "pid": PID,
    "pi": PI,
    "lead-lag": LeadLag,
    "rational": Rational,
}
_VALIDATION_PLANTS = 200  # that a design is held against at first
# four times as many where these do not tell its figures narrowly enough, at most so many
_MORE_PLANTS, _MOST_PLANTS = 4, 12_800
_PROMISED_SHARE = 0.95  # of the plants, that a promise is made for
# drawn plants that a search in time follows, and others that its promise is read from
_PLANTS_IN_SEARCH, _PLANTS_OF_PROMISE = 100, 400
_MORE_ORDER = 2  # of the weight, where one of the chosen order does not do
# steps are followed for so many of the settling times that are asked for or promised
_FOLLOWED = 1.5


@dataclass(frozen=True)
class Wishes:
    """What the user asks of the loop; the first three belong to the nominal aim.

    Parameters
    ----------
    aim : str
        `nominal` (Algorithm 2) or `robust` (Algorithm 3).
    overshoot : float
        Least overshoot that is worth having (0.01 = 1 %).
    settling_time : float or None
        Longest settling time [s]; None: ten times the longest impulse response.
    slack : float
        γ of the mixed-sensitivity bound 1 + γ.
    only : str or None
        One wish alone (Remark 2.7).
    low_gain, high_gain, critical_frequency : float
        robust: l_g, h_g,min [dB] and ω_c,min [rad/s] of (2.37); the last None: a thousandth of
        where |W_T| reaches 1.
    in_time : bool
        nominal: overshoot and settling time are limits on step responses, not parameters of a
        weight (`design_in_time`).
    """

    aim: str = "nominal"
    overshoot: float = 0.01
    settling_time: float | None = None
    slack: float = 0.1
    only: str | None = None
    in_time: bool = False
    low_gain: float = 120.0
    high_gain: float = -50.0
    critical_frequency: float | None = None

    @property
    def names(self) -> tuple[str, str]:
        """What the two coordinates of the Pareto front are."""
        return (
            ("overshoot", "settling_time_s")
            if self.aim == "nominal"
            else ("high_gain_db", "critical_frequency_rad_s")
        )

    @property
    def limit(self) -> float:
        """What the cost must stay below."""
        return 1.0 + self.slack if self.aim == "nominal" else 1.0


@dataclass(frozen=True)
class WeightChoice:
    """How the uncertainty weight is made: ε, ζ and the rule of the number of plants, its order, and
    the grid's frequencies.
    """

    epsilon: float = 0.05
    zeta: float = 0.05
    rule: str = "chernoff"
    weight_order: int = 2
    points: int = 600
    lowest: float | None = None

    @property
    def samples(self) -> int:
        """Random plants in all."""
        return SAMPLE_SIZE_RULES[self.rule](self.epsilon, 1 - self.zeta)


@dataclass(frozen=True, eq=False)
class Solution:
    """The chosen point of the Pareto front, and the whole front."""

    chosen: Point[Synthesis]
    front: tuple[Point[Synthesis], ...]


class ControlProblem:
    """The plant in the middle, the weight of its uncertainty, and the grid on which a controller is
    sought.

    A controller cannot answer a measurement within the sample in which the input already moves it:
    the loop of a plant that acts at once (a model with delay 0) would be algebraic, and any gain
    would look stable. Such plants are met one sample later.

    Parameters
    ----------
    models : sequence of IdentifiedModel
        One an operating point, of one sample time.
    seed : int
        Of the random plants.
    joined : IdentifiedModel or None
        One model of the data of all operating points, the nominal plant of Algorithm 4 as the
        source has it; None: the mean of the models' impulse responses.
    weight : WeightChoice

    Attributes
    ----------
    computation_samples : int
        1 where a plant acts at once and every model is taken one sample later, else 0.
    W_T : TransferFunction
    largest : array
        Ω, the largest relative error of the drawn plants on the grid `loop.omega`.
    magnitude : array
        |W_T| on the grid.
    crossing : float
        Where |W_T| reaches 1 [rad/s]; the end of the grid when it does not.

    Raises
    ------
    BadInput
        No model, one that is unfit for control, different sample times, an uncertainty of over 100
        % at the lowest frequency.
    """

    def __init__(
        self,
        models: Sequence[IdentifiedModel],
        seed: int = 0,
        *,
        joined: IdentifiedModel | None = None,
        weight: WeightChoice | None = None,
    ) -> None:
        every = [*models] if joined is None else [*models, joined]
        _refuse_unfit(every)
        self.computation_samples = int(any(model.delay < 1 for model in every))
        if self.computation_samples:
            models = [model.one_sample_later() for model in models]
            joined = None if joined is None else joined.one_sample_later()
        self.models, self.seed, self.joined, self.choice = (
            tuple(models),
            seed,
            joined,
            weight or WeightChoice(),
        )
        # refuses unequal sample times
        mean = average_plant([*models] if joined is None else [*models, joined])
        self.plant = mean if joined is None else joined.transfer_function()
        omega = frequency_grid([self.plant], points=self.choice.points, lowest=self.choice.lowest)
        self.W_T, self.largest = self._uncertainty(self.plant, omega)
        self.loop = Loop([self.plant], omega)
        self.magnitude = np.abs(self.W_T.frequency_response(omega))
        self.crossing = critical_frequency(omega, self.magnitude)

    def _uncertainty(
        self, plant: TransferFunction, omega: FloatArray
    ) -> tuple[TransferFunction, FloatArray]:
        """W_T and Ω; two orders more where the fit alone, not Ω, is over 100 % at the lowest
        frequency.
        """
        for order in (self.choice.weight_order, self.choice.weight_order + _MORE_ORDER):
            W_T, largest = overall_uncertainty(
                self.models,
                plant,
                omega,
                n_samples=self.choice.samples,
                order=order,
                seed=self.seed,
            )
            if largest[0] >= 1.0 or abs(W_T.frequency_response(omega[:1])[0]) < 1.0:
                break
        return W_T, largest

    def nominal_plants(self) -> dict[str, Any]:
        """The largest uncertainty about the joined model and about the models' mean, and which of
        them is the nominal plant.
        """
        mean = average_plant(self.models)
        about_mean = (
            None
            if self.joined is None
            else float(self._uncertainty(mean, frequency_grid([mean]))[1].max())
        )
        largest = float(self.largest.max())
        about = (
            {"joined": None, "mean": largest}
            if self.joined is None
            else {"joined": largest, "mean": about_mean}
        )
        return {
            "nominal": "mean" if self.joined is None else "joined",
            "largest_uncertainty_about": about,
            "computation_samples": self.computation_samples,
        }

    @property
    def response_time(self) -> float:
        """Ten times the length of the longest impulse response [s]."""
        return 10.0 * max((model.delay + model.order) * model.sample_time for model in self.models)

    @property
    def horizon(self) -> float:
        """How long step responses are followed [s]."""
        return 0.4 * self.response_time

    def solve(self, law: ControllerStructure, wishes: Wishes) -> Solution:
        """Algorithm 2 or 3 with this controller structure.

        Raises
        ------
        Infeasible
            No controller of the structure meets the aim; says which constraint, where and by how
            much.
        """
        if wishes.in_time:
            return self._in_time(law, wishes)
        if wishes.aim == "nominal":
            longest = self.response_time if wishes.settling_time is None else wishes.settling_time
            wanted = NominalAim(wishes.overshoot, longest, wishes.slack, only=wishes.only)
            nominal = design_for_nominal_performance(
                self.loop, self.magnitude, law, wanted, self.crossing
            )
            return Solution(nominal.chosen, nominal.front)
        aim = self._robust_aim(wishes)
        robust = design_for_robust_performance(self.loop, self.magnitude, law, aim, self.crossing)
        return Solution(robust.chosen, robust.front)

    def weights(self, wishes: Wishes, point: Point[Synthesis]) -> Weights:
        """The weights that a point of the front was designed with."""
        if wishes.aim == "nominal":
            W_S = ReferenceModel(point.first, point.second).weight_magnitude(self.loop.omega)
            return Weights(W_S, self.magnitude)
        gain = self._robust_aim(wishes).low_gain_db
        return Weights(
            MonotoneWeight(gain, point.first, point.second).magnitude(self.loop.omega),
            self.magnitude,
            "1",
        )

    def _in_time(self, law: ControllerStructure, wishes: Wishes) -> Solution:
        limit = self.horizon / _FOLLOWED if wishes.settling_time is None else wishes.settling_time
        aim = TimeAim(wishes.overshoot, limit)
        # Streams of their own: the plants that are searched with, those that a promise is read from
        # and those that it is measured on are others.
        plants = self.random_plants(_PLANTS_IN_SEARCH, stream=2)
        mixed = [plants[k] for k in np.random.default_rng(self.seed).permutation(len(plants))]
        held_out = self.random_plants(_PLANTS_OF_PROMISE, stream=3)
        timed = design_in_time(self.loop, mixed, held_out, self.magnitude, law, aim, self.crossing)
        chosen = Point(wishes.overshoot, timed.settling_time, timed.design)
        return Solution(chosen, (chosen,))

    def measured(self, solution: Solution, wishes: Wishes) -> Measured:
        """Step responses of the nominal loop and of plants that no design has seen.

        So many are drawn that what 95 % of them stay below is known to a tenth of itself: 200, and
        four times as many until it is, at most 12 800. Where a few plants settle one swing later
        than the others, that quantile of 200 is off by half.
        """
        duration = (
            max(self.horizon, _FOLLOWED * solution.chosen.second)
            if wishes.aim == "nominal"
            else self.horizon
        )
        count = _VALIDATION_PLANTS
        while True:
            steps = measured(
                self.plant, self.random_plants(count), solution.chosen.design.controller, duration
            )
            if count >= _MOST_PLANTS or steps.is_sure_of(_PROMISED_SHARE, self.loop.sample_time):
                return steps
            count *= _MORE_PLANTS

    def random_plants(
        self, count: int = _VALIDATION_PLANTS, stream: int = 1
    ) -> list[TransferFunction]:
        """Plants of every model's posterior, other ones than the weight was made from; another
        `stream`, others.
        """
        plants = []
        share = math.ceil(count / len(self.models))
        for number, model in enumerate(self.models):
            den = np.r_[1.0, np.zeros(model.delay + model.reach - 1)]
            drawn = model.sample_longer(share, np.random.default_rng([self.seed, stream, number]))
            plants += [TransferFunction(g, den, model.sample_time) for g in drawn]
        return plants

    def _robust_aim(self, wishes: Wishes) -> RobustAim:
        lowest = (
            self.crossing / 1000.0
            if wishes.critical_frequency is None
            else wishes.critical_frequency
        )
        return RobustAim(
            wishes.low_gain, wishes.high_gain, lowest_critical_frequency=lowest, only=wishes.only
        )


def _refuse_unfit(models: Sequence[IdentifiedModel]) -> None:
    """Promise nothing for a model that its own record speaks against."""
    for model in models:
        if model.unfit:
            label = f"model {model.method} from {model.input_name!r} to {model.output_name!r}"
            raise BadInput(f"{label}: no controller is promised for it: {model.unfit[0]}")


def critical_frequency(omega: FloatArray, magnitude: FloatArray) -> float:
    """Where an uncertainty reaches 1 [rad/s], or the grid's end; BadInput when it is larger from
    the beginning.
    """
    above = np.flatnonzero(magnitude >= 1.0)
    if above.size and above[0] == 0:
        raise BadInput(
            "uncertainty: over 100 % already at the lowest frequency; identify with more or better"
            " data first"
        )
    return float(omega[above[0]] if above.size else omega[-1])
