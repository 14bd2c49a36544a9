"""`python -m benchmarks.healthy_days [MACHINE…] [--seeds 140] [--days 30] [--most 4000]`: false alarms over simulated days.

A diagnoser is trained on twenty healthy windows; the machine goes on healthy, at every temperature of the training, and what lies
above the limits of several rates is counted over so many days of windows that follow one another, or over the `--most` first of
them where a day has many. A window is made, judged and forgotten.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence

import numpy as np
from scipy import stats

from benchmarks.watched_machines import TRAINED_ON, WATCHED, Watched, machine_window, windows
from residuum.diagnosis.diagnosers.model_based import ModelBased

_SECONDS_A_DAY = 86400.0
_RATES = (0.2, 0.02, 0.002)
"""Alarms a window; the last column is one a day."""


def counted(watched: Watched, seed: int, days: float, most: int) -> str:
    """A machine's line of the table."""
    judge = ModelBased(model=watched.model(), fix_undetermined=True).fit(
        windows(watched, seed, 0, TRAINED_ON)
    )
    a_day = _SECONDS_A_DAY / watched.seconds
    machine = watched.make(seed)
    for k in range(TRAINED_ON):
        machine_window(watched, machine, seed, k, {})
    number = min(int(np.ceil(days * a_day)), most)
    begun = time.process_time()
    deviations = np.array(
        [
            judge.score(machine_window(watched, machine, seed, TRAINED_ON + k, {})).indicators.get(
                "deviation", 0.0
            )
            for k in range(number)
        ]
    )
    spent = (time.process_time() - begun) / number
    cells = [_cell(deviations, rate) for rate in (*_RATES, 1.0 / a_day)]
    return f"| {watched.name} | {seed} | {number} | {number / a_day:.3g} | {' | '.join(cells)} | {1e3 * spent:.0f} ms |"


def _cell(deviations: np.ndarray, rate: float) -> str:
    """Alarms, and in brackets those expected and the 95 % band (Poisson) of the expectation that the count allows."""
    count = int(np.sum(stats.norm.sf(deviations) < rate))
    low = stats.chi2.ppf(0.025, 2 * count) / 2 if count else 0.0
    return f"{count} ({rate * len(deviations):.3g}; {low:.1f}–{stats.chi2.ppf(0.975, 2 * count + 2) / 2:.1f})"


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("machines", nargs="*", default=list(WATCHED))
    parser.add_argument("--seeds", default="140")
    parser.add_argument("--days", type=float, default=30.0)
    parser.add_argument("--most", type=int, default=4000)
    asked = parser.parse_args(arguments if arguments is not None else [])
    above = " | ".join(f"above {rate:g} a window" for rate in _RATES)
    print(f"| machine | seed | windows | days | {above} | above 1 a day | CPU, made and judged |")
    print("|---|---|---|---|---|---|---|---|---|")
    for name in asked.machines or list(WATCHED):
        for seed in map(int, asked.seeds.split(",")):
            print(counted(WATCHED[name], seed, asked.days, asked.most), flush=True)


if __name__ == "__main__":
    import sys

    main(sys.argv[1:])
