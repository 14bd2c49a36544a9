"""How large a database grows: windows with findings like the demo's, and the rule that keeps so many rows.

python -m benchmarks.rows --windows 8000 --keep 2000
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np

from residuum.diagnosis.finding import Finding
from residuum.identification.record import Record
from residuum.service.storage import DiskStore
from residuum.service.storage.retention import Retention

EVIDENCE = 200
"""Numbers of evidence a finding: rows and finding then take 4.5 kB a window, as those of the demo do."""


def grow(windows: int, keep: int, looks: int = 8) -> list[tuple[int, float, float, int]]:
    """(windows stored, database [MB], seconds of the last retention, hours kept) at `looks` moments."""
    rng = np.random.default_rng(0)
    grown = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        store = DiskStore(folder, f"sqlite:///{folder / 'residuum.db'}")
        record = Record({"y": np.zeros(16)}, {"y": "V"}, 1.0)
        for number in range(1, windows + 1):
            indicators = {
                f"indicator {k}": float(value) for k, value in enumerate(rng.normal(size=12))
            }
            evidence = {"spectrum": rng.normal(size=EVIDENCE).tolist()}
            thresholds = dict.fromkeys(indicators, 9.0)
            store.add_window(
                "press",
                record,
                Finding("bearing", "healthy", None, indicators, thresholds, {}, evidence, "-"),
            )
            if number % (windows // looks) == 0:
                begun = time.perf_counter()
                store.retain(Retention(np.inf, 2**40, np.inf, keep))
                took = time.perf_counter() - begun
                size = sum(file.stat().st_size for file in folder.glob("residuum.db*")) / 1e6
                grown.append((number, size, took, len(store.finding_hours("press"))))
        store.close()
    return grown


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--windows", type=int, default=8000)
    parser.add_argument("--keep", type=int, default=2000)
    given = parser.parse_args()
    print("| windows stored | database with its journal [MB] | retention took [s] | hours |")
    print("|---|---|---|---|")
    for number, size, took, hours in grow(given.windows, given.keep):
        print(f"| {number} | {size:.1f} | {took:.2f} | {hours} |")


if __name__ == "__main__":
    main()
