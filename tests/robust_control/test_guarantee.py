"""What the certificate promises, held against plants drawn anew from the posterior of identified models."""

import numpy as np
import pytest
from scipy.signal import lfilter

from residuum.identification.kernel_based.impulse_response import identify_impulse_response
from residuum.identification.linear_models.schur import is_schur
from residuum.identification.linear_models.transfer_function import TransferFunction
from residuum.identification.linear_models.uncertainty import design_uncertainty_weight
from residuum.identification.record import Record
from residuum.robust_control.certificates import h_infinity_norm
from residuum.robust_control.loop import (
    Loop,
    Weights,
    characteristic,
    frequency_grid,
    weighted_loop,
)
from residuum.robust_control.synthesis.constrained_structure import PI
from residuum.robust_control.synthesis.structured_synthesis import synthesise
from residuum.robust_control.weights.performance_weight import ReferenceModel

SYSTEMS = {
    "resonant": TransferFunction([0.4, 0.3], [1.0, -1.2, 0.8], 1.0),
    "non-minimum-phase": TransferFunction([-0.3, 0.8], [1.0, -0.7], 1.0),
    "delayed": TransferFunction([0.3], [1.0, -0.8, 0.0, 0.0, 0.0], 1.0),
}


@pytest.mark.parametrize("name", SYSTEMS)
def test_no_plant_of_the_certified_set_is_destabilised(name):
    true, rng = SYSTEMS[name], np.random.default_rng(3)
    u = rng.normal(size=600)
    y = lfilter(np.r_[np.zeros(len(true.den) - len(true.num)), true.num], true.den, u)
    y += rng.normal(size=600) * np.std(y) / 2
    record = Record({"u": u, "y": y}, {"u": "", "y": ""}, 1.0, source=name)
    model = identify_impulse_response(record, "u", "y", order=40, offset=False)
    weight = design_uncertainty_weight(model).weight
    plant = model.transfer_function()
    omega = frequency_grid([plant], points=300)
    W_T = np.abs(weight.frequency_response(omega))
    aim = Weights(ReferenceModel(0.05, 300.0).weight_magnitude(omega), W_T)
    K = synthesise(Loop([plant], omega), aim, PI(1.0)).controller
    norm, _ = h_infinity_norm(weighted_loop(plant, K, W_T=weight))
    nominal, within = plant.frequency_response(omega), 0
    for g in model.sample(300, seed=99):
        drawn = TransferFunction(g, plant.den, 1.0)
        if np.all(np.abs(drawn.frequency_response(omega) / nominal - 1) < W_T / norm):
            within += 1
            assert is_schur(characteristic(drawn, K))
    assert within > 100
    # and the certificate is not idle: a gain beyond what it allows everywhere destabilises the loop
    gains = np.linspace(1.0, 1000.0, 400)
    assert any(
        not is_schur(characteristic(TransferFunction(gain * plant.num, plant.den, 1.0), K))
        for gain in gains
    )
