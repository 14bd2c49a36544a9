"""Training a machine's baseline from its own windows: the work of a job; nothing is stored here."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from residuum.diagnosis.diagnosers import DIAGNOSERS
from residuum.identification.errors import BadInput
from residuum.identification.record import Record
from residuum.library.answers.plain import to_plain
from residuum.service.machines.adding.channel_names import named
from residuum.service.machines.adding.model_texts import ModelText
from residuum.service.machines.judging.kept_diagnosers import content_of, diagnoser_of_content
from residuum.service.views.model_view import model_of
from residuum.service.work.jobs import Progress
from residuum.service.work.record_parts import RecordParts


def train_baseline(
    progress: Progress,
    diagnoser: str,
    windows: Sequence[RecordParts],
    channels: Mapping[str, str],
    model: ModelText | None,
    settings: Mapping[str, Any],
    present: bytes | None = None,
) -> Mapping[str, Any]:
    """Train a diagnoser on windows of a machine and judge these same windows with it.

    `present` is the baseline that is at work: it is asked first whether these windows may be learned from.

    Returns
    -------
    mapping
        `learned` (what training found), `windows`, `alarms` (how many of the windows the new baseline would call faulty),
        `baseline` (its file).

    Raises
    ------
    BadInput
        Windows that the diagnoser cannot learn from.
    """
    progress(0.05, f"training {diagnoser} on {len(windows)} windows")
    records = [named(Record(*parts), channels) for parts in windows]
    if present is not None:
        progress(0.1, "asking the present baseline whether these windows are healthy")
        diagnoser_of_content(DIAGNOSERS[diagnoser], present).refuse_learning(records)
    deciding = {name: value for name, value in settings.items() if name == "method"}
    own = {name: value for name, value in settings.items() if name != "method"}
    own |= {} if model is None else {"model": model_of(*model)}
    try:
        untrained = DIAGNOSERS[diagnoser](**own)
    except TypeError:
        raise BadInput(f"diagnoser {diagnoser!r}: takes no {', '.join(own)}") from None
    trained = untrained.with_settings(**deciding).fit(records)
    progress(0.7, "judging the windows of the training")
    verdicts = [trained.score(record).verdict.value for record in records]
    return {
        "diagnoser": diagnoser,
        "windows": len(records),
        "alarms": verdicts.count("faulty"),
        "learned": to_plain(trained.learned()),
        "baseline": content_of(trained),
    }
