"""Improve a model that no structure of the catalogue makes exact: what takes away most on blocks kept aside joins it.

All records are cut into blocks; every block is judged by a model that was estimated without it, so nothing has to be set aside
for good. The effects that `explain` found are judged once more on all of the data, and the model that is returned is estimated
at its least simulation error on everything.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from residuum.identification.discrepancy.block_cutting import blocks_of
from residuum.identification.discrepancy.held_out_blocks import Blocks, Errors, cross_judged, estimated_on_all, looked_at
from residuum.identification.discrepancy.policy.blocks import LEAST_SHARE, SHARE_WORK
from residuum.identification.discrepancy.share_search import search_by_share
from residuum.identification.physics import Estimate, Experiment, PhysicalModel, with_coloured_noise
from residuum.identification.work import at_most

ASIDE = "every block in turn"
"""What is kept aside, in words."""


@dataclass(frozen=True, eq=False)
class Joined:
    """The model on everything, and how its error on blocks kept aside fell: `errors` begins with that of the model as it was.

    `std` are the standard deviations of its parameters by full name, `output` the one whose errors are told.
    """

    model: PhysicalModel
    added: list[str]
    errors: list[float]
    std: Mapping[str, float]
    output: str


def joined_by_share(
    model: PhysicalModel,
    experiments: Sequence[Experiment],
    effects: Sequence[str] | None,
    *,
    learned: bool = False,
    seconds: float | None = None,
) -> Joined | None:
    """Add those of the `effects` that are real on blocks kept aside, one after the other; None where no blocks can be cut.

    Effects None are all that fit. After `SHARE_WORK`, or so many `seconds`, what was found so far joins.
    """
    with at_most(SHARE_WORK, seconds):
        shares = search_by_share(model, experiments, effects, learned=learned)
    if shares is None:
        return None
    models, errors = without_idle([shared.model for shared in shares.joined], shares.blocks)
    return _on_everything(models, experiments, shares.blocks, errors)


def without_idle(joined: Sequence[PhysicalModel], blocks: Blocks) -> tuple[list[PhysicalModel], list[Errors | None]]:
    """The base and the models of the steps after it, less what takes no share of the error of the last one without it; and what
    each leaves, estimated again.
    """
    base = cross_judged(blocks.base, blocks)
    models, errors = [blocks.base.model, *joined], [None if base is None else base[1], *(_left(m, blocks) for m in joined)]
    for k in reversed(range(1, len(models))):
        idle = models[k].effects[-1].label
        rest = [model.without_effect(idle) for model in models[k + 1 :]]
        if not _takes_more(errors[-1], _left(rest[-1], blocks) if rest else errors[k - 1]):
            models, errors = [*models[:k], *rest], [*errors[:k], *(_left(m, blocks) for m in rest)]
    return models, errors


def _left(model: PhysicalModel, blocks: Blocks) -> Errors | None:
    """What the model, estimated again, leaves on the blocks kept aside; None where it diverges."""
    judged = cross_judged(looked_at(model, blocks), blocks)
    return None if judged is None else judged[1]


def _takes_more(after: Errors | None, before: Errors | None) -> bool:
    """Whether an effect still takes a share of what was left before it.

    Estimated again it may end where it does nothing, such as a play so wide that nothing ever touches.
    """
    return after is not None and (before is None or 1.0 - float(after.relative(before).sum()) >= LEAST_SHARE)


def _on_everything(
    models: Sequence[PhysicalModel], experiments: Sequence[Experiment], judging: Blocks, errors: Sequence[Errors | None]
) -> Joined:
    """The last model on all data; the errors that are told are those of the output that erred most above its noise."""
    model = models[-1]
    blocks = blocks_of(model, experiments)
    look = looked_at(model, judging) if blocks is None else None
    if look is not None:  # its own filter diverges, its simulation does not
        blocks = replace(judging, base=look)
    found = None if blocks is None else estimated_on_all(blocks)
    final = model if found is None else found.model
    noise = np.where(judging.noise > 0, judging.noise, np.finfo(float).tiny)
    o = 0 if errors[0] is None else int(np.nanargmax(errors[0].rms / noise))
    added = [each.effects[-1].id for each in models[1:]]
    return Joined(
        final,
        added,
        [np.inf if each is None else float(each.rms[o]) for each in errors],
        _doubts(found, experiments),
        list(final.outputs)[o],
    )


def _doubts(found: Estimate | None, experiments: Sequence[Experiment]) -> dict[str, float]:
    """Standard deviations of the parameters beside noise of the residuals' colour."""
    if found is None:
        return {}
    if len(found.residuals) == len(experiments):
        found = with_coloured_noise(found, experiments)
    return dict(zip(found.parameters, np.sqrt(np.diag(found.covariance)).tolist(), strict=True))
