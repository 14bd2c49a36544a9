"""Golden outputs: what two source trees answer to the same commands and HTTP calls, compared but for time, seconds and version.

    python -m benchmarks.golden record OLD_TREE old.json --inputs FOLDER      (inputs are simulated by this tree if not there)
    python -m benchmarks.golden record NEW_TREE new.json --inputs FOLDER
    python -m benchmarks.golden record NEW_TREE new.json --inputs FOLDER --only 'explain|improve'      (these commands, no calls)
    python -m benchmarks.golden compare old.json new.json [--table FILE]      (exit status 1 when something differs unexpectedly)

The cases, and which answers were changed on purpose and why, are `golden_cases.yaml`.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping
from http.client import HTTPConnection
from pathlib import Path
from typing import Any
from urllib.parse import urlencode

import yaml

from benchmarks.free_port import free_port

CASES = Path(__file__).with_name("golden_cases.yaml")
UNTIMELY = (
    "seconds",
    "version",
    "elapsed",
    "started",
    "finished",
    "submitted",
    "created",
    "updated",
    "uptime",
    "request_id",
)
"""Names of members whose values are times of the clock, durations, versions or drawn at random; names with these endings, too."""
ROUNDING = 1e-6
"""Relative difference up to which a number differs by rounding."""
_TIME = r"\d{4}-\d\d-\d\d[T ]\d\d:\d\d(:\d\d(\.\d+)?)?(Z|[+-]\d\d:?\d\d)?|(?<=, )\d+(\.\d+)? s$|(?<=\()\d+(\.\d+)? s(?=\))"
"""Times of the clock, and seconds that close a text or stand alone in brackets, the work's; `settling 12 s` is an answer."""
RUN = "from residuum.service.cli import main; main()"
PATIENCE = 600.0

Answer = dict[str, Any]


def simulate_inputs(tree: Path, folder: Path, cases: Mapping[str, Any]) -> None:
    """Recorded inputs: simulated ones with fixed seeds, and the bad files that the cases spell out."""
    folder.mkdir(parents=True)
    for line in cases["simulated"]:
        done = run_command(tree, f"simulate {line}", folder)
        if done["status"]:
            raise SystemExit(f"simulate {line}: {done['error']}")
    for name, text in cases["files"].items():
        (folder / name).write_text(text)


def run_command(tree: Path, line: str, folder: Path) -> Answer:
    """Exit status, standard output (parsed where it is JSON) and the last line of standard error of `residuum LINE`."""
    done = subprocess.run(
        [sys.executable, "-c", RUN, *line.split()],
        cwd=folder, env=surroundings(tree, folder), capture_output=True, text=True, timeout=PATIENCE, check=False,
    )  # fmt: skip
    error = done.stderr.strip().splitlines()
    return {
        "status": done.returncode,
        "answer": parsed(done.stdout),
        "error": error[-1] if done.returncode and error else "",
    }


def surroundings(tree: Path, folder: Path) -> dict[str, str]:
    """Environment in which the tree's own package is imported; kernels are cached beside the inputs, for each tree."""
    return os.environ | {
        "PYTHONPATH": str(tree),
        "RESIDUUM_CACHE": str(folder / "kernels"),
        "COLUMNS": "200",
    }


def parsed(text: str) -> Any:
    """JSON, or the text's lines."""
    try:
        return json.loads(text)
    except ValueError:
        return text.splitlines()


class Service:
    """`residuum serve` of a tree, on a free port and with data of its own."""

    def __init__(self, tree: Path, folder: Path) -> None:
        self.folder, self.port = folder, free_port()
        serve = ["serve", "--port", str(self.port), "--data", str(folder / "data")]
        environment = surroundings(tree, folder) | {"RESIDUUM_LOG_LEVEL": "error"}
        self.process = subprocess.Popen(
            [sys.executable, "-c", RUN, *serve], cwd=folder, env=environment
        )

    def __enter__(self) -> Service:
        end = time.monotonic() + PATIENCE
        while True:
            try:
                if self.ask("GET", "/api/v1/health/ready")["status"] == 200:
                    return self
            except OSError:
                if self.process.poll() is not None or time.monotonic() > end:
                    raise SystemExit("the service did not start") from None
            time.sleep(0.2)

    def __exit__(self, *_: object) -> None:
        self.process.terminate()
        self.process.wait(60)

    def call(self, case: Mapping[str, Any]) -> Answer:
        """One call as the case spells it; of a job, what it was in the end."""
        query = urlencode(case.get("query", {}), doseq=True)
        body, kind = self._body(case)
        heads = ({"Content-Type": kind} if kind else {}) | case.get("heads", {})
        answer = self.ask(
            case["method"], case["path"] + (f"?{query}" if query else ""), body, heads
        )
        end = time.monotonic() + PATIENCE
        while (place := answer["place"]) and time.monotonic() < end:
            job = self.ask("GET", place)
            if job["answer"]["state"] not in ("queued", "running"):
                return {"status": answer["status"], "answer": job["answer"]}
            time.sleep(0.1)
        return {"status": answer["status"], "answer": answer["answer"]}

    def ask(
        self,
        method: str,
        path: str,
        body: bytes | None = None,
        heads: Mapping[str, str] | None = None,
    ) -> Answer:
        """Status, answer, and the place of the job that a 202 names."""
        connection = HTTPConnection("127.0.0.1", self.port, timeout=PATIENCE)
        connection.request(method, path, body, dict(heads or {}))
        answer = connection.getresponse()
        text = answer.read().decode("utf-8", "replace")
        connection.close()
        return {
            "status": answer.status,
            "answer": parsed(text),
            "place": answer.status == 202 and answer.headers["location"],
        }

    def _body(self, case: Mapping[str, Any]) -> tuple[bytes | None, str]:
        if "json" in case:
            return json.dumps(case["json"]).encode(), "application/json"
        if "file" in case:
            return (self.folder / case["file"]).read_bytes(), case.get(
                "kind", "application/octet-stream"
            )
        return (
            (case["text"].encode(), case.get("kind", "application/json"))
            if "text" in case
            else (None, "")
        )


def record(tree: Path, out: Path, inputs: Path, only: str | None) -> None:
    """Write what a tree answers to every case, or to the commands that match `only`."""
    cases = yaml.safe_load(CASES.read_text())
    if not inputs.exists():
        simulate_inputs(tree, inputs, cases)
    found: dict[str, Answer] = {}
    with tempfile.TemporaryDirectory(prefix="golden-") as temporary:
        folder = Path(temporary) / "records"
        shutil.copytree(inputs, folder, ignore=shutil.ignore_patterns("kernels"))
        for line in (line for line in cases["commands"] if only is None or re.search(only, line)):
            found[f"residuum {line}"] = run_command(tree, line, folder)
        if only is None:
            with Service(tree, folder) as service:
                for case in cases["calls"]:
                    found[named(case, found)] = service.call(case)
    where = subprocess.run(
        ["git", "-C", tree, "rev-parse", "--short", "HEAD"],
        capture_output=True,
        text=True,
        check=False,
    )
    plain = json.dumps(
        {"commit": where.stdout.strip(), "only": only, "answers": found},
        indent=1,
        ensure_ascii=False,
    )
    out.write_text(plain.replace(str(Path(temporary)), "FOLDER").replace(str(tree), "TREE"))


def named(case: Mapping[str, Any], known: Mapping[str, Answer]) -> str:
    """What a call is called in the table: its method and path, with what it is there for or how many went before."""
    name = f"{case['method']} {case['path']}" + (f" ({case['says']})" if "says" in case else "")
    before = sum(other == name or other.startswith(f"{name} #") for other in known)
    return f"{name} #{before + 1}" if before else name


def differences(old: Any, new: Any, place: str = "") -> Iterator[tuple[str, str]]:
    """(kind, place) of all that differs: `more` (a member that was not there), `rounding`, `less` or `other`."""
    if isinstance(old, dict) and isinstance(new, dict):
        yield from _of_members(old, new, place)
    elif isinstance(old, list) and isinstance(new, list) and len(old) == len(new):
        for k, (one, other) in enumerate(zip(old, new, strict=True)):
            yield from differences(one, other, f"{place}[{k}]")
    elif isinstance(old, bool) is not isinstance(new, bool):
        # true == 1 in Python, and in no answer
        yield "other", place
    elif old != new and without_times(without_places(old)) != without_times(without_places(new)):
        yield ("rounding" if alike(old, new) else "other"), place


def _of_members(old: Answer, new: Answer, place: str) -> Iterator[tuple[str, str]]:
    for name in old.keys() | new.keys():
        where = f"{place}.{name}"
        if untimely(name, old.get(name), new.get(name)):
            continue
        if name not in old or name not in new:
            yield ("more" if name in new else "less"), where
        else:
            yield from differences(old[name], new[name], where)


def untimely(name: str, *values: Any) -> bool:
    """Whether a member of this name is a time, a duration or a version by its values, too; `falsified_at: [0.3]` is an answer."""
    named_so = (
        name in UNTIMELY
        or name.endswith(tuple(f"_{word}" for word in UNTIMELY))
        or name.endswith("_at")
    )
    return named_so and not any(isinstance(value, list | dict | bool) for value in values)


def without_times(value: Any) -> Any:
    """A text with the clock's times and the numbers of seconds in it masked, so that all its other words still count."""
    return re.sub(_TIME, "TIME", value) if isinstance(value, str) else value


def without_places(value: Any) -> Any:
    """A text without the names of temporary folders in it."""
    return re.sub(r"/tmp/tmp\w+", "TEMPORARY", value) if isinstance(value, str) else value


def alike(old: Any, new: Any) -> bool:
    """Whether two values are numbers that differ by rounding."""
    numbers = all(
        isinstance(value, int | float) and not isinstance(value, bool) for value in (old, new)
    )
    return numbers and math.isclose(old, new, rel_tol=ROUNDING, abs_tol=1e-12)


def judged(old: Answer, new: Answer) -> tuple[str, list[str]]:
    """The heaviest kind of difference of one case, and its places; those of what changed and of what is gone together."""
    found = sorted(differences(old, new))
    for kinds in (("other", "less"), ("rounding",), ("more",)):
        if places := [place for kind, place in found if kind in kinds]:
            return next(kind for kind in kinds if any(kind == one for one, _ in found)), places
    return "same", []


def on_purpose(name: str, kind: str, places: list[str], changes: list[Mapping[str, str]]) -> str:
    """Why an answer was changed, where a change that is listed explains every place; empty where none does."""
    fitting = [change for change in changes if re.search(change["case"], name)]
    fits = all(any(re.search(change["place"], place) for change in fitting) for place in places)
    return "; ".join(dict.fromkeys(change["why"] for change in fitting)) if fitting and fits else ""


def asked_again(old: Mapping[str, Any], new: Mapping[str, Any]) -> list[str]:
    """Cases of the old record that the new one must answer too: all, or the commands that its `--only` matches."""
    only = new.get("only")
    if only is None:
        return list(old["answers"])
    commands = (name for name in old["answers"] if name.startswith("residuum "))
    return [name for name in commands if re.search(only, name.removeprefix("residuum "))]


def compare(old_file: Path, new_file: Path, table: Path | None, verbose: bool) -> int:
    """Print (and write) a table of the cases by kind of difference.

    1 when one differs, or is not answered any more, that no listed change explains, and when nothing was compared.
    """
    old, new = (json.loads(path.read_text()) for path in (old_file, new_file))
    changes = yaml.safe_load(CASES.read_text())["changed_on_purpose"]
    rows, count, unexpected = (
        [],
        {"same": 0, "more": 0, "rounding": 0, "changed on purpose": 0, "unexpected": 0},
        0,
    )
    names = asked_again(old, new)
    for name in names:
        answered = name in new["answers"]
        kind, places = (
            judged(old["answers"][name], new["answers"][name])
            if answered
            else ("less", ["no answer"])
        )
        why = (
            on_purpose(name, kind, places, changes) if kind in ("other", "less", "rounding") else ""
        )
        verdict = (
            "changed on purpose" if why else "unexpected" if kind in ("other", "less") else kind
        )
        count[verdict] += 1
        unexpected += verdict == "unexpected"
        if verdict not in ("same", "more"):
            rows.append(
                f"| `{name}` | {verdict} | {', '.join(places[:3])}{' …' if len(places) > 3 else ''} | {why} |"
            )
        if verbose and kind != "same":
            for place in places:
                print(f"{verdict:20} {name} {place}")
    lines = [
        f"`python -m benchmarks.golden compare`: {old['commit']} beside {new['commit']}", "",
        "| " + " | ".join(count) + " |", "|---" * len(count) + "|", "| " + " | ".join(map(str, count.values())) + " |", "",
        "| case | verdict | where | why |", "|---|---|---|---|", *rows,
    ]  # fmt: skip
    print("\n".join(lines))
    if table:
        table.write_text("# Golden outputs\n\n" + "\n".join(lines) + "\n")
    return int(unexpected > 0 or not names)


def main() -> int:
    """The command line."""
    parser = argparse.ArgumentParser(prog="benchmarks.golden", description=__doc__.splitlines()[0])
    does = parser.add_subparsers(required=True, dest="does")
    recording = does.add_parser("record")
    recording.add_argument("tree", type=Path)
    recording.add_argument("out", type=Path)
    recording.add_argument("--inputs", type=Path, required=True)
    recording.add_argument("--only")
    comparing = does.add_parser("compare")
    comparing.add_argument("old", type=Path)
    comparing.add_argument("new", type=Path)
    comparing.add_argument("--table", type=Path)
    comparing.add_argument("--verbose", action="store_true")
    given = parser.parse_args()
    if given.does == "compare":
        return compare(given.old, given.new, given.table, given.verbose)
    record(given.tree.resolve(), given.out, given.inputs.resolve(), given.only)
    return 0


if __name__ == "__main__":
    sys.exit(main())
