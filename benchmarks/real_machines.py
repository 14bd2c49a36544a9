"""Real machines, each with the model an engineer would write first: what is missing, and the unseen error without it and with it.

    python -m benchmarks.real_machines CASES_YAML [--only NAME,…] [--seconds S] [--jobs 1] [--out FILE.jsonl]

CASES_YAML is a list; paths are relative to it:

    - case: pendulum
      model: pendulum/model.yaml
      train: [pendulum/train_0.csv]
      test: [pendulum/test_0.csv]
      accept: [[coulomb-friction, stribeck-friction], [viscous-friction]]   # one of each group is to be named or added
      forbidden_first: [quadratic-drag]                                     # must not lead with p > 0.9
      ratio: 0.4              # unseen error: improved over re-estimated first model; or unseen_max: 0.4 (in the output's unit),
                              # or missing_percent_max: 6.5 (missing term over what drives it, where the model integrates)
      learned: false          # true: learned terms are allowed

`accept: []` is a model that lacks nothing. An id may carry a channel (`forgotten-input:next`). Every command runs in a process
of its own, as a user runs it; a crash, or one that does not end, is told below its row. CPU and wall seconds are the process's.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

LIMIT = 600.0
"""Seconds after which a command is ended and counted as hung."""
SURE = 0.9
"""A forbidden effect must not lead with more than this probability."""


@dataclass(frozen=True)
class Answer:
    """What one command gave: its JSON object, or what went wrong."""

    said: dict[str, Any] | None
    error: str | None
    cpu: float
    wall: float


@dataclass(frozen=True)
class Case:
    """One machine: its first model, records for estimation and unseen ones, and what is known to be missing."""

    case: str
    model: Path
    train: tuple[Path, ...]
    test: tuple[Path, ...]
    accept: tuple[tuple[str, ...], ...] = ()
    forbidden_first: tuple[str, ...] = ()
    ratio: float | None = None
    unseen_max: float | None = None
    missing_percent_max: float | None = None
    learned: bool = False
    about: dict[str, Any] = field(default_factory=dict)


def read_cases(file: Path) -> list[Case]:
    """The cases of a file, in its order; keys that are not a case's own go into `about`."""
    own = set(Case.__dataclass_fields__) - {"about"}
    read = []
    for given in yaml.safe_load(file.read_text(encoding="utf-8")):
        settings = {key: value for key, value in given.items() if key in own}
        settings["model"] = file.parent / given["model"]
        for name in ("train", "test"):
            settings[name] = tuple(file.parent / path for path in given[name])
        settings["accept"] = tuple(tuple(group) for group in given.get("accept") or ())
        settings["forbidden_first"] = tuple(given.get("forbidden_first") or ())
        read.append(
            Case(**settings, about={key: value for key, value in given.items() if key not in own})
        )
    return read


def run(*arguments: str | Path, limit: float = LIMIT) -> Answer:
    """`residuum … --json` in a process of its own."""
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err:
        begun = time.monotonic()
        command = [sys.executable, "-m", "residuum", *map(str, arguments), "--json"]
        process = subprocess.Popen(command, stdout=out, stderr=err)
        status, used = _ended(process.pid, begun + limit)
        process.returncode = 0  # it was waited for here, with its use of the processor
        wall, cpu = time.monotonic() - begun, used.ru_utime + used.ru_stime
        texts = []
        for stream in (out, err):
            stream.seek(0)
            texts.append(stream.read().decode("utf-8", "replace").strip())
    code = os.waitstatus_to_exitcode(status)
    if code == -9 and wall >= limit:
        return Answer(None, f"did not end within {limit:.0f} s", cpu, wall)
    try:
        said = json.loads(texts[0])
    except ValueError:
        return Answer(None, f"exit {code}: {texts[1][-300:] or texts[0][-300:]}", cpu, wall)
    return Answer(said, None, cpu, wall)


def _ended(pid: int, until: float) -> Any:
    while True:
        ended, status, used = os.wait4(pid, os.WNOHANG)
        if ended:
            return status, used
        if time.monotonic() > until:
            os.kill(pid, 9)
            _, status, used = os.wait4(pid, 0)
            return status, used
        time.sleep(0.05)


def answers(case: Case, seconds: float | None) -> dict[str, Answer]:
    """What the commands say of a case, by a name each; those that need a model which was not written are left out."""
    budget = [] if seconds is None else ["--seconds", str(seconds)]
    learned = ["--learned"] if case.learned else []
    with tempfile.TemporaryDirectory() as name:
        first, improved = Path(name) / "first.yaml", Path(name) / "improved.yaml"
        said = {
            "explain": run("explain", case.model, *case.train, *learned, *budget),
            "improve": run(
                "improve", case.model, *case.train, "--auto", *learned, "--out", improved, *budget
            ),
            "estimate": run("estimate", case.model, *case.train, "--out", first),
        }
        said["first unseen"] = run("compare", first if first.exists() else case.model, *case.test)
        if improved.exists():
            said["improved seen"] = run("compare", improved, *case.train)
            said["improved unseen"] = run("compare", improved, *case.test)
            said["model"] = Answer({"yaml": improved.read_text(encoding="utf-8")}, None, 0.0, 0.0)
    return said


def named(explanation: dict[str, Any] | None) -> set[str]:
    """What `explain` stands by: its first candidate, what cannot be told from it, and what it names beside it."""
    if (
        explanation is None
        or explanation["verdict"] != "missing-effect"
        or not explanation["candidates"]
    ):
        return set()
    first = explanation["candidates"][0]
    found = {id for c in (first, *explanation.get("also_missing", ())) for id in _ids(c)}
    return found | {other.split("@")[0] for other in first["indistinguishable_from"]}


def added(improvement: dict[str, Any] | None) -> list[dict[str, Any]]:
    """The effects that `improve` wrote into the model."""
    return [] if improvement is None else improvement["effects"]


def _ids(effect: dict[str, Any]) -> set[str]:
    return {effect["effect"]} | (
        {f"{effect['effect']}:{effect['channel']}"} if effect.get("channel") else set()
    )


def accepted(case: Case, said: dict[str, Answer]) -> bool:
    """Whether one of each group is named or added; of a model that lacks nothing, whether nothing is."""
    found = named(said["explain"].said) | {
        id for effect in added(said["improve"].said) for id in _ids(effect)
    }
    return all(found.intersection(group) for group in case.accept) if case.accept else not found


def led_astray(case: Case, explanation: dict[str, Any] | None) -> bool:
    """Whether a forbidden effect leads, and with how much certainty."""
    if explanation is None or not explanation["candidates"]:
        return False
    first = explanation["candidates"][0]
    return bool(_ids(first).intersection(case.forbidden_first)) and first["probability"] > SURE


def unseen(case: Case, compared: Answer | None) -> dict[str, float]:
    """Errors on the unseen records: per output [its unit], or per balance the missing term [% of what drives it]."""
    if compared is None or compared.said is None:
        return {}
    if case.missing_percent_max is not None:
        percents = {
            name: balance["relative_percent"] for name, balance in compared.said["balances"].items()
        }
        return {name: percent for name, percent in percents.items() if percent is not None}
    return {name: output["rmse"] for name, output in compared.said["outputs"].items()}


def ratio(first: dict[str, float], improved: dict[str, float]) -> float:
    """Geometric mean over the outputs of the improved model's error over the first one's."""
    both = [improved[name] / first[name] for name in first if name in improved and first[name]]
    return math.exp(sum(math.log(max(r, 1e-12)) for r in both) / len(both)) if both else math.nan


def gate(case: Case, improved: dict[str, float], found_ratio: float) -> tuple[str, bool]:
    """The gate as text, and whether it is met."""
    largest = case.unseen_max if case.missing_percent_max is None else case.missing_percent_max
    if largest is not None:
        return f"≤ {largest:g}", bool(improved) and max(improved.values()) <= largest
    return ("–", True) if case.ratio is None else (f"× {case.ratio:g}", found_ratio <= case.ratio)


def contradiction(said: dict[str, Answer]) -> bool | None:
    """Whether `compare` on the same records denies what `improve` said of the model it wrote."""
    improvement, compared = (
        said["improve"].said,
        said.get("improved seen", Answer(None, None, 0.0, 0.0)).said,
    )
    if improvement is None or compared is None:
        return None
    return bool((improvement["verdict"] == "adequate") == compared["structured_error"]["present"])


def judged(case: Case, said: dict[str, Answer]) -> dict[str, Any]:
    """The row of a case, from what the commands said."""
    before, after = unseen(case, said["first unseen"]), unseen(case, said.get("improved unseen"))
    found_ratio = ratio(before, after)
    gate_text, met = gate(case, after, found_ratio)
    explanation, improvement = said["explain"].said, said["improve"].said
    return {
        "case": case.case,
        "accept": accepted(case, said),
        "forbidden": led_astray(case, explanation),
        "gate": gate_text,
        "gate_met": met,
        "unseen_first": before,
        "unseen_improved": after,
        "ratio": found_ratio if math.isfinite(found_ratio) else None,
        "verdict": None if explanation is None else explanation["verdict"],
        "candidates": []
        if explanation is None
        else [_short(c) for c in explanation["candidates"][:3]],
        "added": [
            "".join(sorted(_ids(e), key=len)[-1:]) + f"@{e['at']}" for e in added(improvement)
        ],
        "improve_verdict": None if improvement is None else improvement["verdict"],
        "contradiction": contradiction(said),
        "errors": {name: answer.error for name, answer in said.items() if answer.error},
        "about": case.about,
    }


def _short(candidate: dict[str, Any]) -> str:
    share = candidate.get("share")
    taken = "" if share is None else f" share {share['value']:.2f}"
    id = max(_ids(candidate), key=len)
    return f"{id}@{candidate['balance']} p {candidate['probability']:.2f}{taken}"


HEAD = (
    "case | explain: first three | verdict | improve added | unseen first → improved | ratio | gate | met | accept | forbidden"
    " | improve says | contradiction | CPU / wall explain [s] | CPU / wall improve [s]"
)


def line(row: dict[str, Any], said: dict[str, Answer]) -> str:
    """One line of the table."""
    errors = " → ".join(
        ", ".join(f"{v:.3g}" for v in row[key].values()) or "?"
        for key in ("unseen_first", "unseen_improved")
    )
    times = [f"{said[name].cpu:.1f} / {said[name].wall:.1f}" for name in ("explain", "improve")]
    cells = [
        row["case"],
        "; ".join(row["candidates"]) or "–",
        row["verdict"] or "?",
        ", ".join(row["added"]) or "–",
        errors,
        "?" if row["ratio"] is None else f"{row['ratio']:.3f}",
        row["gate"],
        _yes(row["gate_met"]),
        _yes(row["accept"]),
        _yes(row["forbidden"]),
        row["improve_verdict"] or "?",
        _yes(row["contradiction"]),
        *times,
    ]
    return (
        "| "
        + " | ".join(cells)
        + " |"
        + "".join(f"\n  - {name}: {error}" for name, error in row["errors"].items())
    )


def _yes(answer: bool | None) -> str:
    return "?" if answer is None else "yes" if answer else "no"


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("cases", type=Path)
    parser.add_argument("--only", default="", help="names of cases, with commas")
    parser.add_argument(
        "--seconds",
        type=float,
        default=None,
        help="budget of explain and of improve; theirs if not given",
    )
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path("var/real_machines.jsonl"))
    given = parser.parse_args(arguments)
    only = {name for name in given.only.split(",") if name}
    cases = [case for case in read_cases(given.cases) if not only or case.case in only]
    if unknown := only - {case.case for case in cases}:
        sys.exit(f"--only: {', '.join(sorted(unknown))} not among the cases of {given.cases}")
    given.out.parent.mkdir(parents=True, exist_ok=True)
    print(f"| {HEAD} |\n|{'---|' * (HEAD.count('|') + 1)}", flush=True)
    with ThreadPoolExecutor(given.jobs) as pool, given.out.open("w", encoding="utf-8") as out:
        rows = []
        for case, said in zip(
            cases, pool.map(lambda case: answers(case, given.seconds), cases), strict=True
        ):
            row = judged(case, said)
            print(line(row, said), flush=True)
            out.write(
                json.dumps(row | {"answers": {name: vars(answer) for name, answer in said.items()}})
                + "\n"
            )
            out.flush()
            rows.append(row)
    counts = {
        key: sum(bool(row[key]) for row in rows)
        for key in ("accept", "gate_met", "forbidden", "contradiction")
    }
    print(
        f"\n{len(rows)} cases: accept {counts['accept']}, gate met {counts['gate_met']}, forbidden first {counts['forbidden']}, "
        f"contradictions {counts['contradiction']}, with a failed command {sum(bool(row['errors']) for row in rows)}"
    )


if __name__ == "__main__":
    main()
