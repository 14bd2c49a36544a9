"""Compile at installation what comparing and explaining would compile at their first use: `python -m …compile_ahead`.

The loops are compiled once for all models and kept beside their sources; that takes half a minute, in which a user would wait for
a first answer. A model's own equations are compiled when they are met.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from residuum.identification.discrepancy.compare import compare
from residuum.identification.discrepancy.explain import explain
from residuum.identification.physics import PhysicalModel, Simulator, block_means, load_model, match
from residuum.identification.record import Record

_SAMPLES, _SAMPLE_TIME = 600, 5e-3


def compile_ahead() -> None:
    """Compare and explain a small record of the built-in drive, whose friction the model lacks."""
    model = load_model("gate-drive")
    record = _record(model.with_effect("coulomb-friction", "shaft", {"tau_c": 0.02}))
    compare(model, [record])
    explain(model, [record])
    block_means(np.zeros((2, 1)), 2)  # so short a record is not averaged


def _record(truth: PhysicalModel) -> Record:
    """Steps of the inputs, and what the model answers, with noise."""
    rng = np.random.default_rng(0)
    inputs = {name: np.repeat(rng.normal(scale=6.0, size=_SAMPLES // 20), 20) for name in truth.inputs}
    units = {n: signal.unit for n, signal in truth.inputs.items()} | {n: output.unit for n, output in truth.outputs.items()}
    nothing = {name: np.zeros(_SAMPLES) for name in truth.outputs}
    empty = Record({**inputs, **nothing}, units, _SAMPLE_TIME)
    _, (experiment,) = match(truth, [empty])
    Y = Simulator(truth).run(experiment).Y
    measured = {name: y + rng.normal(scale=0.02 * np.std(y), size=y.size) for name, y in zip(truth.outputs, Y.T, strict=True)}
    return replace(empty, channels={**inputs, **measured})


if __name__ == "__main__":
    compile_ahead()
