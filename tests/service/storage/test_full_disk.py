"""A real disk that is full or read-only: refused with 507 or 503, never a false 201, and taken again when there is room."""

import contextlib
import io

import httpx
import numpy as np
import pytest

SIZE = 6 * 2**20
PATH = "/api/v1/assets/press/windows?diagnoser=bearing&channel=acceleration%20%5Bm%2Fs%C2%B2%5D&sample_time=1e-3"


def body(number, n=20_000):
    file = io.BytesIO()
    np.save(file, np.full(n, float(number)))
    return file.getvalue()


class Plant:
    """Posts windows whose samples are their numbers, and knows which were acknowledged."""

    def __init__(self, client):
        self.client = client
        self.acknowledged = {}
        self.number = 0

    def post(self, n=20_000):
        """The status of the answer to one more window of so many samples."""
        self.number += 1
        headers = {
            "Content-Type": "application/octet-stream",
            "Idempotency-Key": f"key-{self.number}",
        }
        answer = self.client.post(PATH, content=body(self.number, n), headers=headers)
        if answer.status_code == 201:
            self.acknowledged[self.number] = answer.json()["window"]["id"]
        else:
            assert answer.headers["content-type"] == "application/problem+json" and answer.json()[
                "type"
            ].endswith("unavailable")
        return answer.status_code

    def ready(self):
        """The status of /health/ready."""
        return self.client.get("/health/ready").status_code

    def until(self, status, n=20_000):
        """Post until this answer comes; all answers."""
        seen = [self.post(n)]
        while seen[-1] != status:
            assert len(seen) < 5000, seen[-5:]
            seen.append(self.post(n))
        return set(seen)

    def verify(self, store):
        """What was acknowledged is there, whole, and nothing else is."""
        for number, window in self.acknowledged.items():
            assert np.all(store.window_record("press", window)["acceleration"] == number)
        kept = [each.id for each in store.windows("press", limit=10_000).items]
        assert sorted(kept) == sorted(self.acknowledged.values())


@pytest.fixture
def plant_at():
    """Gives the plant of a service's address."""
    with contextlib.ExitStack() as stack:
        yield lambda url: Plant(stack.enter_context(httpx.Client(base_url=url, timeout=120)))


def test_a_full_disk_is_said_and_what_was_acknowledged_is_there(make_disk, run_service, plant_at):
    disk, remount = make_disk(SIZE)
    service = run_service(data=disk)
    plant = plant_at(service.url)
    assert plant.ready() == 200
    assert plant.until(507) == {201, 507}
    assert [plant.post() for _ in range(5)] == 5 * [507]
    plant.until(507, n=50)  # down to the last kilobytes, where the database finds no room any more
    assert plant.ready() == 507
    plant.verify(service.services.store)
    remount(disk, f"size={2 * SIZE}")
    assert plant.post() == 201 and plant.ready() == 200
    plant.verify(service.services.store)
    service.stop()
    service.start()
    assert plant.post() == 201
    plant.verify(service.services.store)


def test_a_full_disk_of_the_database_alone(make_disk, run_service, plant_at):
    disk, remount = make_disk(2**20)
    service = run_service(database=f"sqlite:///{disk / 'residuum.db'}")
    plant = plant_at(service.url)
    assert plant.until(507, n=50) == {201, 507}
    plant.verify(service.services.store)
    remount(disk, f"size={SIZE}")
    assert plant.post() == 201 and plant.ready() == 200
    plant.verify(service.services.store)


def test_a_disk_that_fails_is_read_only_and_all_is_there_when_it_is_back(
    make_failing_disk, run_service, plant_at
):
    disk, fail, repair = make_failing_disk()
    service = run_service(data=disk)
    plant = plant_at(service.url)
    assert [plant.post(n=50) for _ in range(5)] == 5 * [201] and plant.ready() == 200
    fail()
    assert [plant.post(n=50) for _ in range(3)] == 3 * [503] and plant.ready() == 503
    assert plant.client.get("/api/v1/assets").status_code in (200, 503)
    service.stop()
    repair()
    service.start()
    assert plant.post(n=50) == 201
    plant.verify(service.services.store)


def test_blocks_that_cannot_be_written_are_said(make_disk, run_service, plant_at, tmp_path):
    disk, remount = make_disk(SIZE)
    service = run_service(data=disk, database=f"sqlite:///{tmp_path / 'residuum.db'}")
    plant = plant_at(service.url)
    assert plant.post() == 201 and plant.ready() == 200
    remount(disk, "ro")
    assert [plant.post() for _ in range(3)] == 3 * [503] and plant.ready() == 503
    plant.verify(service.services.store)
    remount(disk, "rw")
    assert plant.post() == 201 and plant.ready() == 200
    plant.verify(service.services.store)
