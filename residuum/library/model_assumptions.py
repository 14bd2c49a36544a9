"""What a record and data kept aside say against an identified model, in sentences that tell what to do instead."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

from residuum.identification.errors import BadInput
from residuum.identification.linear_models.identified_model import IdentifiedModel
from residuum.identification.linear_models.plant_tests.dead_time import dead_time
from residuum.identification.linear_models.plant_tests.feedback import FeedbackTest, feedback_test
from residuum.identification.linear_models.plant_tests.integrator import IntegratorTest, integrator_test
from residuum.identification.linear_models.plant_tests.kept_aside import KEPT_ASIDE, KeptAside, kept_aside
from residuum.identification.linear_models.plant_tests.long_autoregression import LONG_REACH, long_autoregression
from residuum.identification.linear_models.prediction_error import STRUCTURES
from residuum.identification.linear_models.prediction_error.regularised_regression import PENALTIES
from residuum.identification.record import Record
from residuum.library.identification_methods import LAGS, NOISE_MODELLED, Request, identified_by

_POOR_FIT = 50.0
_ANOTHER_RECORD = (
    "for a controller record steps of the set point of a loop that holds it (a proportional one is enough), and identify from "
    "set point to output"
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
        One a record: of this model where a split note kept data aside, else of a fit of the first part on the last.
    late : bool
        Whether the input acts later than the model's last input lag, and the model misses it.
    """

    integrator: IntegratorTest | None
    feedback: FeedbackTest | None
    dead_time: int | None
    aside: tuple[KeptAside, ...]
    late: bool = False

    @property
    def worst(self) -> KeptAside | None:
        """The part kept aside on which the fit is poorest."""
        return min(self.aside, key=lambda part: part.fit_percent, default=None)

    def to_dict(self) -> dict[str, Any]:
        """As JSON."""
        integrator, feedback = self.integrator, self.feedback
        return {
            "integrator": None if integrator is None else asdict(integrator) | {"present": integrator.integrates},
            "feedback": None if feedback is None else asdict(feedback) | {"present": feedback.present},
            "dead_time": {"samples": self.dead_time, "beyond_order": self.late},
            "kept_aside": [asdict(part) | {"fails": part.fails} for part in self.aside],
        }


def assumptions(
    model: IdentifiedModel, method: str, request: Request, estimation: Sequence[Record], parts: Sequence[Part]
) -> Assumptions:
    """Test the records that a model with an input was identified from, and the model on `parts_kept_aside`."""
    integrator, feedback, dead = _plant(estimation, request, model.delay)
    aside = _aside(parts)
    late = dead is not None and dead > _last_input_lag(model, method, request) and any(part.fails for part in aside)
    return Assumptions(integrator, feedback, dead, aside, late)


def told(model: IdentifiedModel, method: str, found: Assumptions) -> IdentifiedModel:
    """The model with what was found: as warnings, and as unfit where no controller may be promised for it."""
    unfit = _unfit(model, method, found)
    remarks = _remarks(method, found, trusted=not unfit)
    return replace(model, warnings=(*model.warnings, *unfit, *remarks), unfit=(*model.unfit, *unfit))


def _unfit(model: IdentifiedModel, method: str, found: Assumptions) -> list[str]:
    says = []
    if model.integrates:
        says.append(f"the model integrates, and controllers are designed for stable plants; {_ANOTHER_RECORD}")
    elif found.integrator is not None and found.integrator.integrates:
        says.append(
            "the plant integrates, or settles slower than the record shows, so that its static gain has no bound; identify it "
            f"with `integrator`, method bj and `delay` estimate, and {_ANOTHER_RECORD}"
        )
    if found.feedback is not None and found.feedback.present and method not in NOISE_MODELLED:
        says.append(
            f"the input answers the output's noise (feedback, {100 * found.feedback.share:.2g} % of its news), which {method} "
            f"takes for response; use method bj with `delay` estimate, or record steps that nobody answers"
        )
    if found.late:
        says.append(
            f"the input acts after {found.dead_time} samples, later than the model's last input lag; identify with method "
            f"bj and `delay` estimate (or {found.dead_time})"
        )
    worst = found.worst
    if worst is not None and any(part.fails for part in found.aside) and not found.late:
        says.append(
            f"on data kept aside the fit is {worst.fit_percent:.0f} %, and the input explains what the model misses; try another "
            "method, `order` or `delay` estimate, or record longer, with more steps of the input"
        )
    return says


def _remarks(method: str, found: Assumptions, trusted: bool) -> list[str]:
    says = []
    if found.feedback is not None and found.feedback.present and method in NOISE_MODELLED:
        says.append("the input answers the output's noise (feedback): the model is as right as its noise model is")
    if found.integrator is not None and found.integrator.wanders:
        says.append("the output wanders by itself (a root at one that the input does not reach): its level tells little")
    worst = found.worst
    if trusted and worst is not None and worst.fit_percent < _POOR_FIT:
        says.append(f"on data kept aside the fit is {worst.fit_percent:.0f} %; as far as they tell the rest is noise")
    return says


def _plant(
    records: Sequence[Record], request: Request, delay: int
) -> tuple[IntegratorTest | None, FeedbackTest | None, int | None]:
    try:
        regression = long_autoregression(records, request.input, request.output, first_lag=min(delay, 1))
        dead = dead_time(regression)
        if dead is None:
            longer = long_autoregression(records, request.input, request.output, first_lag=min(delay, 1), reach=LONG_REACH)
            dead = dead_time(longer)
    except BadInput:
        return None, None, None
    return integrator_test(regression), feedback_test(regression), dead


@dataclass(frozen=True, eq=False)
class Part:
    """A model, and the samples of a record from `first` on, which it has not seen."""

    model: IdentifiedModel
    record: Record
    first: int


def parts_kept_aside(
    model: IdentifiedModel, method: str, request: Request, estimation: Sequence[Record], whole: Sequence[Record]
) -> tuple[Part, ...]:
    """What split notes kept, with the model; without notes the last part of every record, with a fit of the first.

    That fit has the model's delay and order. None where the first part is too short for it.
    """
    cuts = [record.n for record in estimation]
    judged = model
    if cuts == [record.n for record in whole]:
        cuts = [round((1 - KEPT_ASIDE) * n) for n in cuts]
        first = [record.window(0, cut) for record, cut in zip(whole, cuts, strict=True)]
        try:
            judged = identified_by(method, first, as_before(model, method, request))
        except BadInput:
            return ()
    return tuple(Part(judged, record, cut) for record, cut in zip(whole, cuts, strict=True) if cut < record.n)


def as_before(model: IdentifiedModel, method: str, request: Request) -> Request:
    """The request with the delay and the order that the model was found with, for another fit of the same kind."""
    return replace(request, delay=model.delay, order=_input_lags(model, method, request))


def _aside(parts: Sequence[Part]) -> tuple[KeptAside, ...]:
    found = []
    for part in parts:
        try:
            found.append(kept_aside(part.model, part.record, part.first))
        except BadInput:
            continue  # a part too short to have a fit says nothing
    return tuple(found)


def _last_input_lag(model: IdentifiedModel, method: str, request: Request) -> int:
    """Highest lag at which an input coefficient of the model acts by itself."""
    return model.delay + _input_lags(model, method, request) - 1


def _input_lags(model: IdentifiedModel, method: str, request: Request) -> int:
    """How many input coefficients the model has; the order of a parametric method."""
    if method in PENALTIES:  # those at the end that a penalty made zero are coefficients, too
        return LAGS if request.order is None else request.order
    if method not in STRUCTURES:
        return model.order
    return int(re.findall(r"nb = (\d+)", str(model.provenance["orders"]))[0])
