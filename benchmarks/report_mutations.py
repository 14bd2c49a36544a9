"""Does the report turn red when the code is made wrong on purpose? Each mutation replaces one function, in a process of its own.

python -m benchmarks.report_mutations                     # all: about twenty minutes of a free core
python -m benchmarks.report_mutations --from 6 --to 10    # those alone, by number; 0 is the report as it is
"""

from __future__ import annotations

import argparse
import multiprocessing
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from importlib import import_module
from typing import Any

import numpy as np
from scipy.stats import chi2
from sklearn.base import clone

from reproduction.agreement import lost, recorded
from reproduction.parts import PARTS, run

Change = Callable[[Any], Any]


@dataclass(frozen=True)
class Mutation:
    """Name, the function ("module:function" or "module:Class.method"), what takes its place, the part run first."""

    name: str
    target: str
    change: Change
    first: str


def _scaled(factor: float) -> Change:
    return lambda original: lambda *args, **given: factor * original(*args, **given)


def _field_scaled(name: str) -> Change:
    def change(original: Any) -> Any:
        def changed(*args: Any, **given: Any) -> Any:
            made = original(*args, **given)
            return replace(made, **{name: 0.5 * getattr(made, name)})

        return changed

    return change


def _property_scaled(factor: float) -> Change:
    return lambda original: property(lambda self: factor * original.fget(self))


def _both_halved(original: Any) -> Any:
    return lambda *args, **given: tuple(0.5 * value for value in original(*args, **given))


def _weight_halved(original: Any) -> Any:
    def changed(*args: Any, **given: Any) -> Any:
        weight, proven = original(*args, **given)
        return replace(weight, num=0.5 * weight.num), proven

    return changed


def _covariance(factor: float) -> Change:
    def change(original: Any) -> Any:
        def changed(*args: Any, **given: Any) -> Any:
            model = original(*args, **given)
            named = {
                name: getattr(model, name)
                for name in ("covariance", "parameter_covariance", "longer_covariance")
            }
            return replace(
                model,
                **{name: factor * value for name, value in named.items() if value is not None},
            )

        return changed

    return change


def _gain_lost(original: Any) -> Any:
    def changed(*args: Any, **given: Any) -> Any:
        model = original(*args, **given)
        longer = None if model.longer_response is None else 0.85 * model.longer_response
        return replace(
            model, impulse_response=0.85 * model.impulse_response, longer_response=longer
        )

    return changed


def _controller_detuned(original: Any) -> Any:
    def changed(loop: Any, weights: Any, structure: Any, **given: Any) -> Any:
        made = original(loop, weights, structure, **given)
        rho = made.rho * np.array([0.7, *[1.0] * (len(made.rho) - 1)])
        return replace(made, rho=rho, controller=structure.transfer_function(rho))

    return changed


def _filter_wrong(original: Any) -> Any:
    def changed(*args: Any, **given: Any) -> Any:
        made = original(*args, **given)
        return replace(made, Q=made.Q * 1.3)

    return changed


def _first_model_alone(original: Any) -> Any:
    return lambda models, *args, **given: original(models[:1], *args, **given)


def _envelope_squared(original: Any) -> Any:
    def changed(*args: Any, **given: Any) -> Any:
        found = original(*args, **given)
        return replace(found, values=found.values**2)

    return changed


def _without_groups(original: Any) -> Any:
    def changed(estimator: Any, X: Any, y: Any, objects: Any) -> Any:
        return replace(
            original(estimator, X, y, np.arange(len(y)) % 5), objects=np.asarray(objects)
        )

    return changed


def _risk_turned(original: Any) -> Any:
    return lambda probability, severity: original(
        chr(ord("A") + ord("D") - ord(probability)), severity
    )


def _band_shifted(original: Any) -> Any:
    def changed(*args: Any, **given: Any) -> Any:
        found = original(*args, **given)
        return replace(found, centre=found.centre + 1.5 * found.width)

    return changed


def _settled_by_five_percent(original: Any) -> Any:
    def changed(y: Any, sample_time: float) -> Any:
        return replace(
            original(y, sample_time),
            settling_time=original(1.0 + 0.4 * (y - 1.0), sample_time).settling_time,
        )

    return changed


def _aic_of_half_the_parameters(original: Any) -> Any:
    def changed(fit: Any, orders: Any, n: int) -> Any:
        found = original(fit, orders, n)
        return found | {"aic": found["aic"] - orders.count}

    return changed


def _one_further(original: Any) -> Any:
    return lambda self, segment: original(self, segment + 1)


def _of_one_degree(original: Any) -> Any:
    return lambda model, theta, probability=0.95: original(
        model, theta, float(chi2(2).cdf(chi2(1).ppf(probability)))
    )


def _mean_absolute(original: Any) -> Any:
    return lambda x: replace(original(x), rms=float(np.mean(np.abs(x))))


def _wide_band(original: Any) -> Any:
    return lambda residual, sample_time: original(residual, sample_time, (0.5, 45.0))


def _judged_on_what_was_taught(original: Any) -> Any:
    def changed(estimator: Any, X: Any, y: Any, objects: Any, *args: Any, **given: Any) -> Any:
        return replace(
            original(estimator, X, y, objects, *args, **given),
            predicted=clone(estimator).fit(X, y).predict(X),
        )

    return changed


def _norm_too_small(original: Any) -> Any:
    def changed(*args: Any, **given: Any) -> Any:
        norm, omega = original(*args, **given)
        return 0.8 * norm, omega

    return changed


_LINEAR, _KERNEL = "residuum.identification.linear_models", "residuum.identification.kernel_based"
_CONTROL, _DIAGNOSIS = "residuum.robust_control", "residuum.diagnosis"
MUTATIONS = (
    Mutation(
        "2ε² becomes ε² in the number of random plants",
        f"{_LINEAR}.uncertainty:chernoff_samples",
        _scaled(2),
        "sample_size",
    ),
    Mutation(
        "the least-squares covariance is a quarter",
        f"{_LINEAR}.prediction_error.identify:identify",
        _covariance(0.25),
        "prediction_error",
    ),
    Mutation(
        "the kernel's impulse response loses 15 %",
        f"{_KERNEL}.impulse_response:identify_impulse_response",
        _gain_lost,
        "uncertainty",
    ),
    Mutation(
        "the kernel's covariance is a twentieth",
        f"{_KERNEL}.impulse_response:identify_impulse_response",
        _covariance(0.05),
        "uncertainty",
    ),
    Mutation(
        "Ŵ_T is half of what it must be",
        f"{_LINEAR}.uncertainty:weight_above",
        _weight_halved,
        "uncertainty",
    ),
    Mutation(
        "ω_n ℓ ξ = 3 in place of 4",
        f"{_CONTROL}.weights.reference_model:ReferenceModel.natural_frequency",
        _property_scaled(0.75),
        "nominal_control",
    ),
    Mutation(
        "the controller's first parameter is 30 % off",
        f"{_CONTROL}.synthesis.structured_synthesis:synthesise",
        _controller_detuned,
        "nominal_control",
    ),
    Mutation(
        "Ŵ_T of one configuration alone",
        f"{_CONTROL}.multi_model:overall_uncertainty",
        _first_model_alone,
        "oven",
    ),
    Mutation(
        "the post-filter is 30 % too strong",
        f"{_DIAGNOSIS}.residuals.approximate_fault_detection:approximate_fault_detection",
        _filter_wrong,
        "robust_residual",
    ),
    Mutation(
        "τ is half of (4.9)",
        f"{_DIAGNOSIS}.thresholds.threshold:source_threshold",
        _field_scaled("level"),
        "robust_residual",
    ),
    Mutation(
        "the envelope is squared",
        f"{_DIAGNOSIS}.vibration.envelope:band_envelope",
        _envelope_squared,
        "gripping_pliers",
    ),
    Mutation(
        "the kurtogram's best band is shifted",
        f"{_DIAGNOSIS}.vibration.kurtogram:Kurtogram.band",
        _band_shifted,
        "gripping_pliers",
    ),
    Mutation(
        "the gear has 47 teeth",
        f"{_DIAGNOSIS}.gate.actuator_model:ActuatorConstants.fault_frequency",
        _scaled(44 / 47),
        "gate_actuator",
    ),
    Mutation(
        "F₁ and F₂ are halved",
        f"{_DIAGNOSIS}.gate.movement_features:fault_indicators",
        _both_halved,
        "gate_actuator",
    ),
    Mutation(
        "object-wise folds mix objects",
        f"{_DIAGNOSIS}.learning.diagnoser_validation:object_wise",
        _without_groups,
        "gate_actuator",
    ),
    Mutation(
        "likely failures count as unlikely",
        f"{_DIAGNOSIS}.gate.fmeca:risk",
        _risk_turned,
        "gate_actuator",
    ),
    Mutation(
        "overshoot is reported halved",
        f"{_CONTROL}.certificates.time_domain:assess",
        _field_scaled("overshoot"),
        "nominal_control",
    ),
    Mutation(
        "settled is within 5 % in place of 2 %",
        f"{_CONTROL}.certificates.time_domain:assess",
        _settled_by_five_percent,
        "nominal_control",
    ),
    Mutation(
        "AIC counts half of the parameters",
        f"{_LINEAR}.prediction_error.order_selection:information",
        _aic_of_half_the_parameters,
        "uncertainty",
    ),
    Mutation(
        "quadrants are turned by one",
        f"{_DIAGNOSIS}.vibration.rounds:Rounds.quadrant",
        _one_further,
        "gripping_pliers",
    ),
    Mutation(
        "the ellipsoid has χ² of one degree of freedom",
        f"{_LINEAR}.prediction_error.confidence:in_confidence_ellipsoid",
        _of_one_degree,
        "prediction_error",
    ),
    Mutation(
        "an RMS is a mean absolute value",
        f"{_DIAGNOSIS}.vibration.vibration_indicators:indicators",
        _mean_absolute,
        "gripping_pliers",
    ),
    Mutation(
        "the residual's envelope is of 0.5 to 45 Hz",
        f"{_DIAGNOSIS}.gate.movement_features:residual_envelope",
        _wide_band,
        "gate_actuator",
    ),
    Mutation(
        "mixed folds judge what they were taught",
        f"{_DIAGNOSIS}.learning.diagnoser_validation:mixed_folds",
        _judged_on_what_was_taught,
        "gate_actuator",
    ),
    Mutation(
        "the performance weight is half",
        f"{_CONTROL}.weights.performance_weight:MonotoneWeight.magnitude",
        _scaled(0.5),
        "robust_control",
    ),
    Mutation(
        "the average plant is the first configuration's",
        f"{_CONTROL}.multi_model:average_plant",
        _first_model_alone,
        "oven",
    ),
    Mutation(
        "the H∞ norm is a fifth too small",
        f"{_DIAGNOSIS}.systems.system_norms:h_infinity_norm",
        _norm_too_small,
        "robust_residual",
    ),
)


def mutate(mutation: Mutation) -> None:
    """Put the changed function in the place of the original, in every module that has imported it."""
    module, _, path = mutation.target.partition(":")
    owner: Any = import_module(module)
    *outer, name = path.split(".")
    for part in outer:
        owner = getattr(owner, part)
    original = owner.__dict__[name]
    changed = mutation.change(original)
    setattr(owner, name, changed)
    for other in list(sys.modules.values()):
        for alias, value in (
            list(vars(other).items())
            if getattr(other, "__name__", "").startswith(("residuum", "reproduction"))
            else ()
        ):
            if value is original:
                setattr(other, alias, changed)


def _red(mutation: Mutation | None, answer: Any) -> None:
    """The first check that the short report loses, part by part."""
    for part in PARTS:
        import_module(f"reproduction.{part}")
    if mutation is not None:
        mutate(mutation)
    before = recorded(short=True)
    ordered = sorted(PARTS, key=lambda part: mutation is None or part != mutation.first)
    for part in ordered:
        try:
            gone = lost(before, {part: run(part, short=True)})
        except Exception as error:
            gone = [(part, type(error).__name__, str(error)[:80])]
        if gone:
            answer.put((len(gone), gone[0]))
            return
    answer.put((0, None))


def _by_name() -> Mapping[str, Mutation]:
    return {mutation.name: mutation for mutation in MUTATIONS}


def _red_by_name(name: str | None, answer: Any) -> None:
    _red(None if name is None else _by_name()[name], answer)


def red(name: str | None) -> tuple[int, tuple[str, str, str] | None]:
    """(checks lost in the first part that loses any, the first of them); (0, None) when the report stays green."""
    context = multiprocessing.get_context("spawn")
    answer: Any = context.Queue()
    process = context.Process(target=_red_by_name, args=(name, answer))
    process.start()
    found: tuple[int, tuple[str, str, str] | None] = answer.get()
    process.join()
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--from",
        dest="first",
        type=int,
        default=0,
        help="number of the first; 0: the report as it is",
    )
    parser.add_argument("--to", dest="last", type=int, default=len(MUTATIONS))
    given = parser.parse_args()
    asked = (None, *_by_name())[given.first : given.last + 1]
    print("| made wrong | report | first check lost | seconds |\n|---|---|---|---|")
    turned = 0
    for name in asked:
        begun = time.perf_counter()
        count, first = red(name)
        turned += name is not None and bool(count)
        shown = "" if first is None else ", ".join(first[1:])
        print(
            f"| {name or 'nothing'} | {'red' if count else 'green'} | {shown} | {time.perf_counter() - begun:.0f} |",
            flush=True,
        )
    print(f"\n{turned} of {sum(name is not None for name in asked)} mutations turn the report red.")


if __name__ == "__main__":
    main()
