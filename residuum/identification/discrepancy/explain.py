"""Explain: which physical effect is missing in a model?"""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping, Sequence

from residuum.identification.blas_threads import one_thread
from residuum.identification.discrepancy.explanation import Explanation
from residuum.identification.discrepancy.on_blocks import answer_on_blocks
from residuum.identification.errors import BadRecord
from residuum.identification.physics import PhysicalModel
from residuum.identification.record import Record
from residuum.identification.unseen_blocks.at_its_rate import searched
from residuum.identification.unseen_blocks.forgotten_inputs import informed
from residuum.identification.unseen_blocks.policy import FEWEST_TO_JUDGE
from residuum.identification.unseen_blocks.tried import Wanted
from residuum.identification.work import Tell, at_most, part_of, untold


@one_thread()
def explain(
    model: PhysicalModel,
    records: Sequence[Record],
    mapping: Mapping[str, str] | None = None,
    *,
    effects: Iterable[str] | None = None,
    learned: bool = False,
    seconds: float | None = None,
    tell: Tell = untold,
) -> Explanation:
    """Name the physical effect that is missing in a model.

    Parameters
    ----------
    model : PhysicalModel
        Its free parameters are re-estimated; its structure is what is judged, and whether a fixed
        value explains more.
    records : sequence of Record
        Each is an experiment with its own initial states.
    mapping : mapping of model name to column
    effects : iterable of effect id
        Consider only these (default: all that fit the model).
    learned : bool
        Consider curves to be learned over one signal, too.
    seconds : float, optional
        Time after which the search is left as well as after its work; the answer then depends on
        the machine, and says so.
    tell : callable
        Told how far the work is.

    Returns
    -------
    The answer; its verdict is `adequate` only where `compare` finds no structure in what the re-estimated model leaves.

    Raises
    ------
    BadRecord, BadUnit, BadModel
        Columns that do not fit the model; fewer than 40 samples in all; an effect that is not in
        the catalogue.
    NotIdentifiable
        The model diverges on a record.

    Notes
    -----
    Effects are named by what they take away on blocks of the records that no fit has seen: in power while what is left is not its
    own noise, in the likelihood of that noise from there on.

    Fails where a disturbance is synchronous with the input, and where two effects act alike in this
    experiment (they are then named as a group).
    """
    check_length(records)
    return explained(
        model,
        records,
        mapping,
        Wanted(None if effects is None else tuple(effects), learned),
        seconds,
        tell,
    )


def check_length(records: Sequence[Record]) -> None:
    """BadRecord where the records are so short together that an effect may follow every sample."""
    samples = sum(record.n for record in records)
    if samples < FEWEST_TO_JUDGE:
        names = ", ".join(repr(record.source) for record in records)
        raise BadRecord(
            f"record {names}: {samples} samples; at least {FEWEST_TO_JUDGE} are needed to tell what"
            " is missing from noise: record longer or faster, or give several records"
        )


def explained(
    model: PhysicalModel,
    records: Sequence[Record],
    mapping: Mapping[str, str] | None,
    wanted: Wanted,
    seconds: float | None,
    tell: Tell,
) -> Explanation:
    """The answer by what takes away most on unseen blocks of the records."""
    with at_most():
        began = time.perf_counter()
        model = informed(model, records, mapping, wanted)
        left = None if seconds is None else seconds - (time.perf_counter() - began)
        search = searched(
            model, records, mapping, wanted, seconds=left, tell=part_of(tell, 0.0, 0.9)
        )
        tell(0.9, "drawing what no effect explains")
        return answer_on_blocks(search, wanted, records, mapping, began)
