"""Each machine of a service's database judged by its own diagnoser, in workers that read what they
need from that database.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from residuum.diagnosis.diagnosers import DIAGNOSERS
from residuum.diagnosis.diagnosers.base import Diagnoser
from residuum.identification.errors import BadInput
from residuum.library.answers.plain import to_plain
from residuum.service.fleet.fleet import StoredWindows, stored_in
from residuum.service.machines.baselines import BASELINE, deciding_method, newest_baseline
from residuum.service.machines.scoring import IN_THIS_PROCESS, diagnoser_of_content
from residuum.service.storage import DiskStore
from residuum.service.storage.rows import models
from residuum.service.store import ModelVersion, NotFound

OWN = "own"
"""What is said instead of a diagnoser's name."""


@dataclass(frozen=True)
class OwnJudge:
    """What judges a machine: diagnoser, its newest baseline (name, version, checksum) or none, and
    the method that decides.
    """

    asset: str
    diagnoser: str | None
    baseline: tuple[str, int, str] | None
    method: str | None


@dataclass(frozen=True)
class RescoreOwn:
    """Judge a window as the service judges its machine now."""

    source: StoredWindows
    judges: tuple[OwnJudge, ...]
    fmus: bool = False

    def mark(self, window: str) -> str:
        """What the results are made by: every machine's diagnoser, baseline and method."""
        # Without it a run that is resumed after a baseline was accepted would mix findings of both.
        return hashlib.sha256(f"rescore {OWN} {self.judges!r}".encode()).hexdigest()[:16]

    def __call__(self, window: str) -> dict[str, Any]:
        """`{"by": …, "finding": …}` or `{"by": …, "refused": …}`."""
        asset = window.rpartition("/")[0]
        try:
            own = next((judge for judge in self.judges if judge.asset == asset), None)
            if own is None or own.diagnoser is None:
                raise BadInput(f"asset {asset!r}: has no diagnoser")
            # Loaded once a process and judge: windows of many machines come to a worker in turn.
            finding = IN_THIS_PROCESS.get(
                (self.source, own), lambda: _judge(self.source, own, self.fmus)
            ).score(self.source.read(window))
        except BadInput as error:
            return {"by": self.mark(window), "refused": str(error)}
        return {"by": self.mark(window), "finding": to_plain(finding.to_json())}


def rescore_own(source: StoredWindows, *, fmus: bool = False) -> RescoreOwn:
    """The work for a database whose schema is the newest; what judges each machine is settled now,
    for all workers. With `fmus` those that hold one judge in processes of their own, else their
    machines' windows are refused.
    """
    store = DiskStore(Path(source.data), source.url)
    try:
        return RescoreOwn(source, tuple(_own(store)), fmus)
    finally:
        store.close()


def _own(store: DiskStore) -> Sequence[OwnJudge]:
    judges: list[OwnJudge] = []
    cursor: str | None = None
    while True:
        page = store.assets(cursor)
        for asset in page.items:
            baseline = _baseline(store, asset.id)
            key = None if baseline is None else (baseline.model, baseline.number, baseline.checksum)
            method = (
                None
                if asset.diagnoser is None or asset.diagnoser not in DIAGNOSERS
                else deciding_method(store, asset.id, asset.diagnoser)
            )
            judges.append(OwnJudge(asset.id, asset.diagnoser, key, method))
        cursor = page.next_cursor
        if cursor is None:
            return judges


def _baseline(store: DiskStore, asset: str) -> ModelVersion | None:
    try:
        newest = newest_baseline(store, asset)
    except NotFound:
        return None
    return newest if newest.kind == BASELINE else None


def _judge(source: StoredWindows, own: OwnJudge, fmus: bool) -> Diagnoser:
    kind = DIAGNOSERS[own.diagnoser or ""]
    judge = kind()
    if own.baseline is not None:
        name, number, _ = own.baseline
        database, _ = stored_in(source.url, source.data)
        with database.read() as connection:
            content = models.content(connection, name, number)
        judge = diagnoser_of_content(kind, content, fmus=fmus)
    return judge if own.method is None else judge.with_settings(method=own.method)
