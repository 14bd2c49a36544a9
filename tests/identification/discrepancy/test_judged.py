"""Errors on unseen blocks: blocks deleted in closed form beside blocks that a refit was never shown."""

from dataclasses import replace

import numpy as np
import pytest

from residuum.identification.discrepancy.data import matched
from residuum.identification.discrepancy.judged import judged
from residuum.identification.discrepancy.scale import clipped, plain
from residuum.identification.discrepancy.structure import Structure, first_states, fitted
from residuum.identification.physics import Simulator, load_model
from residuum.identification.record import Record
from residuum.simulation import MACHINES


@pytest.fixture(scope="module")
def data():
    signals = MACHINES["gate-drive"](seed=11, effects={"coulomb-friction": "medium"}, profile="rich", rate=100.0).simulate(12.0)
    return matched(load_model("gate-drive"), [Record(signals.channels, signals.units, signals.sample_time)], None)


def refitted(whole, data, rung, scale):
    """Power of each block, by models estimated with the blocks of its fold masked; first states stay, as in deletion."""
    power = np.zeros((data.blocks, int(data.measured.sum())))
    for fold in np.unique(data.fold):
        aside = data.fold[rung.block] == fold
        (e,) = rung.parts
        masked = [replace(e, Y=np.where(aside[:, None], np.nan, e.Y), known=first_states(whole)[0])]
        found = fitted(whole.model, masked, first_states(whole), scale, steps=30, tolerance=1e-9)
        simulator = Simulator(found.model)
        run = simulator.run_each(rung.parts, found.initial, simulator.p(), substeps=found.substeps)
        left = np.nan_to_num(run.errors * scale.weights)[:, data.measured]
        for block in np.flatnonzero(data.fold == fold):
            power[block] = (left[rung.block == block] ** 2).sum(axis=0)
    return power


@pytest.mark.parametrize("effects", [(), ("coulomb-friction",), ("quadratic-drag", "constant-load")])
def test_deletion_is_what_a_refit_without_the_blocks_leaves(data, effects):
    model, rung, scale = data.model, data.rungs[-1], plain(data)
    for effect in effects:
        model = model.with_effect(effect, "shaft", {"tau_c": 0.02} if effect == "coulomb-friction" else None)
    found = fitted(model, rung.parts, None, scale, steps=30, tolerance=1e-9)
    structure = Structure((), model, {}, {}).at(rung, found)
    one = judged(structure, found, rung, data, scale)
    truth = refitted(found, data, rung, scale)
    assert one.power.sum() == pytest.approx(truth.sum(), rel=0.2)
    assert one.power.sum() > (np.nan_to_num(np.concatenate(found.residuals) * scale.weights) ** 2).sum()


def test_an_event_counts_as_no_more_than_its_limit(data):
    rung, scale = data.rungs[-1], plain(data)
    (e,) = rung.parts
    hit = replace(e, Y=e.Y + np.where(np.arange(e.n) == 600, 500.0, 0.0)[:, None])
    struck = replace(rung, parts=[hit])
    found = fitted(data.model, struck.parts, None, scale, steps=30, tolerance=1e-9)
    structure = Structure((), data.model, {}, {}).at(struck, found)
    open_, limited = (judged(structure, found, struck, data, s) for s in (scale, clipped(scale, found.residuals, struck)))
    block = rung.block[600]
    assert open_.power[block].sum() > 0.5 * open_.power.sum() or open_.power[block].sum() > 5.0 * limited.power[block].sum()


def test_errors_are_told_in_the_outputs_units(data):
    rung, scale = data.rungs[-1], plain(data)
    found = fitted(data.model, rung.parts, None, scale, steps=30, tolerance=1e-9)
    one = judged(Structure((), data.model, {}, {}).at(rung, found), found, rung, data, scale)
    seen = np.sqrt(np.nanmean(np.concatenate(found.residuals) ** 2, axis=0))
    np.testing.assert_array_less(seen, one.rms)
    np.testing.assert_allclose(one.rms, seen, rtol=0.2)
