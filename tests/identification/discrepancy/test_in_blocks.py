"""First looks at blocks: integrated in a third of the steps, they find what looks at every sample find."""

import numpy as np
import pytest

from residuum.identification.discrepancy.fitting.structure_fits import base_structure
from residuum.identification.discrepancy.screening.in_blocks import at_every_sample, in_blocks
from residuum.identification.discrepancy.screening.score_test import Screen
from residuum.identification.physics import Settings, estimate, load_model, match
from residuum.identification.record import Record
from residuum.identification.residual_analysis.averaged import averaged
from residuum.simulation import MACHINES


@pytest.fixture(scope="module")
def screen():
    signals = MACHINES["gate-drive"](seed=5, effects={"quadratic-drag": "medium"}, profile="rich").simulate(12.0)
    record = Record(signals.channels, signals.units, signals.sample_time)
    model, experiments = match(load_model("gate-drive"), [record])
    thinned = averaged(experiments, 2000)
    return Screen(base_structure(model, thinned), thinned)


def test_the_structure_leaves_the_same_residuals_once_a_block(screen):
    every, coarse = screen.every, screen.coarse
    assert (every.experiments[0].block, every.experiments[0].n, coarse.experiments[0].n) == (3, 6000, 2000)
    again = at_every_sample(coarse.base, coarse.experiments)
    np.testing.assert_allclose(again.X[0], coarse.X[0], rtol=0, atol=1e-12)
    middle = every.X[0][1::3]
    assert np.all(np.std(coarse.X[0] - middle, axis=0) < 0.01 * np.std(middle, axis=0))
    slopes = zip(coarse.base.by_parameters[0].T, every.base.by_parameters[0].T, strict=True)
    assert all(np.linalg.norm(c - e) < 0.02 * np.linalg.norm(e) for c, e in slopes)


@pytest.mark.parametrize(
    "candidate",
    [("quadratic-drag", "shaft"), ("coulomb-friction", "shaft"), ("constant-load", "shaft"), ("brush-drop", "winding"),
     ("tooth-ripple", "shaft"), ("input-dead-zone", "voltage"), ("inductance", "winding")],
)  # fmt: skip
def test_a_candidate_promises_what_it_does_at_every_sample(screen, candidate):
    once_a_block = screen.best(*candidate)
    fine = Screen(screen.base, screen.experiments)
    fine.coarse = fine.every
    at_all = fine.best(*candidate)
    assert once_a_block.gain == pytest.approx(at_all.gain, rel=0.03, abs=1.0)


def test_what_a_reading_does_to_each_sample_is_looked_at_there(screen):
    quantised = screen.base.model.with_effect("output-quantisation", "speed", {"q": 0.1})
    rubbing = screen.base.model.with_effect("coulomb-friction", "shaft", {"tau_c": 0.01})
    assert screen.where(quantised) is screen.every
    assert screen.where(rubbing) is screen.coarse


def test_a_winding_faster_than_a_sample_delays_its_current_by_one_and_is_looked_at_there():
    """At blocks of three samples the first-order test took a current that comes a sample late for worse than none."""
    signals = MACHINES["gate-drive"](seed=31, effects={"inductance": "small"}, profile="rich", rate=500.0).simulate(12.0)
    record = Record(signals.channels, signals.units, signals.sample_time)
    model, experiments = match(load_model("gate-drive"), [record])
    thinned = averaged(experiments, 2000)
    winding = Screen(base_structure(model, thinned), thinned)
    assert winding.coarse is not winding.every
    assert winding.best("inductance", "winding").gain > 100.0


def test_without_blocks_nothing_changes(screen):
    experiments = [e.window(0, 1500) for e in screen.experiments]
    alone = at_every_sample(screen.base, [type(e)(**(vars(e) | {"block": 1})) for e in experiments])
    assert in_blocks(alone) is alone


def test_an_estimate_is_left_where_it_cannot_come_near_its_rival(screen):
    there = screen.coarse
    start = there.base.model.with_effect("quadratic-drag", "shaft", {"c": 1e-9})
    start = start.with_values({"R": 2.0 * start.values["R"]})

    def found(rival):
        settings = Settings(weights=np.ones(2), iterations=20, blocks=True, rival=rival)
        return estimate(start, there.experiments, initial=there.base.initial, settings=settings)

    patient = found(np.inf)
    assert found(0.9 * patient.cost).cost == pytest.approx(patient.cost, rel=1e-3)
    hopeless = found(1e-3 * patient.cost)
    assert hopeless.iterations < patient.iterations
