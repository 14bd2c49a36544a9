"""Baselines of machines: trained on windows that were healthy, stored, accepted."""

from __future__ import annotations

import hashlib
import os
import tempfile
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import orjson

from residuum.diagnosis.diagnosers import DIAGNOSERS
from residuum.diagnosis.diagnosers.base import Diagnoser
from residuum.diagnosis.diagnosers.model_based import ModelBased
from residuum.diagnosis.finding import Finding, Verdict
from residuum.diagnosis.thresholds.tails import HealthyBand
from residuum.identification.errors import BadInput
from residuum.identification.physics import PhysicalModel, estimate, match
from residuum.identification.physics.fmu.permission import (
    check_allowed,
    fmus_allowed,
    holds_fmu,
    is_packed,
)
from residuum.identification.record import Record
from residuum.library.answers.plain import to_plain
from residuum.nearest_names import did_you_mean
from residuum.service.fieldbus.settings import MachineSettings
from residuum.service.machines.adding import KIND, ModelText, document_name, kept_document, named
from residuum.service.machines.scoring import (
    content_of,
    diagnoser_class,
    diagnoser_of_content,
)
from residuum.service.machines.windows import REMEDY, holed, kept_windows
from residuum.service.storage.disk_store import DiskStore
from residuum.service.store import Conflict, ModelVersion, NotFound, Outcome
from residuum.service.views.model_view import model_of
from residuum.service.work.jobs import Progress
from residuum.service.work.own_process import OwnProcess, ProcessEnded
from residuum.service.work.worker_pool import RecordParts

# What accepting a model for a machine would change: its diagnoser's thresholds, and the error of
# the model that is healthy.
# The work of a job; nothing is stored here.

FALSE_ALARM = 1e-3
"""Share of healthy windows whose model error may exceed its limit."""
# Healthy records, the newest, that both models are simulated beside: a movement at 5 kHz costs
# seconds a model.
_MODELLED = 8
# Windows, of whose errors' logarithms a mean and a deviation, and so Student's limit, are taken.
_FEWEST_MODELLED = 5


def propose(
    progress: Progress,
    diagnoser: str,
    baseline: bytes | None,
    learned: Sequence[RecordParts],
    checked: Sequence[RecordParts],
    models: tuple[ModelText | None, ModelText],
    mapping: Mapping[str, str],
) -> Mapping[str, Any]:
    """Learn a diagnoser's limits anew from healthy records, and hold old and new against each other
    on healthy windows.

    Parameters
    ----------
    baseline : bytes or None
        The stored diagnoser that is at work; None when there is none.
    learned, checked : records
        Healthy data to learn from, and later healthy windows that were not learned from.
    models : pair
        The active model (None: there is none yet) and the one to be accepted.

    Returns
    -------
    mapping
        `thresholds`, by name `old`, `new`, `unit`; `alarms`, how many of the checked windows each
        diagnoser would call faulty; `model_error`, by output the limit that a healthy window's RMS
        simulation error passes once in a thousand windows (Student's limit of a log-normal RMS), of
        both models, or `reason` why the windows cannot be simulated; `baseline`, the new
        diagnoser's file.

    Raises
    ------
    BadInput
        Records that the diagnoser cannot learn from.
    """
    progress(0.05, f"learning the limits of {diagnoser} from {len(learned)} healthy records")
    kind = DIAGNOSERS[diagnoser]
    records, windows = ([Record(*parts) for parts in group] for group in (learned, checked))
    old = None if baseline is None else diagnoser_of_content(kind, baseline, fmus=True)
    new = _relearned(old or kind(), records, models[1])
    progress(0.6, f"judging {len(windows)} healthy windows with both")
    # on windows that neither learned from: on its own a diagnoser hardly ever raises an alarm
    before = [] if old is None else [old.score(window) for window in windows]
    after = [new.score(window) for window in windows]
    progress(0.8, "simulating healthy windows with both models")
    return {
        "diagnoser": diagnoser,
        "learned_from": len(learned),
        "thresholds": _thresholds(before, after),
        "alarms": {
            "windows": len(windows),
            "old": _faulty(before) if old else None,
            "new": _faulty(after),
        },
        "model_error": _model_errors(models, (records + windows)[-_MODELLED:], mapping),
        "baseline": content_of(new),
    }


def _relearned(old: Diagnoser, records: Sequence[Record], accepted: ModelText) -> Diagnoser:
    """Learned anew, where the diagnoser watches by a model with the one that is to be accepted."""
    if isinstance(old, ModelBased):
        return old.relearned(records, model_of(*accepted))
    return old.relearned(records)


def _faulty(findings: Sequence[Finding]) -> int:
    return sum(finding.verdict is Verdict.FAULTY for finding in findings)


def _thresholds(before: Sequence[Finding], after: Sequence[Finding]) -> dict[str, Any]:
    """The middle of each threshold over the checked windows, old against new."""
    old, new = _middle(before), _middle(after)
    units = {name: unit for finding in (*before, *after) for name, unit in finding.units.items()}
    return {
        name: {"old": old.get(name), "new": new.get(name), "unit": units.get(name, "")}
        for name in {**old, **new}
    }


def _middle(findings: Sequence[Finding]) -> dict[str, float]:
    thresholds: dict[str, list[float]] = {}
    for finding in findings:
        for name, value in finding.thresholds.items():
            thresholds.setdefault(name, []).append(value)
    return {name: float(np.median(values)) for name, values in thresholds.items()}


def _model_errors(
    models: tuple[ModelText | None, ModelText],
    windows: Sequence[Record],
    mapping: Mapping[str, str],
) -> dict[str, Any]:
    try:
        old, new = (None if model is None else _limits(model, windows, mapping) for model in models)
    except BadInput as error:
        return {"reason": str(error), "outputs": {}}
    outputs = {
        name: {"unit": unit, "old": (old or {}).get(name, (None, unit))[0], "new": limit}
        for name, (limit, unit) in (new or {}).items()
    }
    return {"reason": None, "windows": len(windows), "outputs": outputs}


def _limits(
    model: ModelText, windows: Sequence[Record], mapping: Mapping[str, str]
) -> dict[str, tuple[float, str]]:
    """Limit and unit of every measured output's RMS error in a healthy window."""
    if len(windows) < _FEWEST_MODELLED:
        raise BadInput(
            f"{len(windows)} healthy windows; at least {_FEWEST_MODELLED} are needed for a limit of"
            " the model's error"
        )
    errors = []
    for window in windows:
        matched, experiments = match(model_of(*model), [window], mapping)
        errors.append(estimate(matched, experiments, free=()).rmse)
    outputs = list(matched.outputs.values())
    rms = np.array(errors)
    # an output that a window does not measure, or that is followed exactly, has no logarithm
    measured = [k for k in range(len(outputs)) if np.all(np.isfinite(rms[:, k]) & (rms[:, k] > 0))]
    limits = HealthyBand.of(rms[:, measured]).upper(FALSE_ALARM)
    return {
        outputs[k].name: (float(limit), outputs[k].unit)
        for k, limit in zip(measured, limits, strict=True)
    }


# A stored baseline as a file that worker processes can load.


def baseline_file(data: Path, content: bytes) -> str:
    """The name of the file with this content, below the data folder; written once, however many ask
    for it at once.
    """
    file = _file_of(data, hashlib.sha256(content).hexdigest())
    file.parent.mkdir(parents=True, exist_ok=True)
    if not file.exists():
        # written beside and moved: a worker that finds the name finds the whole file
        handle, part = tempfile.mkstemp(dir=file.parent, suffix=".part")
        with os.fdopen(handle, "wb") as opened:
            opened.write(content)
        os.replace(part, file)
    return str(file)


def newest_baseline_file(
    store: DiskStore, data: Path, asset: str, wanted: str | None = None
) -> str:
    """The file of the newest version of a machine's baseline; empty before there is one."""
    try:
        newest = newest_baseline(store, asset, wanted)
    except NotFound:
        return ""
    file = _file_of(data, newest.checksum)
    # its content is read once, and not for each window
    if file.exists():
        return str(file)
    return baseline_file(data, store.model_content(newest.model, newest.number))


def _file_of(data: Path, checksum: str) -> Path:
    return (data / "baselines" / f"{checksum[:24]}.zip").resolve()


# Training a machine's baseline from its own windows: the work of a job; nothing is stored here.


_TRAINED_WITHIN = 3600
"""[s] Of processor time, by an FMU."""


def train_baseline(
    progress: Progress,
    diagnoser: str,
    windows: Sequence[RecordParts],
    channels: Mapping[str, str],
    model: ModelText | None,
    settings: Mapping[str, Any],
    present: bytes | None = None,
    fmus: bool = False,
) -> Mapping[str, Any]:
    """Train a diagnoser on windows of a machine and judge these same windows with it.

    `present` is the baseline that is at work: it is asked first whether these windows may be
    learned from. With `fmus` the code of an FMU, which is the model or judges now, runs in a
    process of its own.

    Returns
    -------
    mapping
        `learned` (what training found), `windows`, `alarms` (how many of the windows the new
        baseline would call faulty), `baseline` (its file).

    Raises
    ------
    BadInput
        Windows that the diagnoser cannot learn from.
    """
    progress(0.05, f"training {diagnoser} on {len(windows)} windows")
    work = (diagnoser, windows, channels, model, settings, present)
    if not (_is_fmu(model) or (present is not None and holds_fmu(BytesIO(present)))):
        return _trained(progress, *work)
    with fmus_allowed(fmus):
        check_allowed("the model" if _is_fmu(model) else "the present baseline")
    try:
        return OwnProcess(_TRAINED_WITHIN).call(_trained_apart, *work)
    except ProcessEnded as ended:
        raise BadInput(
            f"the FMU ended the process that trained by it ({ended}); nothing was stored, and"
            " nothing else was harmed"
        ) from None


def _is_fmu(model: ModelText | None) -> bool:
    return model is not None and is_packed(model[1])


def _trained_apart(*work: Any) -> Mapping[str, Any]:
    return _trained(lambda _done, _doing: None, *work)


def _trained(
    progress: Progress,
    diagnoser: str,
    windows: Sequence[RecordParts],
    channels: Mapping[str, str],
    model: ModelText | None,
    settings: Mapping[str, Any],
    present: bytes | None,
) -> Mapping[str, Any]:
    records = [named(Record(*parts), channels) for parts in windows]
    if present is not None:
        progress(0.1, "asking the present baseline whether these windows are healthy")
        diagnoser_of_content(DIAGNOSERS[diagnoser], present).refuse_learning(records)
    trained = _untrained(diagnoser, model, settings).fit(records)
    progress(0.7, "judging the windows of the training")
    verdicts = [trained.score(record).verdict.value for record in records]
    return {
        "diagnoser": diagnoser,
        "windows": len(records),
        "alarms": verdicts.count("faulty"),
        "learned": to_plain(trained.learned()),
        "baseline": content_of(trained),
    }


def _untrained(diagnoser: str, model: ModelText | None, settings: Mapping[str, Any]) -> Diagnoser:
    """The diagnoser with a model and settings; BadInput for one that it has not."""
    # `method` is set on a diagnoser that is there, all others are given when it is made
    deciding = {name: value for name, value in settings.items() if name == "method"}
    own = {name: value for name, value in settings.items() if name != "method"}
    own |= {} if model is None else {"model": _model_to_train(*model)}
    try:
        untrained = DIAGNOSERS[diagnoser](**own)
    except TypeError:
        raise BadInput(f"diagnoser {diagnoser!r}: takes no {', '.join(own)}") from None
    return untrained.with_settings(**deciding)


def _model_to_train(name: str, text: bytes | None) -> PhysicalModel:
    """The model of this text, or the stored FMU, whose library is loaded."""
    if text is None or not is_packed(text):
        return model_of(name, text)
    # loads what compiles, for FMUs alone
    from residuum.identification.physics.fmu.watched_model import (  # noqa: PLC0415
        watched_content,
    )

    return watched_content(text, name)


# Which of a diagnoser's methods decides for a machine: chosen while the service runs, and kept.


def _name(asset: str) -> str:
    return f"{asset}.method"


def deciding_method(
    store: DiskStore, asset: str, diagnoser: str, otherwise: str | None = None
) -> str | None:
    """Which of a diagnoser's methods decides for a machine: the one that somebody chose while the
    service ran, else `otherwise`.

    The store is asked only for a diagnoser that has a choice. NotFound for a diagnoser that there
    is not.
    """
    methods = diagnoser_class(diagnoser).methods
    if len(methods) < 2:
        return otherwise
    chosen = chosen_method(store, asset)
    return chosen if chosen in methods else otherwise


def chosen_method(store: DiskStore, asset: str) -> str | None:
    """`source` or `default` as somebody chose for this machine; None: as its baseline was trained,
    or its settings say.

    For a machine whose name is too long for a document nothing can have been chosen.
    """
    document = kept_document(store, _name(asset))
    return None if document is None or document["method"] is None else str(document["method"])


def choose_method(store: DiskStore, asset: str, method: str | None, by: str) -> None:
    """Let a method decide from the machine's next window on; None takes the choice back.

    Raises
    ------
    NotFound
        No such machine.
    BadInput
        Its diagnoser has no such method, or the machine has no diagnoser yet.
    Conflict
        The machine's name is too long for a document beside it.
    """
    diagnoser = store.asset(asset).diagnoser
    if diagnoser is None:
        raise BadInput(f"asset {asset!r}: has no diagnoser yet, so no method can decide")
    known = diagnoser_class(diagnoser).methods
    if method is not None and method not in known:
        raise BadInput(
            f"diagnoser {diagnoser!r}, method {method!r}: {did_you_mean(method, known)}must be"
            f" {' or '.join(known)}"
        )
    document_name(asset)  # refuses a name that is too long
    store.add_model_version(_name(asset), KIND, orjson.dumps({"method": method}), "method", by)


# The healthy life of a machine, from its stored windows: what a diagnoser may learn its limits
# from.

FEWEST_HEALTHY_WINDOWS = 8
"""Of which at least two are kept to check with."""
# Windows that are looked at, the newest.
_MOST = 120
_CHECKED_SHARE = 0.3


def healthy_windows(store: DiskStore, asset: str) -> list[Record]:
    """The newest windows judged healthy whose signals are kept and alike (channels, units, rate),
    oldest first.

    A window whose fault somebody refuted is one of them where he said so; one that was judged
    healthy, and in which somebody found a fault, is none. Conflict when there are fewer than 8.
    """
    records: list[Record] = []
    findings = store.findings(asset, limit=_MOST, verdict="healthy").items
    answers = store.standing_confirmations(asset=asset)
    faults_found = {
        answer.window
        for answer in answers
        if answer.verdict == Verdict.HEALTHY and answer.outcome != Outcome.CONFIRMED
    }
    judged = {finding.window for finding in findings} - faults_found
    # what somebody said goes first: it is rare, and he looked at the machine
    refuted = sorted((answer.window for answer in answers if answer.healthy), reverse=True)[:_MOST]
    newest = sorted(judged, reverse=True)[: _MOST - len(refuted)]
    for _, record in kept_windows(store, asset, sorted([*newest, *refuted], reverse=True)):
        # alike with the newest: a bus whose description was changed is another machine
        if not records or _alike(records[0], record):
            records.append(record)
    if len(records) < FEWEST_HEALTHY_WINDOWS:
        raise Conflict(
            f"asset {asset!r}: {len(records)} healthy windows with their signals; at least"
            f" {FEWEST_HEALTHY_WINDOWS} are needed"
        )
    return records[::-1]


def parted(windows: Sequence[Record]) -> tuple[list[Record], list[Record]]:
    """Earlier windows to learn from, overlapping ones joined, and the last 30 % to check with, none
    of which was learned from.
    """
    count = len(windows) - max(2, round(_CHECKED_SHARE * len(windows)))
    learned, last = joined(windows[:count]), windows[count - 1]
    # where all of them overlap the last learned one, overlapping ones are better than none
    apart = [record for record in windows[count:] if not _overlap(last, record)]
    return learned, apart or list(windows[count:])


def joined(windows: Sequence[Record]) -> list[Record]:
    """Windows of one recorder that overlap, sample for sample, as the one record they were cut
    from.
    """
    records: list[Record] = []
    for window in windows:
        last = records[-1] if records else None
        shared = 0 if last is None else _overlap(last, window)
        if last is None or not _same(last, window, shared):
            records.append(window)
            continue
        channels = {
            name: np.concatenate([last[name], window[name][shared:]]) for name in last.channels
        }
        records[-1] = replace(last, channels=channels)
    return records


def _overlap(last: Record, window: Record) -> int:
    """Samples at the end of `last` that the next window begins with, by the recorder's clock; 0
    when it does not go on.
    """
    begin = round((window.t0 - last.t0) / last.sample_time)
    # begins inside `last`, and ends behind it
    return last.n - begin if 0 <= begin < last.n < begin + window.n else 0


def _same(last: Record, window: Record, shared: int) -> bool:
    """Whether the shared samples are equal: a clock that began anew could make strangers look like
    neighbours.
    """
    return shared > 0 and all(
        np.array_equal(last[c][-shared:], window[c][:shared], equal_nan=True) for c in last.channels
    )


def _alike(first: Record, second: Record) -> bool:
    return first.units == second.units and abs(first.sample_time / second.sample_time - 1) < 1e-6


# Under which name a machine's baseline is stored, and its newest version.

BASELINE = "baseline"


def baseline_name(store: DiskStore, asset: str, wanted: str | None = None) -> str:
    """The wanted name or the asset's own; with the ending `.baseline` where a model of another kind
    has that one.
    """
    name = wanted or asset
    try:
        return (
            name if store.model_versions(name)[0].kind == BASELINE else f"{asset[:54]}.{BASELINE}"
        )
    except NotFound:
        return name


def newest_baseline(store: DiskStore, asset: str, wanted: str | None = None) -> ModelVersion:
    """The newest version of a machine's baseline; NotFound before there is one."""
    return store.model_versions(baseline_name(store, asset, wanted))[0]


def has_baseline(store: DiskStore, asset: str, wanted: str | None = None) -> bool:
    """Whether a machine has a baseline."""
    try:
        return newest_baseline(store, asset, wanted).kind == BASELINE
    except NotFound:
        return False


# The windows that a machine's baseline is trained from: those recorded before there was one,
# later those judged healthy.

FEWEST_NEW_WINDOWS = 5
"""Below it no threshold is learned; 20 are what the refusal calls good."""
MOST = 60
"""Recorded windows that are learned from at most: the newest."""


def healthy_windows_of(
    store: DiskStore,
    settings: MachineSettings,
    leave_out: Collection[int],
    uploaded: Sequence[int] | None,
    used: Collection[str],
) -> tuple[list[Record], int]:
    """The windows that a machine is trained from, and how many were passed over for a hole: uploaded
    records, else its own, of which some may be left out; BadInput where both are said.
    """
    if uploaded is not None:
        if leave_out:
            raise BadInput(
                "body, leave_out: names windows of the machine, and `records` are taken in their"
                " place; leave one of them out"
            )
        return uploaded_windows(store, uploaded, settings.channels, used)
    judged = has_baseline(store, settings.asset, settings.baseline)
    return training_windows(
        store, settings.asset, leave_out, judged=judged, channels=settings.channels, used=used
    )


def training_windows(
    store: DiskStore,
    asset: str,
    leave_out: Collection[int],
    *,
    judged: bool,
    channels: Mapping[str, str],
    used: Collection[str],
) -> tuple[list[Record], int]:
    """The windows, oldest first, and how many were passed over for a hole; Conflict when there are
    too few.

    Parameters
    ----------
    leave_out : collection of int
        Recorded windows that somebody saw the machine not healthy in.
    judged : bool
        Whether to take windows that the present baseline judged healthy, instead of recorded ones.
    channels : mapping of the model's names to the bus's
    used : collection of str
        Signals that must be complete, by the model's names.
    """
    if judged:
        return healthy_windows(store, asset), 0
    chosen = (window for window in store.recorded_windows(asset, MOST) if window not in leave_out)
    kept = (record for _, record in kept_windows(store, asset, chosen))
    return _enough(kept, channels, used, f"asset {asset!r}: {{}} windows are recorded")


def uploaded_windows(
    store: DiskStore, records: Sequence[int], channels: Mapping[str, str], used: Collection[str]
) -> tuple[list[Record], int]:
    """Uploaded records as a machine's windows, in this order, and how many were passed over for a
    hole; NotFound for one that there is not, Conflict when there are too few.
    """
    uploaded = (store.record_samples(number) for number in records)
    return _enough(uploaded, channels, used, "body, records: {} are given")


def _enough(
    windows: Iterable[Record], channels: Mapping[str, str], used: Collection[str], counted: str
) -> tuple[list[Record], int]:
    """Those without a hole in a signal that is used, and how many have one; `counted` tells how
    many there are where these are too few.
    """
    records, holes = [], 0
    for record in windows:
        if holed(named(record, channels), used):
            holes += 1
        else:
            records.append(record)
    if len(records) < FEWEST_NEW_WINDOWS:
        lacking = f"; {holes} more have holes, {REMEDY}" if holes else ""
        needed = f"at least {FEWEST_NEW_WINDOWS} are needed, 20 are good"
        raise Conflict(f"{counted.format(len(records))}; {needed}{lacking}")
    return records, holes


# A second opinion on a window, beside the finding that decides.


def with_second_opinion(finding: Finding, second: Finding) -> Finding:
    """The first finding with the second as evidence: verdict and alarms are the first one's."""
    opinion = {
        "diagnoser": second.diagnoser,
        "verdict": second.verdict.value,
        "class": second.fault_class,
        "reason": second.reason,
        "indicators": dict(second.indicators),
        "thresholds": dict(second.thresholds),
        "causes": second.evidence.get("causes", []),
        "agrees": second.verdict is finding.verdict,
    }
    return replace(finding, evidence={**finding.evidence, "second_opinion": opinion})


def second_name(store: DiskStore, asset: str, wanted: str | None) -> str:
    """The name under which the baseline of a machine's second opinion is stored."""
    return baseline_name(store, f"{asset}.second", wanted)


class Trained(NamedTuple):
    """What is trained: which diagnoser, stored under which name, with which model."""

    diagnoser: str
    name: str
    model: str | None


def what_is_trained(store: DiskStore, settings: MachineSettings, *, second: bool) -> Trained:
    """The machine's own diagnoser, or its second opinion; BadInput where it has none."""
    if not second:
        return Trained(
            settings.diagnoser,
            baseline_name(store, settings.asset, settings.baseline),
            settings.model,
        )
    if settings.second is None:
        raise BadInput(f"machine {settings.asset!r}: has no second opinion in its settings")
    name = second_name(store, settings.asset, settings.second.baseline)
    return Trained(settings.second.diagnoser, name, settings.second.model)
