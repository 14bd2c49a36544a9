"""Time to a limit for linear wear, seen at half of the way: how often does the 90 % band hold the truth?

    python benchmarks/time_to_limit.py --tracks 300

Tracks of 30 to 120 windows at irregular times (exponential pauses), values with the scatter that each window tells and some more
that it does not, moving with a temperature too. Wear begins with the first window, or somewhere in the first 60 %.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from residuum.diagnosis.tracks import Track, track

LIMIT = 2.0
"""The limit, where the value of the last window is 1 and that before the wear 0."""


@dataclass(frozen=True)
class Outcome:
    """One track: what was said, the truth, and the seconds it took."""

    found: Track
    truth: float
    seconds: float

    @property
    def said(self) -> bool:
        """Whether a time was told at all."""
        return self.found.remaining is not None and self.found.remaining.low is not None

    @property
    def side(self) -> int:
        """0: the band holds the truth; −1: the truth is earlier, 1: later."""
        left = self.found.remaining
        assert left is not None and left.low is not None
        return (
            -1 if self.truth < left.low else int(left.high is not None and self.truth > left.high)
        )


def linear_wear(seed: int, *, later: bool) -> Outcome:
    """A machine that wears linearly, at half of the way to the limit; the wear begins later or with the first window."""
    rng = np.random.default_rng([seed, later])
    n = int(rng.integers(30, 120))
    t = np.cumsum(rng.exponential(1.0, n)) * rng.uniform(0.5, 5.0)
    onset = rng.uniform(0.0, 0.6) * t[-1] if later else 0.0
    std = rng.uniform(0.02, 0.15) * np.exp(0.4 * rng.standard_normal(n))
    phase, turns = rng.uniform(0.0, 6.3), rng.uniform(1.0, 6.0)
    temperature = np.sin(2.0 * np.pi * t / t[-1] * turns + phase) + 0.3 * rng.standard_normal(n)
    wear = np.maximum(t - onset, 0.0) / (t[-1] - onset)
    y = (
        wear
        + rng.uniform(-0.3, 0.3) * temperature
        + std * rng.standard_normal(n)
        + rng.uniform(0.0, 0.05) * rng.standard_normal(n)
    )
    begun = time.perf_counter()
    found = track(t, y, std, moves_with=temperature, healthy=(-0.1, 0.1), limit=LIMIT)
    return Outcome(found, float(t[-1] - onset), time.perf_counter() - begun)


def unworn(seed: int, kind: str) -> Track:
    """A track without wear: steady, with one jump, or worn and repaired."""
    rng = np.random.default_rng([seed, 9])
    n = int(rng.integers(40, 150))
    t, std = np.cumsum(rng.exponential(1.0, n)), 0.1 * np.exp(0.3 * rng.standard_normal(n))
    y, at = std * rng.standard_normal(n), int(n * rng.uniform(0.3, 0.7))
    if kind == "sudden-change":
        y[at:] += 0.6
    if kind == "recovery":
        y[:at] += np.linspace(0.0, 1.0, at)
    return track(t, y, std, healthy=(-0.2, 0.2), limit=LIMIT)


def rows(count: int) -> Iterator[str]:
    """The table, row by row."""
    yield "| wear | tracks | time told | truth in the 90 % band | truth earlier | truth later | width ÷ truth | s a track |"
    yield "|---|---|---|---|---|---|---|---|"
    for later in (False, True):
        told = [linear_wear(seed, later=later) for seed in range(count)]
        said = [each for each in told if each.said]
        sides = Counter(each.side for each in said)
        shares = [f"{100 * sides[side] / len(said):.1f} %" for side in (0, -1, 1)]
        widths = [
            ((e.found.remaining.high or np.inf) - e.found.remaining.low) / e.truth for e in said
        ]  # type: ignore[union-attr, operator]
        name = "begins later" if later else "from the first window"
        seconds = np.median([each.seconds for each in told])
        yield f"| {name} | {count} | {len(said)} | {' | '.join(shares)} | {np.median(widths):.2f} | {seconds:.2f} |"
    yield ""
    yield "| truth | tracks | called |"
    yield "|---|---|---|"
    for kind in ("steady", "sudden-change", "recovery"):
        called = Counter(unworn(seed, kind).kind for seed in range(count))
        yield f"| {kind} | {count} | {', '.join(f'{name} {number}' for name, number in called.most_common())} |"


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--tracks", type=int, default=300)
    for row in rows(parser.parse_args().tracks):
        sys.stdout.write(row + "\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
