"""`python -m benchmarks.model_based [MACHINE…] [--seeds 1,2] [--healthy 60] [--faulty 4] [--peers]`.

Trained on 20 healthy windows of a machine whose model is inexact; further healthy windows are counted above the limits of several
rates; faulty ones are found, named and sized. χ² of a fault is the sum of squares by which the whitened innovations of a
window differ from those of the same window (same commands, same noise) without the fault.
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
from benchmarks.window_peers import peers
from residuum.diagnosis.diagnosers.model_based import ModelBased
from residuum.diagnosis.finding import Verdict
from residuum.diagnosis.model_based.assessment import NotAssessable, followed
from residuum.identification.record import Record

RATES = (0.2, 0.05, 0.02)
DECIDED = 0.002
"""False alarms a window at which faults are found."""
ALIKE = 0.02
"""Share of healthy windows above the limit at which peers are compared."""


@dataclass
class Tally:
    """Counts over windows."""

    healthy: int = 0
    above: dict[float, int] = field(default_factory=lambda: dict.fromkeys(RATES, 0))
    seen: list[tuple[float, bool, bool, bool, bool | None]] = field(default_factory=list)  # χ², found, named, confused, covered
    seconds: list[float] = field(default_factory=list)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("machines", nargs="*", default=list(WATCHED))
    parser.add_argument("--seeds", default="1")
    parser.add_argument("--healthy", type=int, default=60)
    parser.add_argument("--faulty", type=int, default=4)
    parser.add_argument("--peers", action="store_true")
    asked = parser.parse_args(arguments if arguments is not None else [])
    above = " | ".join(f"above {rate:g}" for rate in RATES)
    print(f"| machine | windows | {above} | found χ² ≥ 30 | named χ² ≥ 50 | sensor ↔ physics | in 95 % band | CPU |")
    print("|---|---|---|---|---|---|---|---|---|---|")
    details: list[str] = []
    for name in asked.machines or list(WATCHED):
        tally = Tally()
        for seed in map(int, asked.seeds.split(",")):
            details += measured(WATCHED[name], seed, asked, tally)
        print(row(name, tally), flush=True)
    print("\n" + "\n".join(details))


def measured(watched: Watched, seed: int, asked: Any, tally: Tally) -> list[str]:
    """One machine: counts into the tally, and what is worth a line."""
    trained_on, healthy = windows(watched, seed, 0, TRAINED_ON), windows(watched, seed, TRAINED_ON, 150)[: asked.healthy]
    a_day = 86400.0 / watched.seconds
    found = ModelBased(model=watched.model(), fix_undetermined=True).fit(trained_on)
    deviations = np.array([found.score(r).indicators.get("deviation", 0.0) for r in healthy])
    tally.healthy += len(healthy)
    for rate in RATES:
        tally.above[rate] += int(np.sum(deviations > found.baseline.calibration.limit(rate * a_day, watched.seconds)))
    decided = found.with_settings(false_alarms_per_day=DECIDED * a_day)
    others = peers(found.baseline, trained_on) if asked.peers else {}
    limits = {n: np.nanquantile([score(r) for r in healthy], 1.0 - ALIKE) for n, score in others.items()}
    own = float(np.quantile(deviations, 1.0 - ALIKE))
    lines = []
    for fault in watched.faults:
        damaged = windows(watched, seed, TRAINED_ON, 10, fault)[: asked.faulty]
        before = len(tally.seen)
        for h, r in zip(healthy, damaged, strict=False):
            judge(watched, seed, decided, fault, h, r, tally)
        own_of = [decided.score(r).indicators.get("deviation", 0.0) > own for r in damaged] if others else []
        beside = ", ".join(f"{n} {sum(score(r) > limits[n] for r in damaged)}" for n, score in others.items())
        lines.append(_line(watched, seed, fault, tally.seen[before:], sum(own_of), beside))
    return lines


def judge(
    watched: Watched, seed: int, diagnoser: ModelBased, fault: Fault, healthy: Record, record: Record, tally: Tally
) -> None:
    """One faulty window."""
    try:
        rows = [followed(diagnoser.baseline, r).rows for r in (healthy, record)]
        chi_square = float(np.sum((rows[1] - rows[0]) ** 2))
    except NotAssessable:
        chi_square = np.inf
    begun = time.process_time()
    finding = diagnoser.score(record)
    tally.seconds.append(time.process_time() - begun)
    causes = finding.evidence.get("causes") or []
    group = {_label(c) for c in causes[:1]} | {other for c in causes[:1] for other in c["indistinguishable_from"]}
    named = bool(group & set(fault.causes))
    told = causes[0]["kind"] if causes else ""
    confused = bool(causes) and not named and (told == "sensor") != (fault.kind == "sensor") and told != "unknown"
    tally.seen.append(
        (
            chi_square,
            finding.verdict is Verdict.FAULTY,
            named,
            confused,
            _covered(diagnoser, watched, seed, causes, fault, record),
        )
    )


def _label(cause: dict[str, Any]) -> str:
    return f"{cause['name']}@{cause['place']}".rstrip("@")


def _covered(
    diagnoser: ModelBased, watched: Watched, seed: int, causes: Sequence[dict[str, Any]], fault: Fault, record: Record
) -> bool | None:
    """Whether the 95 % band of the size holds the truth; None where the cause was not named or has no truth in the model's terms.

    The truth: the value that is usual under the window's conditions and the change of the machine's own constant (in the model's
    terms), or the offset. What a usual value stands for beside that constant, an effect left out, the fault has not changed.
    """
    if fault.size is None:
        return None
    name = fault.size[0]
    wanted = fault.causes[0] if name == "offset" else name.rpartition(".")[0] or name
    told = [c for c in causes if _label(c) == wanted and c["value"]]
    if not told:
        return None
    low, high = told[0]["value"]["band_95"]
    return bool(low <= truth(diagnoser, watched, seed, fault, record) <= high)


def truth(diagnoser: ModelBased, watched: Watched, seed: int, fault: Fault, record: Record) -> float:
    """The true size of a fault in the model's terms."""
    assert fault.size is not None
    name, size = fault.size
    usual = _usual(diagnoser, fault.causes[0] if name == "offset" else f"parameter:{name}", record)
    if name == "offset":
        return size + usual
    if name not in watched.own:
        return size * usual
    constant, terms = watched.own[name]
    return usual + (size - 1.0) * constant_of(watched, seed, constant) * terms


def _usual(diagnoser: ModelBased, what: str, record: Record) -> float:
    """Usual under the window's conditions: of `parameter:NAME` or of a cause by its label; NaN where it is not asked for."""
    b = diagnoser.baseline
    about = b.scatter.mean(b.beside.conditions(record)) * b.scatter.scale
    for h, group in zip(b.hypotheses, b.groups, strict=True):
        acts_on = h.columns[0].acts_on
        if what in (acts_on, h.label):
            name = acts_on.removeprefix("parameter:")
            return float(about[group.sizes[0]] + (b.tracking.model.values[name] if acts_on != name else 0.0))
    return float("nan")


def row(name: str, tally: Tally) -> str:
    """A machine's line of the table."""
    above = " | ".join(f"{tally.above[p]} ({p * tally.healthy:.0f}; {_band(tally.above[p])})" for p in RATES)
    strong, stronger = [s for s in tally.seen if s[0] >= 30], [s for s in tally.seen if s[0] >= 50]
    covered = [s[4] for s in tally.seen if s[4] is not None]
    return (
        f"| {name} | {tally.healthy} | {above} | {sum(s[1] for s in strong)}/{len(strong)} | {sum(s[2] for s in stronger)}/"
        f"{len(stronger)} | {sum(s[3] for s in tally.seen)}/{len(tally.seen)} | {sum(covered)}/{len(covered)} | "
        f"{1e3 * np.median(tally.seconds):.0f} ms |"
    )


def _band(count: int) -> str:
    """95 % band of a count's expectation (Poisson)."""
    low = stats.chi2.ppf(0.025, 2 * count) / 2 if count else 0.0
    return f"{low:.1f}–{stats.chi2.ppf(0.975, 2 * count + 2) / 2:.1f}"


def _line(watched: Watched, seed: int, fault: Fault, seen: Sequence[tuple[Any, ...]], own: int, beside: str) -> str:
    chi = np.median([s[0] for s in seen])
    text = f"{watched.name} {seed}, {fault.id}: χ² {chi:.3g}, found {sum(s[1] for s in seen)}, named {sum(s[2] for s in seen)}"
    return f"{text} of {len(seen)}" + (f"; at equal rate model-based {own}, {beside}" if beside else "")


if __name__ == "__main__":
    import sys

    main(sys.argv[1:])
