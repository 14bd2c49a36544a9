"""StoredNews: which window has been stored, as bytes. It names what to read from the store and says nothing of what is in it."""

from __future__ import annotations

from dataclasses import dataclass

import orjson

from residuum.identification.errors import BadInput
from residuum.service.window_queue.window_message import ASSET_NAME

_LONGEST = 500
_LARGEST = 2**63


@dataclass(frozen=True)
class StoredNews:
    """Window `window` of `asset` is on disk.

    >>> StoredNews.unpack(StoredNews("press-1", 7).pack())
    StoredNews(asset='press-1', window=7)
    """

    asset: str
    window: int

    def pack(self) -> bytes:
        """The news as bytes: JSON."""
        return orjson.dumps({"asset": self.asset, "window": self.window})

    @classmethod
    def unpack(cls, payload: bytes) -> StoredNews:
        """The news again; BadInput, in one line, when it is none."""
        if len(payload) > _LONGEST:
            raise BadInput(f"stored news: {len(payload)} bytes; at most {_LONGEST} are read")
        try:
            plain = orjson.loads(payload)
        except orjson.JSONDecodeError as error:
            raise BadInput(f"stored news: cannot be read: {error}") from None
        asset, window = (plain.get("asset"), plain.get("window")) if isinstance(plain, dict) else (None, None)
        if not isinstance(asset, str) or not ASSET_NAME.fullmatch(asset):
            raise BadInput("stored news, asset: is no name of a machine")
        if type(window) is not int or not 0 < window < _LARGEST:
            raise BadInput("stored news, window: is no number of a window")
        return cls(asset, window)
