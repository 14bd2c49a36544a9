"""What may be missing beside the catalogue: inputs that were forgotten and curves to be learned; and where an effect begins.

A forgotten input is a column of the records that the model does not use. It is proposed where what a balance lacks resembles
it, beside the balance's own terms, and where it says something that the outputs do not: a reference, a filtered or differentiated
output resembles whatever is missing in a loop, and acts on nothing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt

from residuum.identification.discrepancy.block_cutting import blocks_of
from residuum.identification.discrepancy.held_out_blocks import Blocks
from residuum.identification.discrepancy.policy.trials import (
    BLOCK_STARTS,
    CURVE_KNOTS,
    MOST_CURVES,
    MOST_FORGOTTEN_INPUTS,
    RESEMBLES,
    TOLD_BY_OUTPUTS,
)
from residuum.identification.discrepancy.track import Track, own_terms, regressed
from residuum.identification.errors import BadInput
from residuum.identification.physics import Experiment, Key, PhysicalModel, conditions_at
from residuum.identification.physics.effects import STRUCTURAL
from residuum.identification.physics.effects.base import Effect
from residuum.identification.physics.model import find_effect, idle_inputs

FloatArray = npt.NDArray[np.float64]


def informed(model: PhysicalModel, experiments: Sequence[Experiment]) -> PhysicalModel:
    """The model with those spare columns of the records as idle inputs that resemble what a balance lacks.

    Notes
    -----
    Where no filter follows the records nothing is known of what a balance lacks, and the model is returned as it is.
    """
    if not any(e.spare for e in experiments):
        return model
    blocks = blocks_of(model, experiments)
    if blocks is None:
        return model
    for name in _resembling(model, blocks.track):
        model = model.with_input(name, blocks.track.experiment.spare[name].unit)
    return model


def _resembling(model: PhysicalModel, along: Track) -> list[str]:
    """Spare columns that what a balance lacks resembles, the most alike first."""
    own = _told_by_outputs(along)
    taken = {*model.states, *model.parameters, *model.inputs, *model.balances}
    columns = {
        n: s.values
        for n, s in along.experiment.spare.items()
        if n not in taken and _share_of(own, s.values - s.values.mean()) < TOLD_BY_OUTPUTS
    }
    bases = {balance: own_terms(model, balance, along.experiment, along.X) for balance in model.balances}
    alike = {n: max(_alike(basis, along.missing[b], s) for b, basis in bases.items()) for n, s in columns.items()}
    likely = sorted((n for n in alike if alike[n] > RESEMBLES), key=lambda n: -alike[n])
    return likely[:MOST_FORGOTTEN_INPUTS]


def uninformed(model: PhysicalModel, like: PhysicalModel) -> PhysicalModel:
    """The model without the inputs that it was informed of and that nothing uses; `like` is what it was before."""
    idle = idle_inputs(model)
    return model.with_inputs_of(name for name in model.inputs if name in like.inputs or name not in idle)


def _told_by_outputs(along: Track) -> FloatArray:
    """Orthonormal basis of the measured outputs, the states and their slopes."""
    Y = along.experiment.Y[:, along.experiment.measured]
    signals = np.column_stack([np.nan_to_num(Y, nan=0.0), along.X])
    every = np.column_stack([signals, np.gradient(signals, axis=0)])
    every = every - every.mean(axis=0)
    u, s, _ = np.linalg.svd(every / np.maximum(np.linalg.norm(every, axis=0), 1e-300), full_matrices=False)
    return np.asarray(u[:, s > 1e-9 * s[0]])


def _share_of(basis: FloatArray, v: FloatArray) -> float:
    power = float(v @ v)
    return float(np.sum((basis.T @ v) ** 2)) / power if power > 0 else 1.0


def _alike(basis: FloatArray, lack: FloatArray, signal: FloatArray) -> float:
    """Part of the lack's power beside the balance's own terms that the signal explains there."""
    rest, own = lack - basis @ (basis.T @ lack), signal - basis @ (basis.T @ signal)
    power = float(rest @ rest) * float(own @ own)
    return float(rest @ own) ** 2 / power if power > 0 else 0.0


def curves(model: PhysicalModel, blocks: Blocks) -> list[Key]:
    """Learned curves: the signals of which a smooth function explains most of what a balance lacks, each balance's best."""
    along, found, present = blocks.track, [], {use.key for use in model.effects}
    names = [*model.states, *model.inputs]
    learned = [effect.id for effect in STRUCTURAL.values() if effect.curve]
    known = dict(zip(model.states, along.X.T, strict=False)) | dict(zip(model.inputs, along.experiment.U.T, strict=False))
    for balance in model.balances:
        basis = own_terms(model, balance, along.experiment, along.X)
        for name in names:
            keys = [key for id in learned if (key := Key(id, f"{balance}({name})")) not in present]
            if keys and name in known and np.ptp(known[name]) > 0:
                share = _explained(basis, along.missing[balance], known[name])
                found += [(share, key) for key in keys]
    return [key for share, key in sorted(found, reverse=True)[:MOST_CURVES] if share > 0.0]


def _explained(basis: FloatArray, lack: FloatArray, signal: FloatArray) -> float:
    """Part of the lack on every second stretch that a curve over the signal, fitted on the others, takes away."""
    at = np.unique(np.quantile(signal, np.linspace(0.0, 1.0, CURVE_KNOTS)))
    if len(at) < 3:
        return 0.0
    hats = np.column_stack([np.interp(signal, at, row) for row in np.eye(len(at))])
    every = np.column_stack([basis, hats])
    kept = (np.arange(len(lack)) * 20 // len(lack)) % 2 == 1
    weights = np.linalg.lstsq(every[~kept], lack[~kept], rcond=1e-6)[0]
    power = float(lack[kept] @ lack[kept])
    left = lack[kept] - every[kept] @ weights
    return 1.0 - float(left @ left) / power if power > 0 else 0.0


def starts(key: Key, blocks: Blocks, experiments: Sequence[Experiment]) -> list[PhysicalModel]:
    """The model with the effect at its own first values, and regressed on what its balance lacked."""
    (id, target), base, effect = key, blocks.base.model, find_effect(key.effect)
    longest = int(np.argmax([e.n for e in experiments]))
    experiment, X = experiments[longest], blocks.states[longest]
    models = []
    for start in list(effect.starts(conditions_at(base, effect, target, experiment, X)))[:BLOCK_STARTS]:
        try:
            if (found := regressed(base, id, target, start, blocks.track)) is not None:
                models.append(found[1])
            if not effect.curve or found is None:
                models.append(base.with_effect(id, target, _flat(effect, start)))
        except (BadInput, NotImplementedError):
            continue
    return models


def _flat(effect: Effect, start: Mapping[str, float]) -> Mapping[str, float]:
    """A start of a curve without its shape, which only a regression knows; any other effect's as it is."""
    return {**start, **dict.fromkeys(effect.sizes, 0.0)} if effect.curve else start
