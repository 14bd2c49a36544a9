"""The .632+ bootstrap: the error on new data from data that were all trained on; A.2 of the source.

    error = (1 − w) apparent + w out of bag,   w = .632/(1 − .368 R),   R = (out of bag − apparent)/(γ − apparent)

The apparent error is too small, the error on what a bootstrap sample lacks too large (a sample holds .632 of the data); R weighs
them by how far the method overfits, 0 to 1, γ being the error if input and output had nothing to do with each other. Efron,
Tibshirani, J. Amer. Stat. Assoc. 92 (1997) 548–560.

Of signals, blocks of time are drawn instead of samples: neighbours share their noise. Fails, and tells too small an error, where
the noise remembers longer than a block lasts, and where all blocks lie in one operating point and the new data do not. Tells too
large a one where the past that a prediction needs is a good part of a block, for every block lacks it at its beginning.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from residuum.array_types import FloatArray
from residuum.identification.errors import BadInput, NotIdentifiable
from residuum.identification.linear_models.identified_model import IdentifiedModel
from residuum.identification.linear_models.validation.residual_check import prediction_errors
from residuum.identification.record import Record

Fit = Callable[[Sequence[Record]], IdentifiedModel]
_REACH = 0.632
"""1 − 1/e: the share of the data that a bootstrap sample holds."""
_BLOCKS, _FEWEST_BLOCKS = 20, 6
_PASTS_A_BLOCK = 3


def weighed(apparent: float, out_of_bag: float, no_information: float) -> tuple[float, float]:
    """(error, R) of the three errors.

    >>> [round(value, 3) for value in weighed(0.0, 0.2, 0.5)]
    [0.148, 0.4]
    """
    worst = min(out_of_bag, no_information)
    room = no_information - apparent
    overfitting = (worst - apparent) / room if room > 0 and worst > apparent else 0.0
    weight = _REACH / (1.0 - (1.0 - _REACH) * overfitting)
    return (1.0 - weight) * apparent + weight * worst, overfitting


@dataclass(frozen=True)
class BlockBootstrap:
    """Mean squares of prediction errors [output unit²] about each block's level, and what they are made of.

    Attributes
    ----------
    error, apparent, out_of_bag, no_information, overfitting
        As in the equation above.
    samples, blocks : int
        Bootstrap samples that a model could be identified from, and blocks that they were drawn from.
    """

    error: float
    apparent: float
    out_of_bag: float
    no_information: float
    overfitting: float
    samples: int
    blocks: int


def block_bootstrap(
    fit: Fit, model: IdentifiedModel, records: Sequence[Record], *, repeats: int = 25, seed: int = 0
) -> BlockBootstrap:
    """The .632+ estimate of a model's prediction error on new data.

    Parameters
    ----------
    fit : callable
        Identifies a model as `model` was, from a sequence of records.
    model : IdentifiedModel
        Of all `records`.
    records : sequence of Record
        Cut into blocks, some twenty in all, of at least three times the past that a prediction needs.

    Raises
    ------
    NotIdentifiable
        Fewer than six blocks, or no sample that a model could be identified from.
    """
    blocks = cut_into_blocks(model, records)
    apparent, outputs = _errors(model, blocks)
    energy = [float(np.nanmean(y**2)) for y in outputs]  # about each block's level
    predicted = [float(np.nanmean((y - e) ** 2)) for y, e in zip(outputs, apparent, strict=True)]
    left: list[list[float]] = [[] for _ in blocks]
    rng, trained = np.random.default_rng(seed), 0
    for _ in range(repeats):
        drawn = rng.integers(0, len(blocks), len(blocks))
        out = np.setdiff1d(np.arange(len(blocks)), drawn)
        if not len(out):
            continue
        try:
            found = fit([blocks[k] for k in drawn])
            errors, _ = _errors(found, [blocks[k] for k in out])
        except BadInput:
            continue
        trained += 1
        for k, e in zip(out, errors, strict=True):
            left[k].append(float(np.nanmean(e**2)))
    counted = [float(np.mean(each)) for each in left if each]
    if not counted:
        raise NotIdentifiable(
            "bootstrap: no sample of blocks has enough data for the model; record longer, or take a smaller order"
        )
    own = float(np.mean([np.nanmean(e**2) for e in apparent]))
    out_of_bag, no_information = float(np.mean(counted)), float(np.mean(energy) + np.mean(predicted))
    error, overfitting = weighed(own, out_of_bag, no_information)
    return BlockBootstrap(error, own, out_of_bag, no_information, overfitting, trained, len(blocks))


def cut_into_blocks(model: IdentifiedModel, records: Sequence[Record]) -> list[Record]:
    """Contiguous blocks of equal length, as far as the records' ends allow."""
    n = sum(record.n for record in records)
    past = model.delay + model.order
    length = max(_PASTS_A_BLOCK * past, n // _BLOCKS)
    blocks = []
    for record in records:
        count = record.n // length
        edges = [k * record.n // count for k in range(count + 1)] if count else []
        blocks += [record.window(first, last) for first, last in pairwise(edges)]
    if len(blocks) < _FEWEST_BLOCKS:
        raise NotIdentifiable(
            f"bootstrap: {n} samples make {len(blocks)} blocks of {length}, three times the past that a prediction needs; at "
            f"least {_FEWEST_BLOCKS} are needed: record longer, or take a smaller order"
        )
    return blocks


def _errors(model: IdentifiedModel, blocks: Sequence[Record]) -> tuple[list[FloatArray], list[FloatArray]]:
    """Prediction errors and outputs of each block about their levels; NaN where the past is not whole."""
    errors, outputs = [], []
    for block in blocks:
        e = prediction_errors(model, block)
        y = np.where(np.isnan(e), np.nan, np.asarray(block[model.output_name], dtype=float))
        if not np.isfinite(e).any():
            raise NotIdentifiable("bootstrap: a block has no sample whose past is whole")
        errors.append(e - np.nanmean(e))
        outputs.append(y - np.nanmean(y))
    return errors, outputs
