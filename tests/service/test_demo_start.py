"""The demo's start: its machines are read once they are on their buses."""

import time


def test_no_start_of_the_demo_counts_a_device_that_is_not_there_yet(run_service):
    service = run_service(demo=True)
    end = time.monotonic() + 300
    while True:
        sources = service.services.pipeline.status()["sources"]
        if all(source["quality"] == "good" for source in sources.values()) or time.monotonic() > end:
            break
        time.sleep(0.2)
    assert {name: source["quality"] for name, source in sources.items()} == dict.fromkeys(sources, "good")
    assert len(sources) == 4
    for source in sources.values():
        assert source["counters"]["bus_errors"] == 0, source
