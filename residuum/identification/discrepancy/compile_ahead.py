"""Compile what comparing and explaining would compile at their first use: `python -m …compile_ahead
[--with-parent]`.

The loops are compiled once for all models and kept on disk; that takes about a minute, in which a
user would wait for a first answer. A running service has it done behind itself. A model's own
equations are compiled when they are met. With `--with-parent` it ends when standard input closes,
that is, with the program that started it, however that ended.
"""

from __future__ import annotations

import fcntl
import os
import sys
import threading
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from residuum.code_folder import code_folder
from residuum.identification.record import Record
from residuum.identification.work import Tell, untold
from residuum.kept_loops import made_of

if TYPE_CHECKING:
    from residuum.identification.physics import PhysicalModel

# What is compiled is imported where it is: whether it was compiled is also asked by a service that
# never explains.


def compile_ahead() -> None:
    """Compare and explain a small record of the built-in drive, whose friction the model lacks."""
    from residuum.identification.discrepancy.explain import explain  # noqa: PLC0415
    from residuum.identification.physics import (  # noqa: PLC0415
        block_means,
        candidates,
        find_effect,
        load_model,
    )
    from residuum.identification.residual_analysis.compare import compare  # noqa: PLC0415

    model = load_model("gate-drive")
    sticks = next(key for key in candidates(model) if find_effect(key.effect).rest > 0.0)
    record = _record(
        model.with_effect(*sticks, dict.fromkeys(find_effect(sticks.effect).sizes, 0.02))
    )
    compare(model, [record])
    explain(model, [record])
    block_means(np.zeros((2, 1)), 2)  # so short a record is not averaged


def is_compiled() -> bool:
    """Whether these sources were compiled ahead, by this process or another."""
    return _marker().exists()


def ensure_compiled(tell: Tell = untold) -> None:
    """`compile_ahead` where nothing was compiled for these sources yet, so that no search's time is
    spent on it.

    Of several processes that ask at once, one compiles and the others wait for it.
    """
    if is_compiled():
        return
    tell(0.0, "compiling once, about a minute")
    with _marker().with_suffix(".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not is_compiled():
            compile_ahead()
            _marker().touch()


def _marker() -> Path:
    return code_folder("loops", "NUMBA_CACHE_DIR") / f"ahead_{made_of(Path(__file__))[:24]}"


def _record(truth: PhysicalModel) -> Record:
    """Steps of the inputs, and what the model answers, with noise."""
    from residuum.identification.physics import Simulator, match  # noqa: PLC0415

    rng, samples = np.random.default_rng(0), 600
    inputs = {
        name: np.repeat(rng.normal(scale=6.0, size=samples // 20), 20) for name in truth.inputs
    }
    units = {n: signal.unit for n, signal in truth.inputs.items()} | {
        n: output.unit for n, output in truth.outputs.items()
    }
    nothing = {name: np.zeros(samples) for name in truth.outputs}
    empty = Record({**inputs, **nothing}, units, sample_time=5e-3)
    _, (experiment,) = match(truth, [empty])
    Y = Simulator(truth).run(experiment).Y
    measured = {
        name: y + rng.normal(scale=0.02 * np.std(y), size=y.size)
        for name, y in zip(truth.outputs, Y.T, strict=True)
    }
    return replace(empty, channels={**inputs, **measured})


def _end_with_parent() -> None:
    sys.stdin.buffer.read()
    os._exit(1)


if __name__ == "__main__":
    if "--with-parent" in sys.argv:
        threading.Thread(target=_end_with_parent, daemon=True).start()
    ensure_compiled()
