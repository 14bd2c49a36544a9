"""The score test: what it shares between candidates is what each would have found by itself."""

import numpy as np
import pytest

from residuum.identification.discrepancy.fitting.structure_fits import base_structure
from residuum.identification.discrepancy.screening.linearisation import at_rest, linearised
from residuum.identification.discrepancy.screening.score_test import Screen
from residuum.identification.physics import candidates, load_model, match
from residuum.identification.physics.effects import EFFECTS
from residuum.identification.record import Record
from residuum.simulation import MACHINES


@pytest.fixture(scope="module")
def screen():
    signals = MACHINES["gate-drive"](seed=3, effects={"viscous-friction": "small"}).simulate(4.0)
    record = Record(signals.channels, signals.units, signals.sample_time)
    model, experiments = match(load_model("gate-drive"), [record])
    return Screen(base_structure(model, experiments), experiments)


def test_effects_at_rest_take_the_slopes_of_the_base(screen):
    shared = 0
    for id, target in candidates(screen.base.model):
        effect = EFFECTS[id]
        if effect.rest > 0 or not effect.sizes:
            continue
        start = screen.starts(id, target)[0]
        model = screen.base.model.with_effect(id, target, effect.at_rest(start))
        own = [f"{model.effects[-1].label}.{n}" for n in effect.sizes]
        own = [name for name in own if name in model.free]
        found = at_rest(model, own, screen.where(model))
        alone = linearised(model, [*screen.base.parameters, *own], screen.where(model))
        if found is None or alone is None:
            continue
        shared += 1
        for lent, computed in zip(found, alone, strict=True):
            scale = np.abs(computed[0]).max(axis=0) + 1e-300
            np.testing.assert_allclose(lent[0] / scale, computed[0] / scale, atol=2e-5, err_msg=id)
    assert shared >= 8


def test_an_effect_that_moves_the_outputs_is_not_at_rest(screen):
    model = screen.base.model.with_effect("constant-load", "shaft", {"tau_0": 0.05})
    assert at_rest(model, [f"{model.effects[-1].label}.tau_0"], screen.where(model)) is None
