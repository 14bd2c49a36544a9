"""What a record and data kept aside say against an identified model, in sentences that tell what to
do instead.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from residuum.identification.errors import BadInput, NotIdentifiable
from residuum.identification.linear_models.identified_model import IdentifiedModel
from residuum.identification.linear_models.plant_tests import (
    KEPT_ASIDE,
    LONG_REACH,
    ExcitationTest,
    FeedbackTest,
    IntegratorTest,
    KeptAside,
    UnstableTest,
    dead_time,
    excitation_test,
    feedback_test,
    integrator_test,
    kept_aside,
    long_autoregression,
    unstable_test,
)
from residuum.identification.linear_models.prediction_error import STRUCTURES
from residuum.identification.linear_models.prediction_error.regularised_regression import PENALTIES
from residuum.identification.linear_models.validation import (
    LEVEL,
    BlockBootstrap,
    ModelErrorModel,
    ResidualCheck,
    ResidualTest,
    block_bootstrap,
    residual_check,
)
from residuum.identification.record import Record
from residuum.library.identification_methods import NOISE_MODELLED, identified_by
from residuum.library.questions.identify import LAGS, Identify

# Fit on data kept aside [%] below which a model that nothing is said against gets a remark.
_POOR_FIT = 50.0
# Methods whose poles may lie outside the unit circle, and whose predictor is stable there.
_MAY_BE_UNSTABLE = ("arx", "armax", "ar")
# How the sentence begins, by which the model's own warning of the same is known below.
_EXCITES = "the input is persistently exciting"
# Share of the static gain that the model may put later than the records go on.
_NOT_OVER = 0.05
# Samples that the fit of the first part sees, that are judged after it, and of the past at least
# that the judged ones are simulated from.
_MOST_REFITTED, _MOST_JUDGED, _BEFORE = 20_000, 8_000, 1000
# Directions that a record has to tell for a response without an order to be more than its prior.
_FEW = 6
# Designs are for stable plants. A loop that holds an unstable or integrating one is a stable plant,
# seen from its set point.
_ANOTHER_RECORD = (
    "for a controller record steps of the set point of a loop that holds it (a proportional one is"
    " enough), and identify from set point to output"
)


@dataclass(frozen=True)
class Assumptions:
    """What was tested; None where the record is too short to tell.

    Attributes
    ----------
    integrator, feedback : IntegratorTest, FeedbackTest
    dead_time : int
        Samples before the input acts.
    aside : tuple of KeptAside
        One a record: of this model where a split note kept data aside, else of a fit of the first
        part on the last.
    late : bool
        Whether the input acts later than the model's last input lag, and the model misses it.
    unstable : UnstableTest
    excitation : ExcitationTest
    needed : int
        To which order the input has to excite for the parameters of this model to be told.
    """

    integrator: IntegratorTest | None
    feedback: FeedbackTest | None
    dead_time: int | None
    aside: tuple[KeptAside, ...]
    late: bool = False
    unstable: UnstableTest | None = None
    excitation: ExcitationTest | None = None
    needed: int = 0

    @property
    def worst(self) -> KeptAside | None:
        """The part kept aside on which the fit is poorest."""
        return min(self.aside, key=lambda part: part.fit_percent, default=None)

    @property
    def tells_model(self) -> bool:
        """Whether the input excites to the order that the model needs."""
        # The test finds no order above its number of lags.
        return self.excitation is None or self.excitation.order >= min(
            self.needed, self.excitation.lags
        )

    def _excitation_json(self, test: ExcitationTest) -> dict[str, Any]:
        return asdict(test) | {
            "needed": self.needed,
            "tells_model": self.tells_model,
            "tells_gain": test.tells_gain,
        }

    def to_dict(self) -> dict[str, Any]:
        """As JSON."""
        integrator, feedback = self.integrator, self.feedback
        return {
            "integrator": (
                None
                if integrator is None
                else asdict(integrator) | {"present": integrator.integrates}
            ),
            "feedback": (
                None if feedback is None else asdict(feedback) | {"present": feedback.present}
            ),
            "dead_time": {"samples": self.dead_time, "beyond_order": self.late},
            "unstable": None if self.unstable is None else _unstable_json(self.unstable),
            "excitation": (
                None if self.excitation is None else self._excitation_json(self.excitation)
            ),
            "kept_aside": [asdict(part) | {"fails": part.fails} for part in self.aside],
        }


def _unstable_json(test: UnstableTest) -> dict[str, Any]:
    return {"present": test.unstable, "pole_size": abs(test.pole), "spread": test.spread}


def assumptions(
    model: IdentifiedModel,
    asked: Identify,
    estimation: Sequence[Record],
    parts: Sequence[Part],
    plant: PlantTests,
) -> Assumptions:
    """Test the records that a model with an input was identified from, and the model on
    `parts_kept_aside`.

    `plant` is what `plant_tests` found before; where the model's delay differs from the one that
    was assumed they are done again.
    """
    # A plant that answers within the sample is tested from lag 0 on, any other from lag 1.
    if plant.first_lag != min(model.delay, 1):
        plant = plant_tests(estimation, asked, model.delay)
    integrator, feedback, dead, unstable = (
        plant.integrator,
        plant.feedback,
        plant.dead_time,
        plant.unstable,
    )
    try:
        excitation = excitation_test(
            estimation, asked.input_name, asked.output_name, min(model.delay, 1)
        )
    except BadInput:
        excitation = None  # too short to tell
    aside = _aside(parts)
    late = (
        dead is not None
        and dead > _last_input_lag(model, asked)
        and any(part.fails for part in aside)
    )
    return Assumptions(
        integrator, feedback, dead, aside, late, unstable, excitation, _needed(model, asked.method)
    )


def with_remarks(
    model: IdentifiedModel, method: str, tests: Assumptions, estimation: Sequence[Record]
) -> IdentifiedModel:
    """The model with what was found: as warnings, and as unfit where no controller may be promised
    for it.
    """
    untold = _untold(model, tests, estimation)
    unfit = [
        *_unstable(model, tests),
        *untold,
        *_integrating(model, tests),
        *_biased(method, tests),
    ]
    remarks = _remarks(method, tests, trusted=not unfit)
    # Where the excitation is told here, with its order, the model's own warning of it goes.
    own = [
        text
        for text in model.warnings
        if not (untold and text.startswith(untold[0][: len(_EXCITES)]))
    ]
    return replace(model, warnings=(*own, *unfit, *remarks), unfit=(*model.unfit, *unfit))


def check_stable(method: str, tests: PlantTests, sample_time: float) -> None:
    """Refuse a method whose models are stable only, on a plant that is not: its gain would be a
    number without a meaning.
    """
    if tests.unstable is None or not tests.unstable.unstable or method in _MAY_BE_UNSTABLE:
        return
    raise NotIdentifiable(
        f"the plant is unstable ({tests.unstable.says(sample_time)}), and recorded in a closed"
        f" loop: models of method {method!r} are stable, and would say something else; identify it"
        " with method arx or armax"
    )


def _unstable(model: IdentifiedModel, tests: Assumptions) -> list[str]:
    if tests.unstable is None or not tests.unstable.unstable:
        return []
    pole = tests.unstable.says(model.sample_time)
    return [
        f"the plant is unstable ({pole}), and controllers are designed for stable plants;"
        f" {_ANOTHER_RECORD}"
    ]


def _untold(model: IdentifiedModel, tests: Assumptions, estimation: Sequence[Record]) -> list[str]:
    """What one experiment cannot tell: directions of the response, its gain, its end."""
    excitation = tests.excitation
    if excitation is None:
        return []
    says = []
    if not tests.tells_model or not excitation.tells_gain:
        gain = "" if excitation.tells_gain else ", not its static gain"
        says.append(
            f"{_EXCITES} of order {excitation.order} only at the noise of this record: it tells"
            f" {excitation.order} number{'s' * (excitation.order != 1)} of the response{gain}, and"
            " the rest is the model's structure; record steps or random moves, fast and slow ones"
        )
    left = _beyond_the_record(model, estimation)
    if left > _NOT_OVER:
        says.append(
            f"the records end before the response to their first move does: {100 * left:.0f} % of"
            " the static gain is extrapolated by the model; record on until the output rests"
        )
    return says


def _beyond_the_record(model: IdentifiedModel, records: Sequence[Record]) -> float:
    """Part of the static gain that the model puts later than any record goes on after its input
    first moves.
    """
    longest = 0
    for record in records:
        moved = np.flatnonzero(np.diff(np.asarray(record[model.input_name], dtype=float)) != 0)
        longest = (
            max(longest, record.n - 1 - int(moved[0]) - model.delay) if moved.size else longest
        )
    total = float(model.impulse_response.sum())
    # Without a finite static gain there is no share of it.
    if model.diverges or model.integrates or total == 0:
        return 0.0
    return abs(float(model.impulse_response[max(longest, 0) :].sum()) / total)


def _needed(model: IdentifiedModel, method: str) -> int:
    """To which order an input has to excite for the model's parameters to be told."""
    # As `orders` are written in the model's provenance: na = 2, nb = 3 …
    orders = dict(re.findall(r"(n[a-f]) = (\d+)", str(model.provenance.get("orders", ""))))
    if method in STRUCTURES and orders:
        return int(orders.get("nb", 0)) + max(int(orders.get("na", 0)), int(orders.get("nf", 0)))
    return _FEW


def _integrating(model: IdentifiedModel, tests: Assumptions) -> list[str]:
    """That model or plant integrates."""
    if tests.unstable is not None and tests.unstable.unstable:
        return []  # A(1) says nothing where a root lies outside
    if model.integrates:
        return [
            "the model integrates, and controllers are designed for stable plants;"
            f" {_ANOTHER_RECORD}"
        ]
    if tests.integrator is not None and tests.integrator.integrates:
        return [
            "the plant integrates, or settles slower than the record shows, so that its static"
            " gain has no bound; identify it with `integrator`, method bj and no `delay`, and"
            f" {_ANOTHER_RECORD}"
        ]
    return []


def _biased(method: str, tests: Assumptions) -> list[str]:
    """What makes the response another one than the plant's: feedback, a late input, a poor fit."""
    says = []
    if tests.feedback is not None and tests.feedback.present and method not in NOISE_MODELLED:
        says.append(
            f"the input answers the output's noise (feedback, {100 * tests.feedback.share:.2g} % of"
            f" its news), which {method} takes for response; use method bj and no `delay`, or"
            " record steps that nobody answers"
        )
    if tests.late:
        says.append(
            f"the input acts after {tests.dead_time} samples, later than the model's last input"
            f" lag; identify with method bj and no `delay` (or {tests.dead_time})"
        )
    worst = tests.worst
    # An input that acts late makes the fit poor by itself, and is said already.
    if worst is not None and any(part.fails for part in tests.aside) and not tests.late:
        says.append(
            f"on data kept aside the fit is {worst.fit_percent:.0f} %, and the input explains what"
            " the model misses; try another method or `order`, no `delay`, or record longer, with"
            " more steps of the input"
        )
    return says


def _remarks(method: str, tests: Assumptions, trusted: bool) -> list[str]:
    says = []
    if tests.feedback is not None and tests.feedback.present and method in NOISE_MODELLED:
        says.append(
            "the input answers the output's noise (feedback): the model is as right as its noise"
            " model is"
        )
    if tests.integrator is not None and tests.integrator.wanders:
        says.append(
            "the output wanders by itself (a root at one that the input does not reach): its level"
            " tells little"
        )
    worst = tests.worst
    if trusted and worst is not None and worst.fit_percent < _POOR_FIT:
        says.append(
            f"on data kept aside the fit is {worst.fit_percent:.0f} %; as far as they tell the rest"
            " is noise"
        )
    return says


@dataclass(frozen=True)
class PlantTests:
    """What the records say of their plant before any model; None where they are too short to
    tell.
    """

    first_lag: int
    integrator: IntegratorTest | None = None
    feedback: FeedbackTest | None = None
    dead_time: int | None = None
    unstable: UnstableTest | None = None


def plant_tests(records: Sequence[Record], asked: Identify, delay: int | None) -> PlantTests:
    """The tests on a long autoregression; of a delay that is to be estimated they take 1."""
    first_lag = 1 if delay is None else min(delay, 1)
    try:
        regression = long_autoregression(
            records, asked.input_name, asked.output_name, first_lag=first_lag
        )
        # A dead time beyond the usual reach is looked for once more with a longer one.
        dead = dead_time(regression)
        if dead is None:
            longer = long_autoregression(
                records, asked.input_name, asked.output_name, first_lag=first_lag, reach=LONG_REACH
            )
            dead = dead_time(longer)
    except BadInput:
        # Records too short for the tests may still do for a model: nothing is known then, and
        # nothing said.
        return PlantTests(first_lag)
    return PlantTests(
        first_lag,
        integrator_test(regression),
        feedback_test(regression),
        dead,
        unstable_test(regression),
    )


@dataclass(frozen=True, eq=False)
class Part:
    """A model, and the samples of a record from `first` on, which it has not seen."""

    model: IdentifiedModel
    record: Record
    first: int


def parts_kept_aside(
    model: IdentifiedModel, asked: Identify, estimation: Sequence[Record], whole: Sequence[Record]
) -> tuple[Part, ...]:
    """What split notes kept, with the model; without notes the last part of every record, with a
    fit of the first.

    That fit has the model's delay and order, and sees at most the 20 000 samples before the cut; at
    most the first 8000 after it are judged. None where the first part is too short for it.
    """
    cuts = [record.n for record in estimation]
    judged = model
    if cuts == [record.n for record in whole]:
        # No record has a split note: a fit of the first part stands for the model, which has seen
        # all.
        cuts = [round((1 - KEPT_ASIDE) * n) for n in cuts]
        first = [
            record.window(max(0, cut - _MOST_REFITTED), cut)
            for record, cut in zip(whole, cuts, strict=True)
        ]
        try:
            judged = identified_again(model, first, asked)
        except BadInput:
            return ()
    return tuple(
        _part(judged, record, cut)
        for record, cut in zip(whole, cuts, strict=True)
        if cut < record.n
    )


def _part(model: IdentifiedModel, record: Record, cut: int) -> Part:
    # the rest of the past acts no more
    first = max(0, cut - model.delay - max(model.order, _BEFORE))
    return Part(model, record.window(first, min(record.n, cut + _MOST_JUDGED)), cut - first)


def identified_again(
    model: IdentifiedModel, records: Sequence[Record], asked: Identify
) -> IdentifiedModel:
    """Another fit of the same kind, with the delay and the order that the model was found with."""
    as_before = {"delay": model.delay, "order": _input_lags(model, asked)}
    return identified_by(records, asked.model_copy(update=as_before), like=model)


def _aside(parts: Sequence[Part]) -> tuple[KeptAside, ...]:
    aside = []
    for part in parts:
        try:
            aside.append(kept_aside(part.model, part.record, part.first))
        except BadInput:
            continue  # a part too short to have a fit says nothing
    return tuple(aside)


def _last_input_lag(model: IdentifiedModel, asked: Identify) -> int:
    """Highest lag at which an input coefficient of the model acts by itself."""
    return model.delay + _input_lags(model, asked) - 1


def _input_lags(model: IdentifiedModel, asked: Identify) -> int:
    """How many input coefficients the model has; the order of a parametric method."""
    if asked.method in PENALTIES:  # those at the end that a penalty made zero are coefficients, too
        return LAGS if asked.order is None else asked.order
    if asked.method not in STRUCTURES:
        return model.order
    return int(re.findall(r"nb = (\d+)", str(model.provenance["orders"]))[0])


# What residual tests and the bootstrap say of a model, where they are asked for.


@dataclass(frozen=True, eq=False)
class ModelCheck:
    """The tests of every part kept aside, and the .632+ estimate of the error on new data.

    Attributes
    ----------
    parts : tuple of ResidualCheck
    bootstrap : BlockBootstrap or None
    reasons : tuple of str
        Why something is missing.
    output_unit : str
    """

    parts: tuple[ResidualCheck, ...]
    bootstrap: BlockBootstrap | None
    reasons: tuple[str, ...]
    output_unit: str

    @property
    def passed(self) -> bool:
        """Whether no test speaks against the model."""
        return all(part.passed for part in self.parts)

    def to_dict(self) -> dict[str, Any]:
        """As JSON."""
        return {
            "level": LEVEL,
            "passed": self.passed,
            "parts": [_part_json(part) for part in self.parts],
            "bootstrap": None if self.bootstrap is None else asdict(self.bootstrap),
            "reasons": list(self.reasons),
        }

    def lines(self) -> list[str]:
        """As lines of the report."""
        says = [line for part in self.parts for line in _part_lines(part)]
        if self.bootstrap is not None:
            unit = f" {self.output_unit}" if self.output_unit else ""
            sizes = [
                math.sqrt(value)
                for value in (
                    self.bootstrap.error,
                    self.bootstrap.apparent,
                    self.bootstrap.out_of_bag,
                )
            ]
            says.append(
                f"  new data          error {sizes[0]:.4g}{unit} RMS by the .632+ bootstrap of"
                f" {self.bootstrap.blocks} blocks ({sizes[1]:.4g} on its own data, {sizes[2]:.4g}"
                " on blocks left out)"
            )
        return says + [f"  not checked       {reason}" for reason in self.reasons]


def model_check(
    model: IdentifiedModel, asked: Identify, parts: Sequence[Part], records: Sequence[Record]
) -> ModelCheck:
    """Check a model on the parts that it has not seen, and on blocks of `records`, which it was
    identified from.
    """
    checks, reasons = (
        [],
        (
            []
            if parts
            else ["residuals: nothing could be kept aside; record longer, or take a smaller order"]
        ),
    )
    for part in parts:
        try:
            checks.append(residual_check(part.model, part.record, part.first))
        except BadInput as error:
            # What cannot be tested is told, and neither withholds the model nor counts as passed.
            reasons.append(f"residuals: {error}")
    bootstrap = None
    try:
        bootstrap = block_bootstrap(
            lambda blocks: identified_again(model, blocks, asked), model, records
        )
    except BadInput as error:
        reasons.append(str(error))
    return ModelCheck(tuple(checks), bootstrap, tuple(reasons), model.output_unit)


def _part_json(part: ResidualCheck) -> dict[str, Any]:
    return {
        "samples": part.samples,
        "passed": part.passed,
        "whiteness": _test_json(part.whiteness),
        "input_correlation": _test_json(part.input),
        "model_error": _error_json(part.model_error),
    }


def _test_json(test: ResidualTest | None) -> dict[str, Any] | None:
    if test is None:
        return None
    return {
        "lags": test.lags,
        "correlation": test.correlation,
        "band": test.band,
        "statistic": test.statistic,
        "degrees_of_freedom": test.degrees_of_freedom,
        "p_value": test.p_value,
        "passed": test.passed,
    }


def _error_json(error: ModelErrorModel | None) -> dict[str, Any] | None:
    if error is None:
        return None
    return {
        "falsified": error.falsified,
        "falsified_at": error.falsified_at,
        "frequencies": len(error.omega),
    }


def _part_lines(part: ResidualCheck) -> list[str]:
    white = "needs a noise model" if part.whiteness is None else _verdict(part.whiteness)
    free = "too short to tell" if part.input is None else _verdict(part.input)
    lines = [
        f"  residuals         white: {white}; free of the input: {free}; {part.samples} samples"
        " kept aside"
    ]
    if part.model_error is not None:
        error = part.model_error
        where = f"falsified at {len(error.falsified_at)} of {len(error.omega)} frequencies"
        if error.falsified:
            where += f", {error.falsified_at[0]:.3g} to {error.falsified_at[-1]:.3g} rad/s"
        lines.append(
            f"  model error       {where if error.falsified else 'not falsified at any frequency'}"
        )
    return lines


def _verdict(test: ResidualTest) -> str:
    answer = "yes" if test.passed else "no"
    return (
        f"{answer} (p {test.p_value:.2g}, level {test.level:g}, lags {test.lags[0]} to"
        f" {test.lags[-1]})"
    )
