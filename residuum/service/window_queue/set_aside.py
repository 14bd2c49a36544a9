"""SetAside: windows that the service refused for good, kept in the gateway's folder with the
reason, so that none holds up the rest.
"""

from __future__ import annotations

import re
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path

import orjson
import structlog

from residuum.identification.errors import BadInput
from residuum.nearest_names import known_names
from residuum.service.storage.durable_folder import keep_file, make_folder

log = structlog.get_logger()

FOLDER = "set-aside"
# Windows and bytes that are kept; beyond, the oldest go. What came is counted in any case.
_MOST = 200
_MOST_BYTES = 256 * 2**20
_SAFE = re.compile(r"[^A-Za-z0-9_-]")
_LONGEST_REASON = 500
_ENDING = ".request"


@dataclass(frozen=True)
class Refusal:
    """A window that was set aside: its key and machine, when, why, and how many bytes it has;
    `name` is that of its files.
    """

    key: str
    machine: str
    at: str
    reason: str
    size_bytes: int
    name: str


class SetAside:
    """A folder of windows (`*.request`, as they were sent) with their reasons (`*.json`), newest
    last.

    Parameters
    ----------
    data : Path
        The gateway's data folder.
    """

    def __init__(self, data: Path) -> None:
        self._folder = data / FOLDER

    @property
    def count(self) -> int:
        """How many windows were ever set aside."""
        try:
            return int((self._folder / "count").read_text(encoding="ascii"))
        except (OSError, ValueError):
            return 0

    def put(self, key: str, machine: str, request: bytes, reason: str) -> None:
        """Keep a window and say why; OSError where it cannot be written."""
        make_folder(self._folder)
        now = datetime.now(UTC)
        # by time, so that sorted names are in the order in which they came
        name = f"{now:%Y%m%dT%H%M%S%f}-{_SAFE.sub('_', key)[:64]}"
        refusal = Refusal(
            key, machine, now.isoformat(), reason[:_LONGEST_REASON], len(request), name
        )
        # the window before its description: what is listed is there
        keep_file(self._folder / f"{name}{_ENDING}", request)
        keep_file(self._folder / f"{name}.json", orjson.dumps(asdict(refusal)))
        (self._folder / "count").write_text(str(self.count + 1), encoding="ascii")
        self._let_the_oldest_go()

    def newest(self, limit: int | None = 20) -> list[Refusal]:
        """The windows that were set aside last (None: all), the newest first."""
        requests = sorted(self._folder.glob(f"*{_ENDING}"), reverse=True)[:limit]
        descriptions = (file.with_suffix(".json") for file in requests)
        return [
            Refusal(**orjson.loads(file.read_bytes())) for file in descriptions if file.is_file()
        ]

    def get(self, name: str) -> Refusal:
        """The window of a name; BadInput where none has it."""
        by_name = {refusal.name: refusal for refusal in self.newest(limit=None)}
        if name not in by_name:
            raise BadInput(
                f"window {name[:80]!r}: none of this name is set aside;"
                f" {known_names(name, by_name, 'there are')}"
            )
        return by_name[name]

    def request(self, name: str) -> bytes:
        """A window as it was sent."""
        return (self._folder / f"{self.get(name).name}{_ENDING}").read_bytes()

    def let_go(self, name: str) -> None:
        """Keep a window no more."""
        for ending in (".json", _ENDING):
            (self._folder / f"{name}{ending}").unlink(missing_ok=True)

    def _let_the_oldest_go(self) -> None:
        requests = sorted(self._folder.glob(f"*{_ENDING}"))
        size = sum(file.stat().st_size for file in requests)
        while requests and (len(requests) > _MOST or size > _MOST_BYTES):
            size -= requests[0].stat().st_size
            log.error("the oldest window that was set aside is let go", name=requests[0].stem)
            self.let_go(requests.pop(0).stem)
