"""What stands in for Algorithm 1's 738 models drawn from a model's own covariance: a model error model, fewer models, no draws.

One plant of one input, (2.38): an output-error model of order 2, which knows one of its two resonances, and the kernel model; the
error model comes from a second record. One plant of two inputs and outputs, that of `multivariable_bound`: weights W_ij channel
by channel. Of each weight: the records in which the truth lies above it anywhere, the largest true error over it, both at
frequencies that no fit has seen, and how far the weight lies above the true error in the middle (median over frequencies).

python -m benchmarks.weights_by_error_model --records 6
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from benchmarks import multivariable_bound
from reproduction.benchmark import OMEGA, TRUE, UNSEEN, benchmark_record
from residuum.identification.kernel_based.impulse_response import identify_impulse_response
from residuum.identification.kernel_based.multivariable import identify_multivariable
from residuum.identification.linear_models.error_bounds.error_models import with_model_error
from residuum.identification.linear_models.error_bounds.magnitude_fit import fit_magnitude
from residuum.identification.linear_models.identified_model import IdentifiedModel
from residuum.identification.linear_models.prediction_error import STRUCTURES, identify
from residuum.identification.linear_models.transfer_function import TransferFunction
from residuum.identification.linear_models.uncertainty import design_uncertainty_weight
from residuum.identification.linear_models.validation import model_error_model
from residuum.identification.record import Record
from residuum.robust_control.control_problem import WeightChoice
from residuum.robust_control.multivariable_control import MultivariableProblem

FloatArray = npt.NDArray[np.float64]
ORDER = 4
"""Of every weight of (2.38): two resonances need two pairs of poles."""


@dataclass(frozen=True)
class Held:
    """One weight: largest true error over it, the median of weight over true error, and the seconds it took."""

    worst: float
    room: float
    seconds: float


def drawn(model: IdentifiedModel, rule: str) -> TransferFunction:
    """Algorithm 1 with the number of models that a rule asks for."""
    return design_uncertainty_weight(model, omega=OMEGA, rule=rule, order=ORDER).weight


def by_band(model: IdentifiedModel, fresh: Record) -> TransferFunction:
    """A weight above the error model's own band: nothing is drawn."""
    found = model_error_model(model, fresh, order=100, omega=OMEGA)
    relative = found.magnitude_bound / np.abs(model.frequency_response(OMEGA))
    return fit_magnitude(OMEGA, relative, order=ORDER, sample_time=model.sample_time)


WAYS: Mapping[str, Callable[[IdentifiedModel, Record], TransferFunction]] = {
    "own covariance, 738 models": lambda model, fresh: drawn(model, "chernoff"),
    "own covariance, 59 models": lambda model, fresh: drawn(model, "worst-case"),
    "model error model, 738 models": lambda model, fresh: drawn(
        with_model_error(model, [fresh]), "chernoff"
    ),
    "model error model, 59 models": lambda model, fresh: drawn(
        with_model_error(model, [fresh]), "worst-case"
    ),
    "model error model, its band, no models": by_band,
}
"""What the row says → the weight of a model, with a record that the model was not estimated from."""

MODELS: Mapping[str, Callable[[Record], IdentifiedModel]] = {
    "(2.38), output error of order 2": lambda record: identify(
        STRUCTURES["oe"], [record], "u", "y", offset=False, order=2
    ),
    "(2.38), kernel": lambda record: identify_impulse_response(
        record, "u", "y", order=100, offset=False
    ),
}


def held(
    model: IdentifiedModel,
    way: Callable[[IdentifiedModel, Record], TransferFunction],
    fresh: Record,
) -> Held:
    """The weight of one model, beside its true error."""
    begun = time.process_time()
    weight = way(model, fresh)
    seconds = time.process_time() - begun
    error = np.abs(TRUE.frequency_response(UNSEEN) / model.frequency_response(UNSEEN) - 1)
    ratio = error / np.abs(weight.frequency_response(UNSEEN))
    return Held(float(ratio.max()), float(1 / np.median(ratio)), seconds)


def several(data: Record, rule: str) -> Held:
    """The same of the plant of two inputs and outputs: the worst of its four elements."""
    model = identify_multivariable(
        data, ["u0", "u1"], ["y0", "y1"], order=multivariable_bound.ORDER
    )
    begun = time.process_time()
    ratios = multivariable_bound.ratios(MultivariableProblem(model, choice=WeightChoice(rule=rule)))
    return Held(float(ratios.max()), float(1 / np.median(ratios)), time.process_time() - begun)


def row(plant: str, way: str, found: list[Held]) -> str:
    """A line of the table."""
    worst = max(one.worst for one in found)
    above = sum(one.worst > 1 for one in found)
    room, seconds = (
        float(np.median([getattr(one, name) for one in found])) for name in ("room", "seconds")
    )
    return (
        f"| {plant} | {way} | {above} of {len(found)} | {worst:.2f} | {room:.1f} | {seconds:.2f} |"
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--records", type=int, default=6)
    count = parser.parse_args().records
    print(
        "| model | weight from | truth above | largest true error over it | weight over true error, median | CPU [s] |"
    )
    print("|---|---|---|---|---|---|")
    for plant, make in MODELS.items():
        models = [make(benchmark_record(2 * k + 1)) for k in range(count)]
        for name, way in WAYS.items():
            print(
                row(
                    plant,
                    name,
                    [held(m, way, benchmark_record(2 * k + 2)) for k, m in enumerate(models)],
                ),
                flush=True,
            )
    for name, rule in (
        ("own covariance, 738 models", "chernoff"),
        ("own covariance, 59 models", "worst-case"),
    ):
        found = [several(multivariable_bound.record(k), rule) for k in range(count)]  # type: ignore[arg-type]
        print(row("two by two, kernel", f"{name}, W_ij channel by channel", found), flush=True)


if __name__ == "__main__":
    main()
