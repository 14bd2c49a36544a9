"""Algorithm 4 on the simulated oven: what the figures of chapter 5 share."""

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from residuum.identification.kernel_based.impulse_response import identify_impulse_response
from residuum.identification.linear_models.identified_model import IdentifiedModel
from residuum.identification.linear_models.transfer_function import TransferFunction
from residuum.identification.record import Record
from residuum.robust_control.control_problem import average_plant, overall_uncertainty
from residuum.robust_control.loop import Loop, Weights, frequency_grid
from residuum.robust_control.synthesis.constrained_structure import PIDN
from residuum.robust_control.synthesis.structured_synthesis import Synthesis, synthesise
from residuum.robust_control.weights.performance_weight import (
    NominalAim,
    NominalDesign,
    design_for_nominal_performance,
)
from residuum.simulation.oven import OvenMachine

TS, N, DROPPED, SEED, PLANTS = 60.0, 4800, 1000, 1, 200
DURATION = 400 * TS
AIM = NominalAim(smallest_overshoot=0.01, longest_settling_time=10_000.0, slack=0.15)
FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Oven:
    """What Algorithm 4 found: the records, models, the overall weight, the design and plants drawn from each configuration."""

    records: dict[str, Record]
    models: dict[str, IdentifiedModel]
    loop: Loop
    W_T: TransferFunction
    largest: FloatArray
    critical_frequency: float
    largest_about_mean: float
    design: NominalDesign
    sampled: dict[str, list[TransferFunction]]


def algorithm_4(plants: int) -> Oven:
    """Worst, then best configuration of one oven; each identified by itself, their mean from the joined record."""
    machine = OvenMachine(seed=SEED, configuration="worst", profile="experiment", sample_time_s=TS)
    worst = machine.simulate(N * TS).channels
    machine.configure("best")
    best = machine.simulate(N * TS).channels
    joined = {
        name: np.concatenate([worst[name], best[name]])[DROPPED:-DROPPED]
        for name in ("duty", "temperature")
    }
    middle = N - DROPPED
    records = {
        "average": _record(joined, "joined"),
        "worst": _record({name: values[:middle] for name, values in joined.items()}, "worst"),
        "best": _record({name: values[middle:] for name, values in joined.items()}, "best"),
    }
    models = {
        name: identify_impulse_response(record, "duty", "temperature", order=100, cover_cut=False)
        for name, record in records.items()
    }
    plant = models["average"].transfer_function()
    omega = frequency_grid([plant])
    loop = Loop([plant], omega)
    configurations = [models["worst"], models["best"]]
    W_T, largest = overall_uncertainty(configurations, plant, omega, seed=SEED)
    mean = average_plant(configurations)
    about_mean = float(
        overall_uncertainty(configurations, mean, frequency_grid([mean]), seed=SEED)[1].max()
    )
    magnitude = np.abs(W_T.frequency_response(omega))
    above = np.flatnonzero(magnitude >= 1.0)
    critical = float(omega[above[0]] if above.size else omega[-1])
    design = design_for_nominal_performance(loop, magnitude, PIDN(TS), AIM, critical)
    sampled = {name: _drawn(models[name], plants) for name in ("worst", "best")}
    return Oven(records, models, loop, W_T, largest, critical, about_mean, design, sampled)


def _record(channels: dict[str, FloatArray], name: str) -> Record:
    return Record(
        channels, {"duty": "%", "temperature": "degC"}, TS, source=f"simulated oven, {name}"
    )


def _drawn(model: IdentifiedModel, plants: int) -> list[TransferFunction]:
    den = np.r_[1.0, np.zeros(model.delay + model.order - 1)]
    return [TransferFunction(g, den, TS) for g in model.sample(plants, SEED)]


def synthesised(oven: Oven, slower: float, W_T: FloatArray) -> Synthesis:
    """The controller of least cost for the automatic Ŵ_S with its settling time times `slower`."""
    reference = replace(
        oven.design.reference, settling_time=slower * oven.design.reference.settling_time
    )
    return synthesise(
        oven.loop, Weights(reference.weight_magnitude(oven.loop.omega), W_T), PIDN(TS)
    )
