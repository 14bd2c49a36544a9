"""Which numbers of the judge on unseen blocks decide a verdict? Each halved, and taken half as large again, on quick records.

`python -m benchmarks.policy_halves [--only NAME,…] [--seconds S]`: every variant is a process of its own, in which the policy has
its value before anything reads it. Told are the answers that differ from those with the policy as it is. All numbers are
halved first; after S seconds no further variant begins.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from importlib import import_module
from typing import Any

import orjson

from residuum.identification.unseen_blocks import policy

FACTORS = (0.5, 1.5)
RUNGS = {0.5: (9, 3, 1), 1.5: (81, 27, 9, 3, 1)}
"""Of the ladder, whose windows have to lie in each other: one rung fewer and one more."""


def numbers() -> list[str]:
    """The names of the policy."""
    return [name for name in vars(policy) if name.isupper()]


def scaled(name: str, factor: float) -> Any:
    """A number of the policy times a factor; what is counted stays a count of at least one."""
    value = getattr(policy, name)
    if name == "WINDOWS_A_RECORD":
        return RUNGS[factor]
    if isinstance(value, Mapping):
        return {key: _times(number, factor) for key, number in value.items()}
    return _times(value, factor)


def _times(value: float, factor: float) -> float:
    return max(1, round(value * factor)) if isinstance(value, int) else value * factor


def variants(only: set[str]) -> Iterator[tuple[str, float]]:
    """Names and factors, in the policy's order for each factor."""
    yield from (
        (name, factor) for factor in FACTORS for name in numbers() if not only or name in only
    )


def answers(name: str = "", factor: float = 1.0) -> dict[str, str]:
    """What is said of each quick record with one number changed, by the record's name."""
    command = [sys.executable, "-m", "benchmarks.policy_halves", "--answer", f"{name}:{factor}"]
    done = subprocess.run(command, capture_output=True, check=False)
    return (
        orjson.loads(done.stdout)
        if done.returncode == 0
        else {"all": done.stderr.decode().strip().splitlines()[-1]}
    )


def answer_each(name: str, factor: float) -> None:
    """In a process of its own: the policy first, then the judge."""
    if name:
        setattr(policy, name, scaled(name, factor))
    records = import_module("benchmarks.quick_records")
    said = {}
    for quick in records.RECORDS:
        try:
            found = quick.answer()
        except Exception as error:  # a variant may leave nothing to judge by: that is its answer
            said[quick.name] = f"{type(error).__name__}: {error}"
        else:
            first = f" {found.candidates[0].probability:.2f}" if found.accepted else ""
            said[quick.name] = (
                " + ".join([found.verdict, *(key.effect for key in found.accepted)]) + first
            )
    sys.stdout.buffer.write(orjson.dumps(said))


def _named(answer: str) -> str:
    """An answer without its probability."""
    return answer.rsplit(" ", 1)[0] if answer[-1:].isdigit() else answer


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", help=argparse.SUPPRESS)
    parser.add_argument("--only", default="", help="numbers of the policy, with commas")
    parser.add_argument("--seconds", type=float, default=float("inf"))
    parser.add_argument("--answer", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.answer:
        name, factor = given.answer.split(":")
        answer_each(name, float(factor))
        return
    usual = answers()
    print("| record | answer |\n|---|---|")
    for record, answer in usual.items():
        print(f"| {record} | {answer} |")
    print("\n| number | is | taken as | answers that differ |\n|---|---|---|---|", flush=True)
    asked, changed, began = 0, set(), time.monotonic()
    for name, factor in variants({name for name in given.only.split(",") if name}):
        if time.monotonic() - began > given.seconds:
            break
        found = answers(name, factor)
        differ = [
            f"{record}: {answer}"
            for record, answer in found.items()
            if _named(answer) != _named(usual.get(record, ""))
        ]
        asked += 1
        changed |= {name} if differ else set()
        print(
            f"| {name} | {_short(getattr(policy, name))} | {_short(scaled(name, factor))} | {'; '.join(differ)} |",
            flush=True,
        )
    minutes = (time.monotonic() - began) / 60.0
    print(
        f"\n{asked} variants of {len(numbers())} numbers; {len(changed)} change an answer; {minutes:.0f} minutes"
    )


def _short(value: Any) -> str:
    return (
        ", ".join(f"{key} {number}" for key, number in value.items())
        if isinstance(value, Mapping)
        else str(value)
    )


if __name__ == "__main__":
    main()
