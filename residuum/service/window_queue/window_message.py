"""WindowMessage: a window and who is to judge it, as bytes."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

import msgpack
import numpy as np

from residuum.identification.errors import BadInput
from residuum.nearest_names import known_names
from residuum.service.machines.judging.scoring import PlainRecord

_VERSION = 1
_TYPES = ("<f4", "<f8")
MOST_CHANNELS = 256
ASSET_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}")


@dataclass(frozen=True)
class WindowMessage:
    """A window of `asset`, to be judged by `diagnoser` with the stored baseline of the name `baseline`.

    `method` decides, where a diagnoser has two, unless another was chosen where the window is judged.
    """

    asset: str
    diagnoser: str
    baseline: str
    window: PlainRecord
    method: str | None = None

    def pack(self) -> bytes:
        """The message as bytes: MessagePack, samples little endian."""
        window = self.window
        channels = {name: _packed(signal) for name, signal in window.channels.items()}
        names = {"asset": self.asset, "diagnoser": self.diagnoser, "baseline": self.baseline, "source": window.source}
        names |= {} if self.method is None else {"method": self.method}
        times = {"sample_time": window.sample_time, "t0": window.t0}
        packed: bytes = msgpack.packb({"version": _VERSION, **names, **times, "channels": channels, "units": dict(window.units)})
        return packed

    @classmethod
    def unpack(cls, payload: bytes) -> WindowMessage:
        """The message again; BadInput, in one line, when it is none. Nothing larger than the payload is allocated."""
        try:
            plain = msgpack.unpackb(payload)
            if plain["version"] != _VERSION:
                raise BadInput(f"window message: is of version {plain['version']!r}; {_VERSION} is read here")
            if len(plain["channels"]) > MOST_CHANNELS or len(plain["units"]) > MOST_CHANNELS:
                raise BadInput(f"window message: {len(plain['channels'])} channels; at most {MOST_CHANNELS} are read")
            channels = {str(name): _unpacked(str(name), *packed) for name, packed in plain["channels"].items()}
            units = {str(name): str(unit) for name, unit in plain["units"].items()}
            window = PlainRecord(channels, units, float(plain["sample_time"]), float(plain["t0"]), str(plain["source"]))
            message = cls(str(plain["asset"]), str(plain["diagnoser"]), str(plain["baseline"]), window, plain.get("method"))
        except (ValueError, TypeError, KeyError, AttributeError, msgpack.UnpackException) as error:
            raise BadInput(f"window message: cannot be read: {type(error).__name__} {error}") from None
        if not ASSET_NAME.fullmatch(message.asset):
            raise BadInput(f"window message, asset: {message.asset[:40]!r} is no name of a machine")
        return message


def _packed(signal: Any) -> tuple[str, bytes]:
    kind = "<f4" if np.asarray(signal).dtype == np.float32 else "<f8"
    return kind, np.ascontiguousarray(signal, kind).tobytes()


def _unpacked(name: str, kind: str, samples: bytes) -> Any:
    if kind not in _TYPES:
        raise BadInput(f"window message, channel {name[:40]!r}: samples are {kind!r}; {known_names(kind, _TYPES)}")
    return np.frombuffer(samples, kind)
