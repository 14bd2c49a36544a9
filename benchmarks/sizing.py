"""The sizing rule of docs/explanation/operations.md beside what windows of several sizes really cost.

    python -m benchmarks.sizing

Windows are posted over HTTP to a service in a process of its own, with a diagnoser that costs nothing; its processor time, the
bytes of signals and of rows on disk, and the bytes received are held against the rule. The rule's coefficients were fitted to
the first and the last size; the sizes between are its test. Processor time is stretched by neighbours, too: on a quiet machine
the rule asks for more cores than are needed.
"""

from __future__ import annotations

import io
import os
import tempfile
from dataclasses import dataclass
from http.client import HTTPConnection
from pathlib import Path

import numpy as np

from benchmarks.http import processor_seconds, serve, service

SIZES = ((1, 1000), (1, 16_384), (4, 16_384), (2, 131_072), (8, 131_072))
"""Channels and samples of a window."""
WINDOWS = 150
CPU_PER_WINDOW, CPU_PER_BYTE = 10.4e-3, 7.4e-9
"""Seconds a window, and a byte of its signals (8 bytes a sample)."""
ROW_BYTES = 4500
BLOCK_BYTES = 400


@dataclass(frozen=True)
class Cost:
    """What one window costs."""

    cpu: float
    signals: float
    network: float


def rule(channels: int, samples: int) -> Cost:
    """What docs/explanation/operations.md says."""
    b = channels * samples * 8
    return Cost(CPU_PER_WINDOW + CPU_PER_BYTE * b, b + BLOCK_BYTES, b)


def measured(channels: int, samples: int) -> tuple[Cost, float]:
    """What it is, and the bytes of database a window."""
    file = io.BytesIO()
    np.save(file, np.random.default_rng(0).normal(size=(channels, samples)))
    body = file.getvalue()
    query = "&".join(["diagnoser=free", "sample_time=0.0001", "channel=acceleration%20%5Bg%5D"])
    query += "".join(f"&channel=y{number}%20%5BV%5D" for number in range(1, channels))
    with tempfile.TemporaryDirectory() as data:
        port, process = serve(service, data)
        connection = HTTPConnection("127.0.0.1", port)

        def post(count: int) -> None:
            for _ in range(count):
                connection.request(
                    "POST",
                    f"/api/v1/assets/press/windows?{query}",
                    body,
                    {"Content-Type": "application/octet-stream"},
                )
                answer = connection.getresponse()
                content = answer.read()
                if answer.status != 201:
                    raise RuntimeError(content.decode())

        post(20)
        before, rows_before = processor_seconds(process), _database(data)
        blocks_before = _bytes(data, "*.block")
        post(WINDOWS)
        cpu = (processor_seconds(process) - before) / WINDOWS
        signals = (_bytes(data, "*.block") - blocks_before) / WINDOWS
        rows = (_database(data) - rows_before) / WINDOWS
        connection.close()
        os.kill(process, 9)
    return Cost(cpu, signals, len(body)), rows


def _bytes(folder: str, pattern: str) -> int:
    return sum(file.stat().st_size for file in Path(folder).rglob(pattern))


def _database(folder: str) -> int:
    return _bytes(folder, "residuum.db")


def main() -> None:
    """Print the table."""
    print(
        "| channels × samples | CPU [ms], rule | measured | signals [kB], rule | measured | sent [kB] | database [kB] |"
    )
    print("|---|---|---|---|---|---|---|")
    for channels, samples in SIZES:
        said, (found, rows) = rule(channels, samples), measured(channels, samples)
        print(
            f"| {channels} × {samples} | {1e3 * said.cpu:.1f} | {1e3 * found.cpu:.1f} | {said.signals / 1e3:.1f} "
            f"| {found.signals / 1e3:.1f} | {found.network / 1e3:.1f} | {rows / 1e3:.1f} |"
        )


if __name__ == "__main__":
    main()
