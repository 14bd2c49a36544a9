"""SetAside: messages of the broker that cannot be stored, kept beside the others with the reason,
so that none holds up the rest.

A message that ends the scorer would come again after its start, and end it again. So a scorer notes
on disk which message it has begun; one that it has begun several times and never finished is set
aside before it is read.
"""

from __future__ import annotations

import queue
import re
import secrets
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import orjson

from residuum.identification.errors import BadInput
from residuum.nearest_names import known_names
from residuum.service.broker import BrokerAddress
from residuum.service.storage.durable_folder import make_folder
from residuum.service.window_queue.window_message import Listener, broker_client, receipt_topic

FOLDER = "set-aside"
ATTEMPTS = 5
"""Times that a message is begun; then it is set aside."""
_MOST = 200
# Messages and bytes that are kept; beyond, the oldest go. What came is counted in any case.
_MOST_BYTES = 256 * 2**20
_SAFE = re.compile(r"[^A-Za-z0-9_-]")
_LONGEST_REASON = 500


@dataclass(frozen=True)
class Poisoned:
    """A message that was set aside: what it was sent under, from where, when, why, and how many
    bytes it has.

    `name` is that of its files, `topic` where it came; empty for one that an older version set
    aside.
    """

    key: str
    gateway: str
    at: str
    reason: str
    size_bytes: int
    topic: str = ""
    name: str = ""


class SetAside:
    """A folder of messages (`*.message`) with their reasons (`*.json`), newest last; the service
    reads what scorers write.

    Parameters
    ----------
    data : Path
        The data folder, which scorers and service share.
    """

    def __init__(self, data: Path) -> None:
        self._folder = data / FOLDER

    @property
    def count(self) -> int:
        """How many messages were ever set aside."""
        try:
            return int((self._folder / "count").read_text(encoding="ascii"))
        except (OSError, ValueError):
            return 0

    def put(self, key: str, gateway: str, payload: bytes, reason: str, topic: str = "") -> None:
        """Keep a message and say why; OSError where it cannot be written."""
        make_folder(self._folder)
        # by time, so that sorted names are in the order in which they came; the key is a stranger's
        name = f"{datetime.now(UTC):%Y%m%dT%H%M%S%f}-{_SAFE.sub('_', key)[:64]}"
        now, why = datetime.now(UTC).isoformat(), reason[:_LONGEST_REASON]
        poisoned = Poisoned(key[:200], gateway[:200], now, why, len(payload), topic, name)
        # the message before its description: what is listed is there
        (self._folder / f"{name}.message").write_bytes(payload)
        (self._folder / f"{name}.json").write_bytes(orjson.dumps(asdict(poisoned)))
        (self._folder / "count").write_text(str(self.count + 1), encoding="ascii")
        self._let_the_oldest_go()

    def newest(self, limit: int | None = 20) -> list[Poisoned]:
        """The messages that were set aside last (None: all), the newest first."""
        descriptions = sorted(self._folder.glob("*.json"), reverse=True)[:limit]
        return [
            Poisoned(**{"name": file.stem, **orjson.loads(file.read_bytes())})
            for file in descriptions
            if file.is_file()
        ]

    def get(self, name: str) -> Poisoned:
        """The message of a name; BadInput where none has it."""
        by_name = {message.name: message for message in self.newest(limit=None)}
        if name not in by_name:
            raise BadInput(
                f"message {name[:80]!r}: none of this name is set aside;"
                f" {known_names(name, by_name, 'there are')}"
            )
        return by_name[name]

    def payload(self, name: str) -> bytes:
        """A message as it came."""
        return (self._folder / f"{self.get(name).name}.message").read_bytes()

    def let_go(self, name: str) -> None:
        """Keep a message no more."""
        for ending in ("json", "message"):
            (self._folder / f"{name}.{ending}").unlink(missing_ok=True)

    def to_json(self) -> dict[str, Any]:
        """How many there were, and the newest."""
        return {"count": self.count, "newest": [asdict(message) for message in self.newest()]}

    def _let_the_oldest_go(self) -> None:
        messages = sorted(self._folder.glob("*.message"))
        size = sum(file.stat().st_size for file in messages)
        while messages and (len(messages) > _MOST or size > _MOST_BYTES):
            size -= messages[0].stat().st_size
            messages[0].with_suffix(".json").unlink(missing_ok=True)
            messages.pop(0).unlink(missing_ok=True)


class Attempts:
    """Which messages one scorer has begun and not finished, in a file that outlives it.

    The file is not synced: it guards against a process that ends, not against a power cut, and is
    written for every window.

    Parameters
    ----------
    data : Path
    scorer : str
        Name of the scorer among those of the data folder.
    """

    def __init__(self, data: Path, scorer: str) -> None:
        self._file = data / FOLDER / f"begun-{_SAFE.sub('_', scorer)}"
        make_folder(self._file.parent)
        try:
            attempts = orjson.loads(self._file.read_bytes())
            self._begun = {str(key): int(times) for key, times in attempts.items()}
        except (OSError, ValueError, AttributeError, TypeError):
            self._begun = {}

    def begin(self, key: str) -> int:
        """Note that a message is begun; returns how many times it was begun without being finished,
        this one included.
        """
        self._begun[key] = self._begun.get(key, 0) + 1
        self._write()
        return self._begun[key]

    def finish(self, key: str) -> None:
        """Note that it is done, or that it was given back in good order."""
        del self._begun[key]
        self._write()

    def _write(self) -> None:
        self._file.write_bytes(orjson.dumps(self._begun))


# Messages that were set aside, sent to the scorers once more: each stays in the folder until a
# scorer says what became of it.

# Seconds for which the broker's, and each scorer's, answer is waited for.
_PATIENCE = 60.0


def send_again(
    address: BrokerAddress,
    aside: SetAside,
    messages: Sequence[Poisoned],
    patience: float = _PATIENCE,
) -> Iterator[tuple[Poisoned, str | None]]:
    """Send them, the oldest first, under their own keys: what is stored already is stored no second
    time.

    Gives each with why it was refused anew (and set aside anew), None where it is stored now; it
    has left the folder then. Raises BadInput where the broker or the message's scorer does not
    answer, or for one of which no topic was noted.
    """
    for message in messages:
        if not message.topic:
            raise BadInput(
                f"{message.name}: was set aside by an older version, which did not note for whom;"
                " take it out by --to"
            )
    gateway, ready, receipts = (
        f"again-{secrets.token_hex(8)}",
        queue.Queue[None](),
        queue.Queue[Any](),
    )

    def take(client: Any, message: Any) -> None:
        receipts.put(orjson.loads(message.payload))
        client.ack(message.mid, message.qos)

    topics = [receipt_topic(address.prefix, gateway)]
    client = broker_client(
        address,
        gateway,
        topics,
        Listener(take, subscribed=lambda: ready.put(None)),
        persistent=False,
    )
    try:
        _waited(
            ready,
            patience,
            f"broker {address.host}:{address.port}: does not let us in; nothing was sent",
        )
        for message in sorted(messages, key=lambda poisoned: poisoned.name):
            beginning, _, key = message.topic.rsplit("/", 2)
            client.publish(f"{beginning}/{gateway}/{key}", aside.payload(message.name), qos=1)
            receipt = _waited(
                receipts,
                patience,
                f"{message.name}: no scorer says that it has it, so it stays; is one running?",
            )
            aside.let_go(message.name)
            yield message, receipt["refused"]
    finally:
        client.disconnect()
        client.loop_stop()


def _waited(answers: queue.Queue[Any], patience: float, otherwise: str) -> Any:
    try:
        return answers.get(timeout=patience)
    except queue.Empty:
        raise BadInput(otherwise) from None
