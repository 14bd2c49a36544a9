"""A campaign against the Sparkplug source: messages lost, repeated and put out of order, births lost, deaths late, clocks set.

PYTHONPATH=. python -m benchmarks.sparkplug --broker mqtt://127.0.0.1:1883 [--messages N] [--seed S]

A node of our own sends a message a sample over a real broker. Sample i has u = i and y = 2·i + 1, and every birth gives the two
other aliases, so that a value in a wrong place or read by an old name is seen. Exit status 1 when one is, when a gap was not
noticed, or when a repetition or disorder cost a sample.
"""

import argparse
import random
import sys
import threading
import time

import numpy as np
import paho.mqtt.client as mqtt
from paho.mqtt.enums import CallbackAPIVersion

from benchmarks.opcua import Judge
from residuum.service.broker import broker_address
from residuum.service.fieldbus.sparkplug.metric_map import MetricMap
from residuum.service.fieldbus.sparkplug.sparkplug_payload import (
    BOOLEAN,
    DOUBLE,
    INT64,
    Metric,
    Payload,
    pack,
    unpack,
)
from residuum.service.fieldbus.sparkplug.sparkplug_source import REBIRTH, SparkplugSource

STEP = 0.02
HARMLESS = ("repeat", "old repeat", "disorder", "late death", "rebirth")
KINDS = (
    "lose",
    "lose",
    "lose",
    "lose many",
    "lose 256",
    "lose birth",
    "break",
    "set clock",
    *HARMLESS,
)


class Node:
    """The edge node, and what its messages suffer on their way."""

    def __init__(self, address, rng):
        self.rng, self.sent, self.seq, self.number, self.shift = rng, 0, 0, 0, 0
        self.lose, self.lose_births, self.delayed, self.history = 0, 0, [], []
        self.aliases, self.asked = {"u": 1, "y": 2}, threading.Event()
        self.address, self.last = address, int(time.time() / STEP)
        self.connect()

    def connect(self):
        self.client = mqtt.Client(CallbackAPIVersion.VERSION2)
        self.client.will_set("spBv1.0/G/NDEATH/N", self.death())
        up = threading.Event()
        self.client.on_subscribe = lambda *_: up.set()
        self.client.on_message = lambda _client, _data, m: (
            self.asked.set() if _asks(m.payload) else None
        )
        self.client.connect(self.address.host, self.address.port)
        self.client.loop_start()
        self.client.subscribe("spBv1.0/G/NCMD/N", 1)
        assert up.wait(10)
        self.be_born()

    def death(self):
        return pack(Payload([Metric("bdSeq", self.number, INT64)], self.now()))

    def now(self):
        return int((time.time() + self.shift) * 1e3)

    def be_born(self):
        self.asked.clear()
        self.seq = 0
        self.aliases = dict(zip(("u", "y"), self.rng.sample(range(1, 4), 2), strict=True))
        self.send(
            "NBIRTH", "", [Metric("bdSeq", self.number, INT64), Metric(REBIRTH, False, BOOLEAN)]
        )
        self.send(
            "DBIRTH",
            "/D",
            [Metric(name, 0.5, DOUBLE, alias) for name, alias in self.aliases.items()],
        )

    def send(self, kind, device, metrics):
        content = pack(Payload(metrics, self.now(), self.seq))
        self.seq = (self.seq + 1) % 256
        self.sent += 1
        topic = f"spBv1.0/G/{kind}/N{device}"
        if kind.endswith("BIRTH") and self.lose_births:
            self.lose_births -= 1
        elif kind == "DDATA" and self.lose:
            self.lose -= 1
        else:
            self.deliver(topic, content)

    def deliver(self, topic, content):
        self.client.publish(topic, content)
        self.history = [*self.history[-300:], (topic, content)]
        self.delayed = [(left - 1, *rest) for left, *rest in self.delayed]
        for _, late, what in [each for each in self.delayed if each[0] <= 0]:
            self.client.publish(late, what)
        self.delayed = [each for each in self.delayed if each[0] > 0]

    def tick(self):
        """Send the samples that are due, and the births that were asked for."""
        if self.asked.is_set():
            self.be_born()
        now = int(time.time() / STEP)
        for i in range(self.last + 1, now + 1):
            at = round((i * STEP + self.shift) * 1e3)
            values = {"u": float(i), "y": 2.0 * i + 1}
            self.send(
                "DDATA",
                "/D",
                [Metric("", value, 0, self.aliases[name], at) for name, value in values.items()],
            )
        self.last = now
        time.sleep(STEP / 4)

    def run(self, seconds):
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.tick()


def _asks(content):
    return any(metric.name == REBIRTH and metric.value for metric in unpack(content).metrics)


def provoke(kind, node):
    """One fault; the node goes on by itself. Gives the number of data messages that were lost."""
    rng, lost = node.rng, 0
    if kind.startswith("lose") and kind != "lose birth":
        lost = node.lose = (
            256
            if kind == "lose 256"
            else rng.randint(100, 300)
            if kind == "lose many"
            else rng.randint(1, 40)
        )
        while node.lose:
            node.tick()
    elif kind == "lose birth":
        node.lose_births = rng.randint(1, 4)
        node.be_born()
        lost = 1
    elif kind == "break":
        node.client.loop_stop()
        node.client._sock_close()  # as a cable that is pulled: the broker tells the death
        node.number = (node.number + 1) % 256
        time.sleep(rng.uniform(0.0, 1.0))
        node.connect()
    elif kind == "set clock":
        node.shift += rng.choice((-3600.0, -20.0, -1.0, 5.0, 3600.0))
    elif kind == "repeat":
        node.delayed += [
            (rng.randint(0, 9), *rng.choice(node.history[-5:])) for _ in range(rng.randint(1, 5))
        ]
    elif kind == "old repeat":
        node.delayed += [
            (rng.randint(0, 9), *rng.choice(node.history)) for _ in range(rng.randint(1, 5))
        ]
    elif kind == "disorder":
        straight = node.deliver
        node.deliver = lambda topic, content: node.delayed.append(
            (rng.randint(1, 6), topic, content)
        )
        node.run(rng.choice((0.5, 1.5)) * STEP)
        node.deliver = straight
    elif kind == "late death":
        content = pack(Payload([Metric("bdSeq", (node.number - 1) % 256, INT64)], node.now()))
        node.client.publish("spBv1.0/G/NDEATH/N", content)
    else:
        node.be_born()
    return lost


def counters(source):
    return {name: n for name, n in source.health.snapshot()["counters"].items() if n}


def wait_for_good(node, judge, since, seconds=30.0):
    while judge.last_good <= since and time.monotonic() < since + seconds:
        node.tick()
    return judge.last_good - since if judge.last_good > since else float("inf")


def campaign(broker, messages, seed):
    """What was found, by name."""
    rng, judge = random.Random(seed), Judge()
    node = Node(broker_address(broker), rng)
    stream = {
        "device": "D",
        "sample_time": STEP,
        "channels": {name: {"metric": name} for name in ("u", "y")},
    }
    source = SparkplugSource(
        broker_address(broker),
        MetricMap.model_validate({"node": "G/N", "streams": {"s": stream}}),
        judge.take,
    )
    source.start()
    returns, kinds, unnoticed, harmed = [], dict.fromkeys(KINDS, 0), [], []
    try:
        returns.append(wait_for_good(node, judge, time.monotonic()))
        while node.sent < messages:
            kind = rng.choice(KINDS)
            kinds[kind] += 1
            node.run(rng.uniform(0.1, 1.0))
            before = source.health["sequence_gaps"], source.health["lost"]
            lost = provoke(kind, node)
            node.run(1.5)  # longer than a message waits for those before it
            returns.append(wait_for_good(node, judge, time.monotonic()))
            gaps, missing = (
                source.health["sequence_gaps"] - before[0],
                source.health["lost"] - before[1],
            )
            if lost and not gaps and missing < lost:
                unnoticed.append((kind, lost))
            if kind in HARMLESS and missing:
                harmed.append((kind, missing))
    finally:
        source.stop()
        source.join()
        node.client.disconnect()
        node.client.loop_stop()
    return {
        "messages": node.sent,
        "of each kind": kinds,
        "good samples": judge.good,
        "wrong samples": judge.wrong,
        "twice": judge.twice(),
        "gaps not noticed": unnoticed,
        "harmless ones that cost samples": harmed,
        "missing inside segments": judge.uncounted(),
        "counted lost": source.health["lost"],
        "good again after, median and longest [s]": (float(np.median(returns)), max(returns)),
        "counters": counters(source),
    }


def failed(found):
    wrong = (
        found["wrong samples"]
        or found["twice"]
        or found["gaps not noticed"]
        or found["harmless ones that cost samples"]
    )
    return bool(wrong) or found["counted lost"] < found["missing inside segments"]


def main():
    options = argparse.ArgumentParser()
    options.add_argument("--broker", default="mqtt://127.0.0.1:1883")
    options.add_argument("--messages", type=int, default=10_000)
    options.add_argument("--seed", type=int, default=1)
    given = options.parse_args()
    found = campaign(given.broker, given.messages, given.seed)
    for name, value in found.items():
        print(f"{name}: {value}")
    return int(failed(found))


if __name__ == "__main__":
    sys.exit(main())
