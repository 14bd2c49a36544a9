"""`python -m benchmarks.model_based [MACHINE…] [--seeds 1,2] [--healthy 20] [--faulty 2]`.

Trained on 20 healthy windows of a machine whose model is inexact; further healthy windows are judged at several rates of false
alarms; faulty ones are found, named and sized.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy import stats

from benchmarks.watched_machines import TRAINED_ON, WATCHED, Fault, Watched, constant_of, windows
from residuum.diagnosis.diagnosers.model_based import ModelBased
from residuum.diagnosis.finding import Verdict
from residuum.identification.physics import PhysicalModel
from residuum.identification.record import Record

RATES = (0.2, 0.05, 0.02)
DECIDED = 0.002
"""False alarms a window at which faults are found."""


@dataclass(frozen=True)
class Answer:
    """On one faulty window; `covered`: whether the 95 % band holds the true size, None where there is none."""

    found: bool
    first: bool
    named: bool
    confused: bool
    covered: bool | None


@dataclass
class Tally:
    """Counts over windows."""

    healthy: int = 0
    alarms: int = 0
    above: dict[float, int] = field(default_factory=lambda: dict.fromkeys(RATES, 0))
    answers: list[Answer] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)
    trained: list[float] = field(default_factory=list)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("machines", nargs="*", default=list(WATCHED))
    parser.add_argument("--seeds", default="1")
    parser.add_argument("--healthy", type=int, default=20)
    parser.add_argument("--faulty", type=int, default=2)
    asked = parser.parse_args(arguments if arguments is not None else [])
    above = " | ".join(f"above {rate:g}" for rate in RATES)
    print(
        f"| machine | windows | {above} | alarms | found | in group | first | sensor ↔ physics | in band | CPU | training |"
    )
    print("|" + "---|" * 13)
    details: list[str] = []
    for name in asked.machines or list(WATCHED):
        tally = Tally()
        for seed in map(int, asked.seeds.split(",")):
            details += measured(WATCHED[name], seed, asked, tally)
        print(row(name, tally), flush=True)
    print("\n" + "\n".join(details))


def untrained(model: PhysicalModel, seconds: float) -> ModelBased:
    """The diagnoser of a machine with windows of so many seconds, at the rate of false alarms at which faults are found."""
    return ModelBased(
        model=model, fix_undetermined=True, false_alarms_per_day=DECIDED * 86400.0 / seconds
    )


def measured(watched: Watched, seed: int, asked: Any, tally: Tally) -> list[str]:
    """One machine: counts into the tally, and a line a fault."""
    trained_on, healthy = (
        windows(watched, seed, 0, TRAINED_ON),
        windows(watched, seed, TRAINED_ON, 150)[: asked.healthy],
    )
    begun = time.process_time()
    trained = untrained(watched.model(), watched.seconds).fit(trained_on)
    tally.trained.append(time.process_time() - begun)
    scores = [trained.score(r) for r in healthy]
    chances = stats.norm.sf([f.indicators.get("deviation", 0.0) for f in scores])
    tally.healthy += len(healthy)
    tally.alarms += sum(f.verdict is Verdict.FAULTY for f in scores)
    for rate in RATES:
        tally.above[rate] += int(np.sum(chances < rate))
    lines = [f"{watched.name} {seed}: lacks {', '.join(trained.baseline.mended) or 'nothing'}"]
    for fault in watched.faults:
        told = []
        for record in windows(watched, seed, TRAINED_ON, 10, fault)[: asked.faulty]:
            begun = time.process_time()
            finding = trained.score(record)
            tally.seconds.append(time.process_time() - begun)
            causes = finding.evidence.get("causes") or []
            tally.answers.append(
                judged(
                    trained, watched, seed, fault, finding.verdict is Verdict.FAULTY, causes, record
                )
            )
            told.append(
                f"{label(causes[0])} {causes[0]['probability']:.2f}"
                if causes
                else finding.verdict.value
            )
        lines.append(
            f"{watched.name} {seed}, {fault.id} ({' or '.join(fault.causes)}): {', '.join(told)}"
        )
    return lines


def judged(
    trained: ModelBased,
    watched: Watched,
    seed: int,
    fault: Fault,
    faulty: bool,
    causes: list[dict[str, Any]],
    record: Record,
) -> Answer:
    """What was right in the answer on one faulty window."""
    if not causes:
        return Answer(faulty, False, False, False, None)
    first, told = label(causes[0]), causes[0]["kind"]
    named = bool({first, *causes[0]["indistinguishable_from"]} & set(fault.causes))
    confused = not named and (told == "sensor") != (fault.kind == "sensor") and told != "unknown"
    return Answer(
        faulty,
        first in fault.causes,
        named,
        confused,
        _covered(trained, watched, seed, causes, fault, record),
    )


def label(cause: dict[str, Any]) -> str:
    """As which a cause is named in `Fault.causes`."""
    return f"{cause['name']}@{cause['place']}".rstrip("@")


def _covered(
    trained: ModelBased,
    watched: Watched,
    seed: int,
    causes: Sequence[dict[str, Any]],
    fault: Fault,
    record: Record,
) -> bool | None:
    """Whether the 95 % band of the size holds the truth; None where the cause was not named or has no such size."""
    if fault.size is None:
        return None
    name = fault.size[0]
    wanted = fault.causes[0] if fault.kind == "sensor" else name.rpartition(".")[0] or name
    told = [c for c in causes if label(c) == wanted and c["value"]]
    true = truth(trained, watched, seed, fault, record)
    if not told or true is None:
        return None
    low, high = told[0]["value"]["band_95"]
    return bool(low <= true <= high)


def truth(
    trained: ModelBased, watched: Watched, seed: int, fault: Fault, record: Record
) -> float | None:
    """The true size in the model's terms: of a value the usual one for such a run, changed as the machine's own constant was."""
    assert fault.size is not None
    name, size = fault.size
    if fault.kind == "sensor":
        return size
    band = trained.score(record).evidence["parameters"].get(name)
    if band is None:
        return None
    usual = 0.5 * (band["healthy"]["low"] + band["healthy"]["high"])
    if name not in watched.own:
        return size * usual
    constant, terms = watched.own[name]
    return usual + (size - 1.0) * constant_of(watched, seed, constant) * terms


def row(name: str, tally: Tally) -> str:
    """A machine's line of the table."""
    above = " | ".join(
        f"{tally.above[p]} ({p * tally.healthy:.0f}; {_band(tally.above[p])})" for p in RATES
    )
    answers, many = tally.answers, len(tally.answers)
    covered = [a.covered for a in answers if a.covered is not None]
    counts = (
        sum(a.found for a in answers),
        sum(a.named for a in answers),
        sum(a.first for a in answers),
    )
    shares = " | ".join(f"{count}/{many}" for count in (*counts, sum(a.confused for a in answers)))
    return (
        f"| {name} | {tally.healthy} | {above} | {tally.alarms} | {shares} | {sum(covered)}/{len(covered)} | "
        f"{np.median(tally.seconds):.1f} s | {np.median(tally.trained):.0f} s |"
    )


def _band(count: int) -> str:
    """95 % band of a count's expectation (Poisson)."""
    low = stats.chi2.ppf(0.025, 2 * count) / 2 if count else 0.0
    return f"{low:.1f}–{stats.chi2.ppf(0.975, 2 * count + 2) / 2:.1f}"


if __name__ == "__main__":
    import sys

    main(sys.argv[1:])
