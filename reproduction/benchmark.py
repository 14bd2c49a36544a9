"""The benchmark (2.38): its record, its three identifications, and the uncertainty weight of each."""

from functools import lru_cache

import numpy as np
from scipy.signal import lfilter

from residuum.identification.kernel_based.impulse_response import identify_impulse_response
from residuum.identification.linear_models.identified_model import IdentifiedModel
from residuum.identification.linear_models.prediction_error import STRUCTURES, identify
from residuum.identification.linear_models.transfer_function import TransferFunction
from residuum.identification.linear_models.uncertainty import (
    UncertaintyWeight,
    design_uncertainty_weight,
)
from residuum.identification.record import Record

TS = 0.01
TRUE = TransferFunction([0.28261, 0.50666], [1, -1.41833, 1.58939, -1.31608, 0.88642], TS)
OMEGA = np.geomspace(1e-3, np.pi / TS, 600)
UNSEEN = np.linspace(1e-3, np.pi / TS, 20_001)
TRUE_ORDER = 4
N, DROPPED, SNR, SEED = 5000, 1000, 25.0, 1
LOW, FULL, KERNEL = "PEM under-modelled", "PEM full", "kernel"


def benchmark_record(seed: int = SEED) -> Record:
    """5000 samples of (2.38) with white input and bounded white noise; 1000 before them are dropped."""
    rng = np.random.default_rng(seed)
    u = rng.normal(size=N + DROPPED)
    y = lfilter(np.r_[np.zeros(3), TRUE.num], TRUE.den, u)
    e = np.clip(rng.normal(size=len(y)), -3, 3)
    e *= np.std(y) / np.sqrt(SNR) / np.std(e)
    return Record(
        {"u": u[DROPPED:], "y": (y + e)[DROPPED:]},
        {"u": "", "y": ""},
        TS,
        source=f"benchmark (2.38), seed {seed}",
    )


@lru_cache
def identified() -> dict[str, IdentifiedModel]:
    """The three identifications of section 2.3: too low an order, the true order (as the source's AIC chose it), kernel.

    The kernel's 100 coefficients alone, as Algorithm 1 has them: what they cut off is in no weight here.
    """
    record = benchmark_record()
    return {
        LOW: identify(
            STRUCTURES["oe"],
            [record],
            "u",
            "y",
            offset=False,
            criterion="aic",
            candidates=range(1, 4),
        ),
        FULL: identify(STRUCTURES["oe"], [record], "u", "y", offset=False, order=TRUE_ORDER),
        KERNEL: identify_impulse_response(
            record, "u", "y", order=100, offset=False, cover_cut=False
        ),
    }


@lru_cache
def weights() -> dict[str, UncertaintyWeight]:
    """Algorithm 1 on each, second-order weights, n_p = 738."""
    return {
        name: design_uncertainty_weight(model, omega=OMEGA, order=2, seed=SEED)
        for name, model in identified().items()
    }
