"""A fleet's records through the executor: killed workers, the same results to the byte, and what a second worker brings.

    python -m benchmarks.fleet --jobs 10000 --kills 20 --samples 4096

The files are judged serially in this process, then by worker processes of which one is killed now and then. The speed-up is of
processes that have begun already (a start costs some seconds, once), each of one thread, and means little on a busy machine.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import random
import signal
import sys
import tempfile
import threading
import time
from multiprocessing.synchronize import Barrier
from pathlib import Path
from typing import Any

import numpy as np
import orjson

from residuum.identification.record import Record
from residuum.identification.record_formats import write_record
from residuum.service.fleet.fleet import Rescore, run_fleet
from residuum.service.work.worker_pool import WorkerPool

WORK = Rescore("bearing", None)
RATE = 12_800.0


def write_fleet(folder: Path, jobs: int, samples: int, seed: int = 0) -> list[str]:
    """Records of noise, some with periodic shocks, one in five hundred damaged."""
    rng = np.random.default_rng(seed)
    files = []
    for number in range(jobs):
        y = rng.normal(size=samples)
        y[:: rng.integers(50, 400)] += rng.choice((0.0, 8.0))
        file = folder / f"machine-{number:06d}.npz"
        write_record(
            Record(
                {"acceleration": y, "speed": np.full(samples, 1500.0)},
                {"acceleration": "m/s²", "speed": "rpm"},
                1 / RATE,
            ),
            file,
        )
        if number % 500 == 3:
            file.write_bytes(file.read_bytes()[:-40])
        files.append(str(file))
    return files


def serial(files: list[str]) -> bytes:
    """What the results file must hold."""
    return b"".join(orjson.dumps({"file": file, **WORK(file)}) + b"\n" for file in files)


class Killer(threading.Thread):
    """Kills a random worker of a pool each time that so many more files are done."""

    def __init__(self, pool: WorkerPool, kills: int, jobs: int, seed: int) -> None:
        super().__init__(daemon=True)
        self.killed = 0
        self._pool, self._rng, self._moments = (
            pool,
            random.Random(seed),
            [jobs * (k + 1) / (kills + 2) for k in range(kills)],
        )
        self._moved = threading.Condition()
        self._done = 0

    def tell(self, done: int, _jobs: int) -> None:
        """Progress of the fleet."""
        with self._moved:
            self._done = done
            self._moved.notify()

    def run(self) -> None:
        for moment in self._moments:
            with self._moved:
                self._moved.wait_for(lambda moment=moment: self._done >= moment)
            while not (workers := list((self._pool._pool._processes or {}).values())):
                time.sleep(0.01)
            os.kill(self._rng.choice(workers).pid, signal.SIGKILL)
            self.killed += 1


def campaign(jobs: int, kills: int, samples: int, workers: int, seed: int = 0) -> dict[str, Any]:
    """Serial, then in parallel with kills; whether the results are the same to the byte."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        files = write_fleet(folder, jobs, samples, seed)
        begun = time.perf_counter()
        expected = serial(files)
        alone = time.perf_counter() - begun
        pool = WorkerPool(workers)
        killer = Killer(pool, kills, jobs, seed)
        killer.start()
        begun = time.perf_counter()
        results = folder / "results.jsonl"
        run_fleet(files, WORK, pool, results, workers=workers, tell=killer.tell)
        took = time.perf_counter() - begun
        killer.join()  # its last kill may come after the last file
        pool.terminate()
        return {
            "jobs": jobs,
            "workers killed": killer.killed,
            "refused (damaged files)": expected.count(b'"refused"'),
            "equal to serial, to the byte": results.read_bytes() == expected,
            "serial [s]": round(alone, 1),
            "with kills [s]": round(took, 1),
        }


def speed_up(jobs: int, samples: int) -> dict[str, Any]:
    """Files a second with one and with two workers that have begun already, and the processor time of a file in each part.

    What the cores allow when nothing else runs: two workers do files at twice the rate of one, each as long as its processor time
    with two, unless this process, which hands over and writes down, is busy for longer than half of that.
    """
    rates, in_workers, here = {}, {}, {}
    with tempfile.TemporaryDirectory() as name:
        files = write_fleet(Path(name), jobs, samples)
        for workers in (1, 2):
            pool = WorkerPool(workers)
            run_fleet(
                files[: 40 * workers],
                WORK,
                pool,
                Path(name) / f"warm-{workers}",
                workers=workers,
                tell=lambda *_: None,
            )
            begun, cpu, cpu_here = time.perf_counter(), _processor_time(pool), time.process_time()
            run_fleet(
                files,
                WORK,
                pool,
                Path(name) / f"results-{workers}",
                workers=workers,
                tell=lambda *_: None,
            )
            rates[workers] = jobs / (time.perf_counter() - begun)
            in_workers[workers], here[workers] = (
                _processor_time(pool) - cpu,
                time.process_time() - cpu_here,
            )
            pool.terminate()
        plain = plain_speed_up(files)
    pool = WorkerPool(1)
    pool.submit(time.process_time).result()  # the server has begun
    pool.terminate()
    pool = WorkerPool(1)
    start = pool.submit(time.process_time).result()
    pool.terminate()
    return {
        "CPU ms to begin a worker": round(1e3 * start, 1),
        "CPU ms a file, one worker": round(1e3 * in_workers[1] / jobs, 2),
        "CPU ms a file, two workers": round(1e3 * in_workers[2] / jobs, 2),
        "CPU ms a file, handing over": round(1e3 * here[2] / jobs, 3),
        "speed-up that CPU times allow": round(
            in_workers[1] / max(in_workers[2] / 2, here[2], (in_workers[2] + here[2]) / 2), 2
        ),
        "files/s, one worker": round(rates[1], 1),
        "files/s, two workers": round(rates[2], 1),
        "speed-up": round(rates[2] / rates[1], 2),
        "speed-up of plain processes": round(plain, 2),
        "load of the machine before": os.getloadavg()[0],
    }


def plain_speed_up(files: list[str]) -> float:
    """What two processes that know nothing of each other reach over one: no executor, nobody who hands over or writes down.

    It is what this computer has to give (two cores that share caches, memory or a hyper-thread give less than 2), so it is the
    figure beside which the speed-up of the fleet stands.
    """
    context = multiprocessing.get_context("forkserver")
    rates = {}
    for processes in (1, 2):
        begin = context.Barrier(processes + 1)
        workers = [
            context.Process(target=_work_alone, args=(files[k::processes], begin))
            for k in range(processes)
        ]
        for worker in workers:
            worker.start()
        begin.wait()
        begun = time.perf_counter()
        for worker in workers:
            worker.join()
        rates[processes] = len(files) / (time.perf_counter() - begun)
    return rates[2] / rates[1]


def _work_alone(files: list[str], begin: Barrier) -> None:
    """Some files first, as the fleet's workers have had them, then all when the others are ready, too."""
    for file in files[:20]:
        WORK(file)
    begin.wait()
    for file in files:
        orjson.dumps({"file": file, **WORK(file)})


def _processor_time(pool: WorkerPool) -> float:
    """Processor seconds of the pool's workers so far."""
    seconds = 0.0
    for process in pool._pool._processes:
        fields = Path(f"/proc/{process}/stat").read_text().rsplit(")", 1)[1].split()
        seconds += (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
    return seconds


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--jobs", type=int, default=10_000)
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--samples", type=int, default=4096)
    parser.add_argument("--workers", type=int, default=2)
    given = parser.parse_args()
    found = campaign(given.jobs, given.kills, given.samples, given.workers)
    for what, figure in (found | speed_up(max(100, given.jobs // 10), 16 * given.samples)).items():
        print(f"{what:<32}{figure}")
    if not found["equal to serial, to the byte"]:
        sys.exit(1)


if __name__ == "__main__":
    main()
