"""`python -m benchmarks.watched_pairs [MACHINE…] [--seed 1] [--pairs 10] [--onsets 10]`: two causes at once, and causes that
begin within the window.

Trained as in `benchmarks.model_based`. Pairs are drawn by the seed; beginnings lie between a fifth and four fifths of
the window.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from typing import Any

import numpy as np

from benchmarks.model_based import label, untrained
from benchmarks.watched_machines import TRAINED_ON, WATCHED, Fault, Watched, record_of, windows
from residuum.diagnosis.diagnosers.model_based import ModelBased
from residuum.diagnosis.finding import Verdict

NEAR = 0.03
"""[of the window] By which a beginning may be missed."""
SURE = 0.9
"""Probability with which one of two causes must not be told alone."""


def main(arguments: list[str]) -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("machines", nargs="*")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--pairs", type=int, default=10)
    parser.add_argument("--onsets", type=int, default=10)
    asked = parser.parse_args(arguments)
    for name in asked.machines or ["gate-drive", "two-tanks", "pendulum"]:
        watched = WATCHED[name]
        trained = untrained(watched.model(), watched.seconds).fit(
            windows(watched, asked.seed, 0, TRAINED_ON)
        )
        print(f"{name}, seed {asked.seed}", flush=True)
        counts: dict[str, int] = {}
        for line, kind in [*pairs(watched, trained, asked), *onsets(watched, trained, asked)]:
            counts[kind] = counts.get(kind, 0) + 1
            print(f"  {line}: {kind}", flush=True)
        print(f"  {counts}", flush=True)


def pairs(watched: Watched, trained: ModelBased, asked: Any) -> Iterator[tuple[str, str]]:
    """Windows with two faults."""
    rng = np.random.default_rng([asked.seed, 51])
    for k in range(asked.pairs):
        first, second = _two(watched, rng)
        both = Fault(
            f"{first.id} and {second.id}",
            (),
            scaled={**(first.scaled or {}), **(second.scaled or {})},
            set={**(first.set or {}), **(second.set or {})},
            reading={**(first.reading or {}), **(second.reading or {})},
        )
        record = windows(watched, asked.seed, TRAINED_ON + k, 1, both)[0]
        finding = trained.score(record)
        causes = finding.evidence.get("causes") or []
        yield f"{both.id}: {told(causes)}", f"pair, {_pair(finding.verdict, causes, first, second)}"


def _two(watched: Watched, rng: np.random.Generator) -> tuple[Fault, Fault]:
    while True:
        i, j = rng.choice(len(watched.faults), 2, replace=False)
        first, second = watched.faults[i], watched.faults[j]
        if not (
            set(first.scaled or ()) & set(second.scaled or ())
            or set(first.causes) & set(second.causes)
        ):
            return first, second


def _pair(verdict: Verdict, causes: list[dict[str, Any]], first: Fault, second: Fault) -> str:
    if verdict is not Verdict.FAULTY:
        return "not found"
    named = [_is(cause, first) or _is(cause, second) for cause in causes[:3]]
    unknown = any(c["kind"] == "unknown" for c in causes[:2])
    both = any(_is(c, first) for c in causes[:2]) and any(_is(c, second) for c in causes[:2])
    if unknown and not both:
        return "`unknown` beside one of them" if any(named[:2]) else "`unknown` beside another"
    if both:
        return "both named"
    if causes[0]["probability"] > SURE:
        return "one alone, sure" if named[0] else "another alone, sure"
    return "unsure"


def onsets(watched: Watched, trained: ModelBased, asked: Any) -> Iterator[tuple[str, str]]:
    """Windows in which a fault begins."""
    rng = np.random.default_rng([asked.seed, 52])
    for k in range(asked.onsets):
        fault = watched.faults[int(rng.integers(len(watched.faults)))]
        share = float(rng.uniform(0.2, 0.8))
        record = record_of(watched, asked.seed, TRAINED_ON + k, fault, share)
        finding = trained.score(record)
        causes = finding.evidence.get("causes") or []
        begins = record.t0 + share * watched.seconds
        said = causes[0]["onset_time"] if causes else None
        off = "no onset" if said is None else f"{(said - begins) / watched.seconds:+.3f}"
        if finding.verdict is not Verdict.FAULTY:
            kind = "not found"
        else:
            near = said is not None and abs(said - begins) <= NEAR * watched.seconds
            kind = f"{'in time' if near else 'late or early'}, {'named' if _is(causes[0], fault) else 'another named'}"
        yield f"{fault.id} from {share:.2f}: {told(causes)}; {off}", f"onset, {kind}"


def _is(cause: dict[str, Any], fault: Fault) -> bool:
    return bool({label(cause), *cause["indistinguishable_from"]} & set(fault.causes))


def told(causes: list[dict[str, Any]]) -> str:
    """The first three, with their probabilities."""
    return ", ".join(f"{label(c)} {c['probability']:.2f}" for c in causes[:3]) or "healthy"


if __name__ == "__main__":
    import sys

    main(sys.argv[1:])
