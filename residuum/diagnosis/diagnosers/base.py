"""What every diagnoser is: trained on records, scores one window, can be stored."""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Self

from residuum.diagnosis.finding import Finding
from residuum.identification.errors import BadInput
from residuum.identification.record import Record
from residuum.nearest_names import did_you_mean


class NotTrained(BadInput):
    """A diagnoser was asked for something that needs a baseline before it was given one."""


@dataclass(frozen=True)
class Channel:
    """One signal a diagnoser reads: its name, unit and meaning; `required` False when it may be
    absent.
    """

    name: str
    unit: str
    meaning: str
    required: bool = True


@dataclass(frozen=True)
class Example:
    """A small, self-made case that the conformance test runs on every diagnoser.

    `training` (with `labels`, one a record, or None when all are healthy) must suffice for `fit`;
    `healthy` and `faulty` are windows with known truth.
    """

    training: Sequence[Record]
    labels: Sequence[str] | None
    healthy: Sequence[Record]
    faulty: Sequence[Record]


class Diagnoser(ABC):
    """A trained judge of windows of one machine family.

    `score` never raises on a window that is merely unusable (too short, gap, flat, clipped, wrong
    rate): that is a `not-assessable` Finding. It raises BadInput only when a required channel is
    absent or in an incompatible unit. A window across a gap is never judged healthy.

    Its settings are the keywords of its `__init__`, which refuses a bad value with BadInput; without
    any it can be trained on its examples. Python takes them at once, as in
    `rs.monitor("robust-residual", order=60)`; commands and HTTP those that are a field of
    `library/questions/score.py` too.
    """

    name: ClassVar[str]
    """Its key in `DIAGNOSERS`, and the kind of its stored file."""
    channels: ClassVar[Sequence[Channel]]
    """What it reads. A channel of unit "" may have any: `fit` keeps that of the records, and
    `Record.in_unit` converts a window's to it.
    """
    classes: ClassVar[Sequence[str]]
    """Every `fault_class` that a finding of it may have; `healthy` may be among them."""
    methods: ClassVar[Sequence[str]] = ("default",)
    views: ClassVar[Sequence[str]] = ()
    """Pictures that not every diagnoser has: of a window (`residual`, `decision-regions`) or of its
    machine (`tracks`).
    """
    quick: ClassVar[bool] = False
    """Whether some thousand samples are judged within milliseconds, whatever they hold."""
    method: str = "default"
    """Which of `methods` decides the verdict; findings of a diagnoser with two hold what both
    say.
    """

    @abstractmethod
    def fit(self, records: Sequence[Record], labels: Sequence[str] | None = None) -> Self:
        """Learn the baseline from records; `labels` is one class name a record (`healthy` or a
        fault class), None where all are healthy.

        BadInput where labels are not one a record, where no record is healthy, or where one cannot
        be used; NotIdentifiable where they are too few.
        """

    @abstractmethod
    def score(self, record: Record) -> Finding:
        """Judge one window: the indicators, each limit under its indicator's name, and a `reason`
        with both numbers and their unit. NotTrained before `fit`, where nothing can be said
        without a baseline.
        """

    # not abstract: most have nothing to refuse
    def refuse_learning(self, healthy: Sequence[Record]) -> None:  # noqa: B027
        """Raise BadInput where something that is not healthy is probable in windows from which
        limits are to be learned anew.
        """

    def relearned(self, healthy: Sequence[Record]) -> Self:
        """A diagnoser of the same settings whose limits come from these healthy records; this one
        stays as it is.

        What tells fault classes apart is kept where the diagnoser has learned it from labelled
        records.
        """
        return copy.copy(self).fit(healthy)

    @abstractmethod
    def save(self, path: str | Path) -> None:
        """Store the trained diagnoser with its settings (JSON and arrays, estimators by skops;
        never pickle): `save_stored` of `diagnosis.learning.stored` writes all of it, `load_stored`
        reads it and refuses another kind.
        """

    @classmethod
    @abstractmethod
    def load(cls, path: str | Path) -> Self:
        """The diagnoser stored by `save`; BadInput when the file is not one of this class."""

    @classmethod
    @abstractmethod
    def examples(cls) -> Sequence[Example]:
        """Cases for the conformance test, made here by formula (this package never imports the
        simulators).
        """

    def with_settings(self, **settings: object) -> Self:
        """The same trained diagnoser with other settings; BadInput for one that it has not. All
        have `method`; one with more that may change after training extends this.
        """
        if unknown := [name for name in settings if name != "method"]:
            raise BadInput(f"diagnoser {self.name!r}: has no setting {unknown[0]!r}; it has method")
        method = settings.get("method", self.method)
        if method not in self.methods:
            asked = did_you_mean(method, self.methods)
            raise BadInput(
                f"diagnoser {self.name!r}, method {str(method)[:40]!r}: {asked}must be"
                f" {' or '.join(self.methods)}"
            )
        if method == self.method:
            return self
        diagnoser = copy.copy(self)
        diagnoser.method = str(method)
        return diagnoser

    def learned(self) -> dict[str, Any]:
        """What training found that its user should know, as JSON; under `says` the same in
        sentences.
        """
        return {}

    def describe(self) -> Mapping[str, object]:
        """What the interface shows of this diagnoser: name, channels with units, classes, methods,
        pictures of its own.
        """
        return {
            "name": self.name,
            "channels": [vars(channel) for channel in self.channels],
            "classes": list(self.classes),
            "methods": list(self.methods),
            "views": list(self.views),
        }
