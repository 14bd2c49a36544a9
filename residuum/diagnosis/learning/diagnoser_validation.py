"""How well a kind of diagnoser does on objects not trained on: object-wise cross-validation and the .632+ bootstrap."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from residuum.diagnosis.diagnosers.base import Diagnoser
from residuum.diagnosis.learning.object_wise_validation import Labels, Validation
from residuum.identification.errors import BadInput
from residuum.identification.linear_models.validation.bootstrap import weighed
from residuum.identification.record import Record

Fit = Callable[[Sequence[int]], Diagnoser]
"""Trains a fresh diagnoser on the records of these numbers."""


def validate_object_wise(fit: Fit, records: Sequence[Record], labels: Sequence[str], objects: Sequence[str]) -> Validation:
    """Object-wise cross-validation (A.7) of any diagnoser: each object's records are judged by one trained on all others.

    Raises BadInput with fewer than two objects, and what training raises.
    """
    names = np.asarray(objects)
    if len(np.unique(names)) < 2:
        raise BadInput("validation: all records come from one object; at least two are needed")
    predicted = np.empty(len(records), dtype=object)
    for name in np.unique(names):
        judge = fit([int(k) for k in np.flatnonzero(names != name)])
        for k in map(int, np.flatnonzero(names == name)):
            predicted[k] = said(judge, records[k])
    return Validation(np.asarray(labels), predicted.astype(str), names)


@dataclass(frozen=True)
class Bootstrap:
    """The .632+ estimate of the error on new objects, and what it is made of; all are shares of records.

    Attributes
    ----------
    error : float
        (1 − w) apparent + w out_of_bag, w = .632/(1 − .368 R).
    apparent, out_of_bag : float
        Error on the records trained on, and on objects that a bootstrap sample lacks.
    no_information : float
        γ, the error if records and labels had nothing to do with each other.
    overfitting : float
        R = (out_of_bag − apparent)/(γ − apparent), between 0 and 1.
    samples : int
        Bootstrap samples that could be trained on.
    """

    error: float
    apparent: float
    out_of_bag: float
    no_information: float
    overfitting: float
    samples: int


def bootstrap_632_plus(
    fit: Fit, records: Sequence[Record], labels: Sequence[str], objects: Sequence[str], repeats: int = 25, seed: int = 0
) -> Bootstrap:
    """Efron and Tibshirani, J. Amer. Stat. Assoc. 92 (1997) 548–560, whole objects drawn instead of records; A.2 of the source.

    A sample that lacks what training needs (a class, enough records) is left out.

    Raises BadInput with fewer than two objects, or where no sample can be trained on.
    """
    truth, names = np.asarray(labels), np.asarray(objects)
    if len(np.unique(names)) < 2:
        raise BadInput("bootstrap: all records come from one object; at least two are needed")
    judge = fit(range(len(records)))
    own = np.array([said(judge, record) for record in records])
    wrong: list[list[bool]] = [[] for _ in records]
    trained = 0
    rng = np.random.default_rng(seed)
    for _ in range(repeats):
        drawn = rng.choice(np.unique(names), len(np.unique(names)))
        left = np.flatnonzero(~np.isin(names, drawn))
        if not len(left):
            continue
        try:
            judge = fit([int(k) for name in drawn for k in np.flatnonzero(names == name)])
        except BadInput:
            continue
        trained += 1
        for k in map(int, left):
            wrong[k].append(said(judge, records[k]) != truth[k])
    counted = [float(np.mean(each)) for each in wrong if each]
    if not counted:
        raise BadInput("bootstrap: no sample of objects could be trained on; more objects of every class are needed")
    return _combined(truth, own, float(np.mean(counted)), trained)


def said(judge: Diagnoser, record: Record) -> str:
    """The class that a diagnoser gives a record: `healthy`, the fault's, or the verdict where there is no class."""
    finding = judge.score(record)
    return finding.fault_class or str(finding.verdict.value)


def _combined(truth: Labels, own: npt.NDArray[np.str_], out_of_bag: float, trained: int) -> Bootstrap:
    apparent = float(np.mean(own != truth))
    classes = np.unique(np.concatenate([truth, own]))
    shares = [(float(np.mean(truth == name)), float(np.mean(own == name))) for name in classes]
    no_information = sum(p * (1.0 - q) for p, q in shares)
    error, overfitting = weighed(apparent, out_of_bag, no_information)
    return Bootstrap(error, apparent, out_of_bag, no_information, overfitting, trained)
