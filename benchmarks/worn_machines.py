"""`python -m benchmarks.worn_machines [MACHINE…] [--seeds 130,131] [--runs 8]`: time to a limit, told from a machine's windows.

A diagnoser is trained on twenty healthy windows; then a constant of the machine wears linearly, from window to window, at
irregular times, and the model-based diagnoser tells it. At half of the way to the limit the 90 % band of the time that is left is
held against the truth. Each run is the machine's next 30 windows, with pauses and temperatures of their own.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.watched_machines import (
    TRAINED_ON,
    WATCHED,
    Watched,
    constant_of,
    machine_window,
    windows,
)
from residuum.diagnosis.diagnosers.model_based import ModelBased
from residuum.diagnosis.tracks import Track, track

_WINDOWS = 30
_WEAR = {
    "fan": ("tau_c", "tau_c", 0.6),
    "two-tanks": ("a_1", "a_1", -0.3),
    "oven": ("G_ambient", "h", 0.4),
}
"""Constant of the machine that wears, value of the model that tells it, and the share of it that is gained at the limit."""


@dataclass(frozen=True)
class Run:
    """What was said at half of the way, and the time that truly was left."""

    found: Track
    left: float

    @property
    def said(self) -> bool:
        """Whether a time was told."""
        return self.found.remaining is not None and self.found.remaining.low is not None

    @property
    def side(self) -> int:
        """0: the band holds the truth; −1: the truth is earlier, 1: later."""
        remaining = self.found.remaining
        assert remaining is not None and remaining.low is not None
        return (
            -1
            if self.left < remaining.low
            else int(remaining.high is not None and self.left > remaining.high)
        )


def runs(watched: Watched, seed: int, count: int) -> Iterator[Run]:
    """Runs of one machine."""
    judge = ModelBased(model=watched.model(), fix_undetermined=True).fit(
        windows(watched, seed, 0, TRAINED_ON)
    )
    constant, name, share = _WEAR[watched.name]
    healthy = constant_of(watched, seed, constant)
    machine, number = watched.make(seed), 0
    for _ in range(TRAINED_ON):
        machine_window(watched, machine, seed, number, {})
        number += 1
    for run in range(count):
        rng = np.random.default_rng([seed, run, 41])
        t = np.cumsum(rng.exponential(1.0, _WINDOWS))
        wear = 0.5 * share * t / t[-1]
        told, temperatures, usual = [], [], []
        for w in wear.tolist():
            record = machine_window(watched, machine, seed, number, {constant: 1.0 + w})
            number += 1
            parameters = judge.score(record).evidence.get("parameters", {})
            if name in parameters:
                band = parameters[name]["healthy"]
                usual.append(0.5 * (band["low"] + band["high"]))
            told.append(parameters.get(name, {"value": np.nan, "std": np.nan}))
            temperatures.append(
                float(np.mean(record["temperature"])) if "temperature" in record.names else 0.0
            )
        values, std = np.array([p["value"] for p in told]), np.array([p["std"] for p in told])
        x = np.array(temperatures)
        first = float(np.mean(usual))  # at the run's mean temperature
        limit = first + share * (healthy * watched.own[name][1] if name in watched.own else first)
        found = track(t, values, std, moves_with=x if watched.warm else None, limit=limit)
        yield Run(found, float(t[-1]))


def rows(names: Sequence[str], seeds: Sequence[int], count: int) -> Iterator[str]:
    """The table, row by row."""
    yield "| machine | runs | time told | truth in the 90 % band | earlier | later | width ÷ truth |"
    yield "|---|---|---|---|---|---|---|"
    every: list[Run] = []
    for name in names:
        found = [run for seed in seeds for run in runs(WATCHED[name], seed, count)]
        every += found
        yield _row(name, found)
    yield _row("all", every)


def _row(name: str, found: Sequence[Run]) -> str:
    said = [run for run in found if run.said]
    sides = [run.side for run in said]
    widths = []
    for run in said:
        remaining = run.found.remaining
        assert remaining is not None and remaining.low is not None
        widths.append(
            ((np.inf if remaining.high is None else remaining.high) - remaining.low) / run.left
        )
    share = f"{sides.count(0)} = {100 * sides.count(0) / max(len(said), 1):.1f} %"
    width = f"{np.median(widths):.2f}" if widths else "–"
    return f"| {name} | {len(found)} | {len(said)} | {share} | {sides.count(-1)} | {sides.count(1)} | {width} |"


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("machines", nargs="*", default=list(_WEAR))
    parser.add_argument("--seeds", default="130,131")
    parser.add_argument("--runs", type=int, default=8)
    asked = parser.parse_args(arguments if arguments is not None else [])
    for row in rows(
        asked.machines or list(_WEAR), [int(s) for s in asked.seeds.split(",")], asked.runs
    ):
        print(row, flush=True)


if __name__ == "__main__":
    import sys

    main(sys.argv[1:])
