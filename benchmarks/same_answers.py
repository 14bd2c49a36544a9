"""Does an answer depend on anything but the data? `explain` and `improve` with code compiled and not, one thread and two, idle
and beside load.

`python -m benchmarks same_answers`: ten records of simulated machines; each command runs as a process of its own, first with an
empty cache of compiled equations, then with the cache that left behind and one thread of linear algebra, then with two, then with
three busy processes beside it. The four JSON answers have to be equal but for `seconds` and `model_file`. $SAME_ANSWERS_OF
(default all) chooses records by number, with commas.
"""

import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import orjson

RECORDS = (
    (
        "explain",
        "gate-drive",
        ("--effect", "coulomb-friction:medium", "--duration", "30", "--set", "profile=rich"),
    ),
    (
        "explain",
        "gate-drive",
        ("--effect", "backlash:medium", "--duration", "30", "--set", "profile=rich"),
    ),
    (
        "explain",
        "gate-drive",
        ("--effect", "tooth-ripple:medium", "--duration", "30", "--set", "profile=duty-cycle"),
    ),
    (
        "explain",
        "gate-drive",
        ("--effect", "resistance-heating:medium", "--duration", "30", "--set", "profile=rich"),
    ),
    (
        "explain",
        "gate-drive",
        ("--effect", "x-random-walk-load:medium", "--duration", "30", "--set", "profile=rich"),
    ),
    (
        "explain",
        "gate-drive",
        ("--duration", "30", "--noise-color", "0.9", "--set", "profile=rich"),
    ),
    ("explain", "oven", ("--effect", "second-heat-store:medium", "--set", "configuration=lumped")),
    ("explain", "two-tanks", ("--effect", "leak:medium")),
    (
        "improve",
        "gate-drive",
        (
            "--effect",
            "coulomb-friction:medium",
            "--effect",
            "inductance:medium",
            "--duration",
            "20",
        ),
    ),
    ("improve", "oven", ("--effect", "radiation:medium", "--set", "configuration=lumped")),
)
BESIDE = 3
"""Busy processes."""
THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "NUMBA_NUM_THREADS")


@contextmanager
def busy(processes: int) -> Iterator[None]:
    """So many processes that compute without end run beside what is inside."""
    running = [
        subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(processes)
    ]
    try:
        yield
    finally:
        for one in running:
            one.kill()
            one.wait()


def answers(command: Sequence[str], cache: Path) -> dict[str, dict[str, Any]]:
    """What one command of `residuum` answers: with `cache` not yet there, with it filled, with two threads, and beside load."""

    def answer(threads: int) -> dict[str, Any]:
        environment = (
            os.environ | {"RESIDUUM_CACHE": str(cache)} | dict.fromkeys(THREADS, str(threads))
        )
        done = subprocess.run(
            [*command, "--json"], env=environment, capture_output=True, check=True
        )
        return {
            k: v for k, v in orjson.loads(done.stdout).items() if k not in {"seconds", "model_file"}
        }

    found = {"empty cache": answer(1), "filled": answer(1), "two threads": answer(2)}
    with busy(BESIDE):
        return found | {"beside load": answer(1)}


def main() -> None:
    print(
        "| command | machine | answer | samples | fits | not tried | differ |\n|---|---|---|---|---|---|---|"
    )
    chosen = {int(k) for k in os.environ.get("SAME_ANSWERS_OF", "").split(",") if k}
    for number, (name, machine, options) in enumerate(RECORDS):
        if chosen and number not in chosen:
            continue
        with tempfile.TemporaryDirectory() as folder:
            record = str(Path(folder) / "record.csv")
            command = [sys.executable, "-m", "residuum"]
            simulate = [
                *command,
                "simulate",
                machine,
                "--out",
                record,
                "--seed",
                str(700 + number),
                *options,
            ]
            subprocess.run(simulate, check=True, capture_output=True)
            written = (
                ["--auto", "--out", str(Path(folder) / "model.yaml")] if name == "improve" else []
            )
            found = answers([*command, name, machine, record, *written], Path(folder) / "cache")
        first = found["filled"]
        work, same = (
            first["work"],
            ", ".join(how for how, one in found.items() if one != first) or "none",
        )
        counted = f"{work['samples']} | {work['fits']} | {', '.join(work['not_tried'])}"
        print(
            f"| {name} | {machine} {options[1]} | {first['verdict']} | {counted} | {same} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
