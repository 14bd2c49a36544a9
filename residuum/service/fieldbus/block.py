"""Block: samples of one stream, as they left the bus, each with its place on the stream's own clock."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Samples = npt.NDArray[np.float64]
Numbers = npt.NDArray[np.int64]


@dataclass(frozen=True)
class StreamFormat:
    """What a stream carries: evenly sampled channels with units on one clock.

    Parameters
    ----------
    name : str
        Name within its machine.
    sample_time : float
        Seconds between samples.
    units : mapping of channel to unit
    """

    name: str
    sample_time: float
    units: Mapping[str, str]


@dataclass(frozen=True, eq=False)
class Block:
    """Samples of one stream.

    `number[k]` is the place of sample k on the stream's clock (sample time × number = seconds). Numbers are unique over
    the life of a source and mostly rise; a hole is a loss, and a late sample fills its hole.

    Parameters
    ----------
    stream : str
    number : int64 array, shape (n,)
    channels : mapping of name to float array, shape (n,)
    """

    stream: str
    number: Numbers
    channels: Mapping[str, Samples]

    @property
    def n(self) -> int:
        """Number of samples."""
        return len(self.number)
