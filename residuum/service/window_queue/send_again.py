"""Messages that were set aside, sent to the scorers once more: each stays in the folder until a scorer says what became of it."""

from __future__ import annotations

import queue
import secrets
from collections.abc import Iterator, Sequence
from typing import Any

import orjson

from residuum.identification.errors import BadInput
from residuum.service.broker_address import BrokerAddress
from residuum.service.window_queue.broker_client import broker_client
from residuum.service.window_queue.set_aside import Poisoned, SetAside
from residuum.service.window_queue.topics import receipt_topic

_PATIENCE = 60.0
"""Seconds for which the broker's, and each scorer's, answer is waited for."""


def send_again(
    address: BrokerAddress, aside: SetAside, messages: Sequence[Poisoned], patience: float = _PATIENCE
) -> Iterator[tuple[Poisoned, str | None]]:
    """Send them, the oldest first, under their own keys: what is stored already is stored no second time.

    Gives each with why it was refused anew (and set aside anew), None where it is stored now; it has left the folder then.
    Raises BadInput where the broker or the message's scorer does not answer, or for one of which no topic was noted.
    """
    for message in messages:
        if not message.topic:
            raise BadInput(f"{message.name}: was set aside by an older version, which did not note for whom; take it out by --to")
    gateway, ready, receipts = f"again-{secrets.token_hex(8)}", queue.Queue[None](), queue.Queue[Any]()

    def take(client: Any, message: Any) -> None:
        receipts.put(orjson.loads(message.payload))
        client.ack(message.mid, message.qos)

    topics = [receipt_topic(address.prefix, gateway)]
    client = broker_client(address, gateway, topics, take, lambda: None, kept=False, subscribed=lambda: ready.put(None))
    try:
        _waited(ready, patience, f"broker {address.host}:{address.port}: does not let us in; nothing was sent")
        for message in sorted(messages, key=lambda each: each.name):
            beginning, _, key = message.topic.rsplit("/", 2)
            client.publish(f"{beginning}/{gateway}/{key}", aside.payload(message.name), qos=1)
            receipt = _waited(receipts, patience, f"{message.name}: no scorer says that it has it, so it stays; is one running?")
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
