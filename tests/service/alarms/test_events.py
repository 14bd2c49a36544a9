"""Listeners get every event in order, resume after a break, and are told when they missed some."""

import asyncio
import threading

import orjson

from residuum.service.alarms.events import Events
from residuum.service.api.events import event_stream


def collect(events, count, last_seen=None, after_start=lambda: None):
    async def listen():
        found = []
        stream = events.listen(last_seen, heartbeat=5.0)
        starting = asyncio.ensure_future(anext(stream))
        await asyncio.sleep(0.02)
        after_start()
        found.append(await starting)
        while len(found) < count:
            found.append(await anext(stream))
        await stream.aclose()
        return found

    return asyncio.run(listen())


def test_many_threads_publish_and_nothing_is_lost_or_reordered():
    events = Events()

    def publish_from_threads():
        def publish(name):
            for number in range(200):
                events.publish("finding", {"from": name, "number": number})

        threads = [threading.Thread(target=publish, args=(name,)) for name in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()

    found = collect(events, 800, after_start=publish_from_threads)
    assert [event.id for event in found] == list(range(1, 801))
    for name in range(4):
        numbers = [
            data["number"]
            for data in (orjson.loads(event.data) for event in found)
            if data["from"] == name
        ]
        assert numbers == list(range(200))


def test_a_listener_that_was_away_gets_what_it_missed():
    events = Events()
    for number in range(5):
        events.publish("alarm", {"number": number})
    assert [event.id for event in collect(events, 3, f"{events.run}-2")] == [3, 4, 5]


def test_a_listener_is_told_when_it_missed_more_than_is_kept_or_the_service_restarted():
    events = Events(most_kept=4)
    for number in range(10):
        events.publish("alarm", {"number": number})
    for last_seen in (f"{events.run}-2", "other-3", "nonsense", f"{events.run}-99"):
        (first,) = collect(events, 1, last_seen)
        assert first.kind == "reset", last_seen
        assert events.token(first) == f"{events.run}-10"


def test_a_stream_begins_when_it_is_asked_for_not_when_it_is_first_read():
    events = Events()
    answer = event_stream(events, None, lambda event: True, ends=lambda event: True)
    events.publish("alarm", {"number": 7})

    async def read():
        return [line async for line in answer.body_iterator]

    assert b'{"number":7}' in b"".join(asyncio.run(read()))


def test_a_quiet_time_gives_a_heartbeat_and_closing_ends_the_stream():
    events = Events()

    async def listen():
        stream = events.listen(None, heartbeat=0.01)
        assert await anext(stream) is None
        events.close()
        return [event async for event in stream]

    assert asyncio.run(listen()) in ([], [None])
