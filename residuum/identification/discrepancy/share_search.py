"""The search by share: effects join one after the other, along two ways at once, and the better end is kept.

The candidate that takes most away may be a flexible one that stands for two simple ones (a hysteresis for Coulomb and viscous
friction, a sine over the position for an offset and a drag). So the search also begins with the simplest that is real, and the
ends are compared on the same blocks: the better one is kept, of two that cannot be told apart the simpler. Two effects may be
real together of which none is alone: a tank that runs over sometimes, and drains otherwise than the model says.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

from residuum.identification.discrepancy.block_cutting import blocks_of
from residuum.identification.discrepancy.held_out_blocks import Blocks, Errors, cross_judged, looked_at
from residuum.identification.discrepancy.policy.blocks import LEAST_SHARE, MOST_STEPS, PAIR_LEADS, REAL
from residuum.identification.discrepancy.proposals import curves
from residuum.identification.discrepancy.share import Shared, ShareStep, judged_against, preferred, share_step
from residuum.identification.physics import Experiment, Key, PhysicalModel, candidates
from residuum.identification.residual_analysis.policy.noise import BEYOND_NOISE
from residuum.identification.work import OutOfWork, left_out


@dataclass(eq=False)
class ShareSearch:
    """The steps taken, and the blocks of the first."""

    blocks: Blocks
    steps: list[ShareStep] = field(default_factory=list)

    @property
    def joined(self) -> list[Shared]:
        """What joined, one a step, each with the model of all up to it."""
        return [step.accepted for step in self.steps if step.accepted is not None]

    @property
    def accepted(self) -> list[Key]:
        """The effects that joined, one a step."""
        return [shared.key for shared in self.joined]

    @property
    def model(self) -> PhysicalModel:
        """The base with them, estimated on the training blocks."""
        return self.joined[-1].model if self.joined else self.steps[0].base


def search_by_share(
    model: PhysicalModel, experiments: Sequence[Experiment], effects: Sequence[str] | None = None, *, learned: bool = False
) -> ShareSearch | None:
    """Grow the model by the effects that take away most on blocks kept aside, while one is real.

    Parameters
    ----------
    model : PhysicalModel
    experiments : sequence of Experiment
        Whole records; the blocks are cut here.
    effects : sequence of effect id
        Consider only these (default: all that fit).
    learned : bool
        Where no effect with a name is real, learn a curve over one signal.

    Returns
    -------
    The search, or None where the records are too short for blocks or no filter follows them.

    Notes
    -----
    Fails where an effect shows only over times longer than a block, and sees little where most of a block's error is noise.
    """
    try:
        blocks = blocks_of(model, experiments)
        base = None if blocks is None else cross_judged(blocks.base, blocks)
    except OutOfWork:
        left_out("what takes away most on blocks kept aside")
        return None
    if blocks is None or base is None:
        return None
    wanted = _Wanted(experiments, effects, learned)
    first = _step_on(blocks, base[1], wanted, [])
    if first.accepted is None and base[1].stands_out(blocks.noise, BEYOND_NOISE):
        return _together(first, blocks, base[1], wanted) or ShareSearch(blocks, [first])
    ends = [ShareSearch(blocks, [step, *_further(step, wanted)]) for step in _beginnings(first)]
    if len(ends) == 1:
        return ends[0]
    try:
        judged = [_as_one(end, blocks, base[1]) for end in ends]
    except OutOfWork:
        left_out("a second way of adding effects")
        return ends[0]
    return _better(list(zip(ends, judged, strict=True)), base[1])


@dataclass(frozen=True)
class _Wanted:
    """What is searched on: whole experiments, the effects that are considered, and whether curves may be learned."""

    experiments: Sequence[Experiment]
    effects: Sequence[str] | None
    learned: bool


def _beginnings(first: ShareStep) -> list[ShareStep]:
    """The first step as it is, and led by the simplest that is real."""
    simplest = first.simplest
    if first.accepted is None or simplest is None or simplest.simplicity >= first.accepted.simplicity:
        return [first]
    return [first, first.led_by(simplest)]


def _together(first: ShareStep, blocks: Blocks, before: Errors, wanted: _Wanted) -> ShareSearch | None:
    """Something is missing for certain and nothing alone is real: what begins with one of those that take most, and is real as a
    whole. None where nothing is.
    """
    judged = []
    for leading in [s for s in first.judged[:PAIR_LEADS] if s.share > LEAST_SHARE]:
        led = first.led_by(leading)
        end = ShareSearch(blocks, [led, *_further(led, wanted)])
        try:
            one = _as_one(end, blocks, before) if len(end.accepted) > 1 else None
        except OutOfWork:
            left_out("effects that are real together alone")
            break
        if one is not None and one.share > LEAST_SHARE and one.p_value < REAL / PAIR_LEADS:
            end.steps[0] = first.led_by(replace(leading, p_value=one.p_value))
            judged.append((end, one))
    return _better(judged, before) if judged else None


def _further(step: ShareStep, wanted: _Wanted) -> Iterator[ShareStep]:
    """The steps that follow, while one is real and there is work left."""
    taken: list[Key] = []
    while step.accepted is not None and len(taken) < MOST_STEPS - 1:
        taken.append(step.accepted.key)
        try:
            blocks = blocks_of(step.accepted.model, wanted.experiments)
            base = None if blocks is None else cross_judged(blocks.base, blocks)
        except OutOfWork:
            left_out(f"effects beside {step.accepted.key.effect}")
            return
        if blocks is None or base is None:
            return
        step = _step_on(blocks, base[1], wanted, taken)
        yield step


def _step_on(blocks: Blocks, before: Errors, wanted: _Wanted, taken: Sequence[Key]) -> ShareStep:
    model = blocks.base.model
    keys = [key for key in candidates(model, wanted.effects) if key not in taken]
    step = share_step(blocks, wanted.experiments, before, keys)
    if step.accepted is None and wanted.learned:
        return share_step(blocks, wanted.experiments, before, curves(model, blocks))
    return step


def _better(judged: Sequence[tuple[ShareSearch, Shared | None]], before: Errors) -> ShareSearch:
    """Of ends, each with what it takes away as one: that which leaves least, or the simpler of two that cannot be told apart."""
    known = [(end, one) for end, one in judged if one is not None]
    chosen = preferred(sorted((one for _, one in known), key=lambda one: -one.share), before)
    return next((end for end, one in known if one is chosen), judged[0][0])


def _as_one(end: ShareSearch, blocks: Blocks, before: Errors) -> Shared | None:
    """All effects of an end as if they were one: what they take away together, and how many parameters they have."""
    found = cross_judged(looked_at(end.model, blocks), blocks)
    if found is None or not end.joined:
        return None
    one = judged_against(before, end.joined[0].key, found)
    return replace(one, model=end.model, simplicity=sum(each.simplicity for each in end.joined))
