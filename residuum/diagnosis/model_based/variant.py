"""One way to begin with a hypothesis: a model, what is done to its inputs and readings, and which
numbers are its sizes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from residuum.array_types import FloatArray
from residuum.identification.physics import PhysicalModel

Edit = Callable[[FloatArray, FloatArray], FloatArray]
"""Signals (n, channels) and sizes → signals."""


@dataclass(frozen=True, eq=False)
class Variant:
    """A model and its sizes.

    Attributes
    ----------
    model : PhysicalModel
    own : tuple of str
        Parameters of the model that are sizes.
    sizes : tuple of float
        First values of what is done to inputs and readings, which is affine in the signals.
    lower : tuple of float
        Their lower bounds.
    inputs, reading : edit or None
    noise_gain : function or None
        By how much the sizes multiply the noise of each output, shape (outputs,).
    onset : int
        Sample from which on it acts.
    """

    model: PhysicalModel
    own: tuple[str, ...] = ()
    sizes: tuple[float, ...] = ()
    lower: tuple[float, ...] = ()
    inputs: Edit | None = None
    reading: Edit | None = None
    noise_gain: Callable[[FloatArray], FloatArray] | None = None
    onset: int = 0


def edited(column: int, how: Edit, first: int = 0) -> Edit:
    """The signals with one column changed from a sample on."""

    def edit(values: FloatArray, sizes: FloatArray) -> FloatArray:
        out = values.copy()
        out[first:, column] = how(values[first:, column], sizes)
        return out

    return edit


def amplified(y: FloatArray, sizes: FloatArray) -> FloatArray:
    """The signal times one and a share: (1 + s) y."""
    return np.asarray(y * (1.0 + sizes[0]))


def shifted(y: FloatArray, sizes: FloatArray) -> FloatArray:
    """The signal and an offset: y + s."""
    return np.asarray(y + sizes[0])


def held(y: FloatArray, sizes: FloatArray) -> FloatArray:
    """One value in place of the signal: s."""
    return np.full_like(y, sizes[0])


def delayed(y: FloatArray, sizes: FloatArray) -> FloatArray:
    """The signal late by s samples, linear between samples."""
    # before the window nothing is known: its first value stands for what came then
    at = np.clip(np.arange(len(y)) - sizes[0], 0, len(y) - 1)
    low = np.minimum(at.astype(np.int64), len(y) - 2)
    part = (at - low).reshape((-1,) + (1,) * (y.ndim - 1))
    return np.asarray(y[low] * (1.0 - part) + y[low + 1] * part)
