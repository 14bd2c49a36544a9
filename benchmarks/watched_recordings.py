"""Real machines, watched by their first model: windows cut from recordings without a fault, and the same with one input misread.

    python -m benchmarks.watched_recordings CASES_YAML [--only NAME,…] [--windows 16] [--gain 1.1]

CASES_YAML is that of `benchmarks.real_machines`: of each case the model, records to learn from (`train`) and further ones
(`test`). Each record is cut into windows of one length, of which `train` gives 16. What is judged has never been learned from.
`alarms` are at .002 a window; how many windows lie above .2, .05 and .02 shows whether the rate is right. With the gain, an
input of the data is multiplied before the window is judged, and the answer should name it.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from scipy import stats

from benchmarks.model_based import RATES, label, untrained
from residuum.diagnosis.finding import Verdict
from residuum.identification.errors import BadRecord, NotIdentifiable
from residuum.identification.physics import PhysicalModel, load_model
from residuum.identification.record import Record
from residuum.identification.record_formats import read_record


@dataclass(frozen=True)
class Windows:
    """A machine's model, windows to learn from, and windows that are judged."""

    model: PhysicalModel
    learned: list[Record]
    judged: list[Record]


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("cases", type=Path)
    parser.add_argument("--only", default="")
    parser.add_argument("--windows", type=int, default=16)
    parser.add_argument("--gain", type=float, default=1.1)
    asked = parser.parse_args(arguments)
    above = " | ".join(f"above {rate:g}" for rate in RATES)
    print(
        f"| machine | windows | not assessable | {above} | alarms | input × {asked.gain:g}: found | named | first | training |"
    )
    print("|" + "---|" * (8 + len(RATES)))
    for case in yaml.safe_load(asked.cases.read_text(encoding="utf-8")):
        if not asked.only or case["case"] in asked.only.split(","):
            print(
                row(case["case"], windows_of(case, asked.cases.parent, asked.windows), asked.gain),
                flush=True,
            )


def windows_of(case: dict[str, Any], folder: Path, count: int) -> Windows:
    """All records of a case in windows of one length."""
    train, test = (
        [read_record(folder / name) for name in case[what]] for what in ("train", "test")
    )
    length = sum(r.n for r in train) // count
    while sum(r.n // length for r in train) < count:
        length -= 1
    return Windows(
        load_model(folder / case["model"]), *(cut(records, length) for records in (train, test))
    )


def cut(records: Sequence[Record], length: int) -> list[Record]:
    """Windows of this length, one after the other; what is left at the end of a record is none."""
    return [r.window(k, k + length) for r in records for k in range(0, r.n - length + 1, length)]


def row(name: str, windows: Windows, gain: float) -> str:
    """The table's row of one machine."""
    begun = time.process_time()
    first = windows.learned[0]
    try:
        trained = untrained(windows.model, first.n * first.sample_time).fit(windows.learned)
    except (BadRecord, NotIdentifiable) as error:
        return f"| {name} | refused: {error} |"
    seconds = time.process_time() - begun
    healthy = [trained.score(record) for record in windows.judged]
    assessed = [f for f in healthy if f.verdict is not Verdict.NOT_ASSESSABLE]
    p = stats.norm.sf([f.indicators["deviation"] for f in assessed])
    above = " | ".join(str(int(np.sum(p < rate))) for rate in RATES)
    misread = [_misread(record, windows.model, gain) for record in windows.judged]
    found = [f for f in map(trained.score, misread) if f.verdict is Verdict.FAULTY]
    causes = [f.evidence["causes"][0] for f in found]
    gain_of_the_input = f"gain@{next(iter(windows.model.inputs))}"
    named = [
        gain_of_the_input in (label(cause), *cause["indistinguishable_from"]) for cause in causes
    ]
    alarms = sum(f.verdict is Verdict.FAULTY for f in assessed)
    told = ", ".join(sorted({label(cause) for cause in causes}))
    return (
        f"| {name} | {len(healthy)} | {len(healthy) - len(assessed)} | {above} | {alarms} | {len(found)} of {len(misread)} "
        f"| {sum(named)} | {told} | {seconds:.0f} s |"
    )


def _misread(record: Record, model: PhysicalModel, gain: float) -> Record:
    name = next(iter(model.inputs))
    return replace(record, channels={**record.channels, name: gain * record[name]})


if __name__ == "__main__":
    main()
