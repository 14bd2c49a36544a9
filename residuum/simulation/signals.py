"""Signals: what a virtual machine gives, arrays with units on one even clock."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.floating]


@dataclass(frozen=True, eq=False)
class Signals:
    """Channels of one recorder: sample k was taken at `t0 + k * sample_time` on that recorder's own
    clock.

    Parameters
    ----------
    sample_time : float
        Seconds between samples.
    channels : mapping of name to array, shape (n,)
    units : mapping of name to unit
    t0 : float
        Clock reading of the first sample [s].
    notes : tuple of str
        Lines to keep with the data; they never reveal a hidden effect or a fault.
    """

    sample_time: float
    channels: Mapping[str, Array]
    units: Mapping[str, str]
    t0: float = 0.0
    notes: tuple[str, ...] = ()

    @property
    def n(self) -> int:
        """Number of samples."""
        return len(next(iter(self.channels.values())))

    @property
    def time(self) -> Array:
        """Sample instants [s] on the recorder's clock, shape (n,)."""
        return self.t0 + self.sample_time * np.arange(self.n, dtype=np.float64)

    def __getitem__(self, name: str) -> Array:
        """The channel `name`, shape (n,)."""
        return self.channels[name]
