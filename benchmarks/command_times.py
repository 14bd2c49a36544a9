"""Processor time of the quick commands, warm, in one or several checkouts turn about: `python -m benchmarks.command_times TREE…`.

Each TREE is the root of a checkout; the first is the one that the others are held against. The record is made by the first.
"""

import os
import resource
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

TURNS = 7
RECORD = "drive.csv"
MADE = [
    "simulate",
    "gate-drive",
    "--profile",
    "rich",
    "--effect",
    "coulomb-friction",
    "--duration",
    "30",
    "--seed",
    "4",
]
JOBS = {
    "import residuum": ["-c", "import residuum"],
    "residuum effects": ["-m", "residuum", "effects"],
    "residuum effects gate-drive": ["-m", "residuum", "effects", "gate-drive"],
    "residuum compare gate-drive drive.csv": ["-m", "residuum", "compare", "gate-drive", RECORD],
}


def seconds(tree: Path, arguments: list[str], folder: str) -> float:
    """Processor time of one run, its threads included."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    environment = {**os.environ, "PYTHONPATH": str(tree)}
    subprocess.run(
        [sys.executable, *arguments],
        cwd=folder,
        env=environment,
        stdout=subprocess.DEVNULL,
        check=True,
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def main() -> None:
    """Print a row a job, a column a tree."""
    trees = [Path(tree).resolve() for tree in sys.argv[1:]] or [Path.cwd()]
    print("| CPU s, median of", TURNS, "|", " | ".join(tree.name for tree in trees), "| ratio |")
    print("|---|" + "---|" * (len(trees) + 1))
    with tempfile.TemporaryDirectory() as folder:
        seconds(trees[0], ["-m", "residuum", *MADE, "--out", RECORD], folder)
        for job, arguments in JOBS.items():
            runs = [[seconds(tree, arguments, folder) for tree in trees] for _ in range(TURNS + 1)][
                1:
            ]
            medians = [statistics.median(column) for column in zip(*runs, strict=True)]
            print(
                f"| `{job}` |",
                " | ".join(f"{m:.2f}" for m in medians),
                f"| {medians[0] / medians[-1]:.1f} |",
            )


if __name__ == "__main__":
    main()
