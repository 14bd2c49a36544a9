"""Lists are paged by bytes, too, and large answers share a budget: none takes the memory of the service.

What each question adds to it is measured by `python -m benchmarks.memory_by_question`.
"""

import asyncio
import time

import httpx
import numpy as np
import pytest

from residuum.diagnosis.finding import Finding
from residuum.identification.record import Record
from residuum.identification.record_formats import read_record
from residuum.service.machines.adding import bus_description
from residuum.service.memory_budget import MemoryBudget, TooBusy
from residuum.service.storage import DiskStore
from residuum.service.storage.rows.paging import PAGE_BYTES

MANY, LARGE = 12, 300_000


@pytest.fixture(scope="module")
def service(run_service):
    service = run_service()
    record = Record({"y": [0.0, 1.0]}, {"y": "V"}, 1.0)
    for number in range(MANY):
        finding = Finding("bearing", "faulty", evidence={"long": "x" * LARGE}, reason=str(number))
        service.services.store.add_window("press", record, finding)
        service.services.store.add_window(f"asset-{number:02}", record, finding)
    return service


@pytest.mark.parametrize("path", ["assets/press/findings", "assets"])
def test_a_list_of_large_rows_comes_in_small_pages_and_whole(service, path):
    items, cursor, pages = [], "", 0
    while cursor is not None:
        page = httpx.get(f"{service.url}/api/v1/{path}?limit=500{cursor}", timeout=60)
        assert len(page.content) < PAGE_BYTES + LARGE + 100_000
        items += [each["id"] for each in page.json()["items"]]
        cursor, pages = page.json()["next_cursor"], pages + 1
        cursor = cursor and f"&cursor={cursor}"
    assert (
        len(items) == len(set(items)) == (MANY if "findings" in path else MANY + 1)
        and pages >= MANY * LARGE // PAGE_BYTES
    )


def test_a_row_that_is_larger_than_a_page_is_a_page(run_service):
    service = run_service()
    finding = Finding("bearing", "healthy", evidence={"long": "x" * (2 * PAGE_BYTES)})
    for _ in range(2):
        service.services.store.add_window("press", Record({"y": [0.0]}, {"y": "V"}, 1.0), finding)
    page = httpx.get(f"{service.url}/api/v1/assets/press/findings", timeout=60).json()
    assert len(page["items"]) == 1 and page["next_cursor"]


def test_a_long_signal_is_read_in_pieces_and_what_takes_many_times_its_size_is_refused_with_the_way_on(
    service, monkeypatch, tmp_path
):
    y = np.random.default_rng(0).normal(size=1_700_001).astype(np.float64)
    y[5] = np.nan
    window = service.services.store.add_window(
        "long", Record({"y": y}, {"y": "V"}, 1e-4), Finding("bearing", "healthy")
    )
    path = f"{service.url}/api/v1/assets/long/windows/{window}"
    whole = DiskStore.window_record
    monkeypatch.setattr(DiskStore, "window_record", None)  # nobody asks for the whole
    seen = httpx.get(f"{path}/signal?points=1000&from=0.1&to=160", timeout=60).json()
    shown = y[1000:1_600_001]
    interval = round(seen["interval"] / 1e-4)
    starts = np.arange(0, len(shown), interval)
    for end, reduce in (("minimum", np.fmin), ("maximum", np.fmax)):
        np.testing.assert_array_equal(seen["channels"]["y"][end], reduce.reduceat(shown, starts))
    few = httpx.get(f"{path}/signal?from=0&to=0.0010", timeout=60).json()["channels"]["y"]["values"]
    assert few == [None if np.isnan(v) else v for v in y[:11]]
    (tmp_path / "record.npz").write_bytes(httpx.get(f"{path}/record", timeout=60).content)
    np.testing.assert_array_equal(read_record(tmp_path / "record.npz")["y"], y)
    monkeypatch.setattr(DiskStore, "window_record", whole)
    for view in ("spectrum", "kurtogram", "envelope"):
        answer = httpx.get(f"{path}/{view}", timeout=60)
        assert answer.status_code == 422 and "GET …/record" in answer.json()["detail"]


def test_who_finds_no_room_is_told_the_way_on(service, monkeypatch):
    full = MemoryBudget(1, most_waiting=0)
    full._free = 0
    monkeypatch.setitem(service.services.__dict__, "_memory", full)
    answer = httpx.get(f"{service.url}/api/v1/assets", timeout=60)
    assert (
        answer.status_code == 503
        and answer.headers["Retry-After"]
        and "smaller `limit`" in answer.json()["detail"]
    )


def test_a_budget_is_shared_in_turn_and_given_back():
    async def run():
        budget, order = MemoryBudget(10, most_waiting=3, patience=60.0), []

        async def hold(name, size):
            async with budget.hold(size):
                order.append(name)
                await asyncio.sleep(0)

        async with budget.hold(8):
            waiting = [
                asyncio.create_task(hold(name, size))
                for name, size in (("large", 50), ("small", 1), ("gone", 1))
            ]
            await asyncio.sleep(0)
            with pytest.raises(TooBusy):
                await budget._take(1)
            waiting[2].cancel()
            await asyncio.sleep(0)
            assert order == []
        await asyncio.gather(*waiting, return_exceptions=True)
        assert order == ["large", "small"] and budget._free == 10
        budget._patience = 0.0
        async with budget.hold(10):
            with pytest.raises(TooBusy):
                await budget._take(1)
        assert budget._free == 10 and not budget._waiting

    asyncio.run(run())


def test_a_long_register_map_is_read_by_the_fast_parser():
    """One of 1 MB took 31 s. Processor time, against that of a short map: linear, whatever else the machine does."""

    def seconds(channels):
        lines = "".join(
            f"      c{k}: {{register: {k}, type: uint16, unit: V}}\n" for k in range(channels)
        )
        text = f"streams:\n  s:\n    sample_time: 0.1\n    poll: {{address: 0}}\n    channels:\n{lines}"
        begun = time.thread_time()
        assert len(bus_description("registers", "x", text).streams) == 1
        return time.thread_time() - begun

    seconds(10)
    # .2 s; the parser in Python takes 1.3 s idle, and this is the processor's time
    assert seconds(2000) < 2.0
