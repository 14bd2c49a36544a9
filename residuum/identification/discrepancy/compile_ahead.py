"""Compile at installation what comparing and explaining would compile at their first use: `python -m …compile_ahead`.

The loops are compiled once for all models and kept on disk; that takes half a minute, in which a user would wait for
a first answer. A model's own equations are compiled when they are met.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from residuum.code_folder import code_folder
from residuum.identification.discrepancy.explain import explain
from residuum.identification.physics import PhysicalModel, Simulator, block_means, candidates, find_effect, load_model, match
from residuum.identification.record import Record
from residuum.identification.residual_analysis.compare import compare
from residuum.identification.work import Tell, untold
from residuum.kept_loops import made_of


def compile_ahead() -> None:
    """Compare and explain a small record of the built-in drive, whose friction the model lacks."""
    model = load_model("gate-drive")
    sticks = next(key for key in candidates(model) if find_effect(key.effect).rest > 0.0)
    record = _record(model.with_effect(*sticks, dict.fromkeys(find_effect(sticks.effect).sizes, 0.02)))
    compare(model, [record])
    explain(model, [record])
    block_means(np.zeros((2, 1)), 2)  # so short a record is not averaged


def ensure_compiled(tell: Tell = untold) -> None:
    """`compile_ahead` where nothing was compiled for these sources yet, so that no search's time is spent on it."""
    marker = code_folder("loops", "NUMBA_CACHE_DIR") / f"ahead_{made_of(Path(__file__))[:24]}"
    if not marker.exists():
        tell(0.0, "compiling once, about a minute")
        compile_ahead()
        marker.touch()


def _record(truth: PhysicalModel) -> Record:
    """Steps of the inputs, and what the model answers, with noise."""
    rng, samples = np.random.default_rng(0), 600
    inputs = {name: np.repeat(rng.normal(scale=6.0, size=samples // 20), 20) for name in truth.inputs}
    units = {n: signal.unit for n, signal in truth.inputs.items()} | {n: output.unit for n, output in truth.outputs.items()}
    nothing = {name: np.zeros(samples) for name in truth.outputs}
    empty = Record({**inputs, **nothing}, units, sample_time=5e-3)
    _, (experiment,) = match(truth, [empty])
    Y = Simulator(truth).run(experiment).Y
    measured = {name: y + rng.normal(scale=0.02 * np.std(y), size=y.size) for name, y in zip(truth.outputs, Y.T, strict=True)}
    return replace(empty, channels={**inputs, **measured})


if __name__ == "__main__":
    ensure_compiled()
