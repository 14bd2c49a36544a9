"""Hidden effects: is the effect that a simulated machine hides named, and nothing named when nothing is hidden?

Every case is one record of a virtual machine (`residuum.simulation`, which shares no code with the models) explained with the
nominal model. `python -m benchmarks hidden_effects`; the campaign is resumable: each case is appended to $HIDDEN_RESULTS
(default var/hidden_effects.jsonl) and not run again. $HIDDEN_SEEDS (default 1) is the number of seeds a case,
$HIDDEN_FAMILIES (default all) a comma-separated choice of families, $HIDDEN_SIZES one of sizes. Cases are run in an order drawn
by lot, so that a campaign cut short is a fair sample of the whole one; $HIDDEN_SECONDS (default: no end) is when no further case
begins, and what is known by then is told. Whether the probabilities that were said came true is drawn into $HIDDEN_PICTURE
(default var/said_and_true.svg).
"""

import os
import time
from collections import defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import orjson

from benchmarks.said_probabilities import KINDS, Statement, lines_of, real_names, statements, told
from residuum.identification.discrepancy.explain import Explanation, explain
from residuum.identification.discrepancy.improve import improve
from residuum.identification.discrepancy.improvement import Improvement
from residuum.identification.physics import PhysicalModel, candidates, estimate, load_model, match
from residuum.identification.record import Record
from residuum.service.results.report_page import reliability_svg
from residuum.simulation import MACHINES

SEEDS = int(os.environ.get("HIDDEN_SEEDS", "1"))
FIRST_SEED = int(os.environ.get("HIDDEN_FIRST_SEED", "0"))
SIZES = os.environ.get("HIDDEN_SIZES", "small,medium,large").split(",")
FAMILIES = os.environ.get("HIDDEN_FAMILIES", "none,drive,outside,two,oven,tanks,improve").split(",")
SECONDS = float(os.environ.get("HIDDEN_SECONDS", "inf"))
RESULTS = Path(os.environ.get("HIDDEN_RESULTS", "var/hidden_effects.jsonl"))
PICTURE = Path(os.environ.get("HIDDEN_PICTURE", "var/said_and_true.svg"))

SINGLE = ("drive", "oven", "tanks")
"""Families in which one effect of the catalogue is hidden."""
PAIRS = (
    ("coulomb-friction", "inductance"),
    ("viscous-friction", "constant-load"),
    ("quadratic-drag", "tooth-ripple"),
    ("coulomb-friction", "input-delay"),
    ("brush-drop", "position-load"),
)


@dataclass(frozen=True)
class Case:
    """One record: the machine, what it hides, and how it is recorded."""

    family: str
    machine: str
    hidden: tuple[tuple[str, str], ...]
    seed: int
    duration: float
    settings: dict[str, Any] = field(default_factory=dict)
    channels: tuple[str, ...] = ()

    @property
    def key(self) -> str:
        parts = (
            self.family,
            self.machine,
            self.hidden,
            self.seed,
            self.duration,
            self.settings,
            self.channels,
        )
        return orjson.dumps(parts).decode()

    def records(self) -> Iterator[Record]:
        """What the machine shows, one record after the other."""
        machine = MACHINES[self.machine](seed=self.seed, effects=dict(self.hidden), **self.settings)
        while True:
            signals = machine.simulate(self.duration)
            kept = self.channels or tuple(signals.channels)
            yield Record(
                {c: signals.channels[c] for c in kept},
                {c: signals.units[c] for c in kept},
                signals.sample_time,
            )


def cases() -> Iterator[Case]:
    """Seed by seed and family by family."""
    for seed in range(FIRST_SEED, FIRST_SEED + SEEDS):
        for family in FAMILIES:
            yield from _FAMILIES[family](seed)


def _nothing(seed: int) -> Iterator[Case]:
    for rho in (0.0, 0.5, 0.9, 0.99):
        for profile in ("duty-cycle", "rich"):
            yield Case(
                "none", "gate-drive", (), seed, 30.0, {"profile": profile, "noise_color": rho}
            )
    walk = (("x-random-walk-load", "medium"),)
    yield Case("none", "gate-drive", walk, seed, 30.0, {"profile": "duty-cycle"})
    yield Case("none", "gate-drive", walk, seed, 30.0, {"profile": "rich"})


def _drive(seed: int) -> Iterator[Case]:
    for size in SIZES:
        for effect in MACHINES["gate-drive"].effects:
            for profile in ("duty-cycle", "rich"):
                for channels in ((), ("voltage", "speed")):
                    if not effect.startswith("x-"):
                        yield Case(
                            "drive",
                            "gate-drive",
                            ((effect, size),),
                            seed,
                            30.0,
                            {"profile": profile},
                            channels,
                        )


def _outside(seed: int) -> Iterator[Case]:
    for effect in ("x-speed-resonance", "x-random-position-profile"):
        for size in SIZES:
            for profile in ("duty-cycle", "rich"):
                yield Case(
                    "outside", "gate-drive", ((effect, size),), seed, 30.0, {"profile": profile}
                )


def _two(seed: int) -> Iterator[Case]:
    for first, second in PAIRS:
        yield Case(
            "two",
            "gate-drive",
            ((first, "medium"), (second, "medium")),
            seed,
            30.0,
            {"profile": "rich"},
        )


def _oven(seed: int) -> Iterator[Case]:
    for size in SIZES:
        for effect in MACHINES["oven"].effects:
            if not effect.startswith("x-"):
                yield Case(
                    "oven",
                    "oven",
                    ((effect, size),),
                    seed,
                    MACHINES["oven"].record_duration,
                    {"configuration": "lumped"},
                )
    yield Case(
        "none", "oven", (), seed, MACHINES["oven"].record_duration, {"configuration": "lumped"}
    )


def _tanks(seed: int) -> Iterator[Case]:
    for size in SIZES:
        for effect in MACHINES["two-tanks"].effects:
            if not effect.startswith("x-"):
                yield Case(
                    "tanks",
                    "two-tanks",
                    ((effect, size),),
                    seed,
                    MACHINES["two-tanks"].record_duration,
                )
    yield Case("none", "two-tanks", (), seed, MACHINES["two-tanks"].record_duration)


def _improve(seed: int) -> Iterator[Case]:
    """Drive (speed and current), oven, tanks and pairs, each as above."""
    for family in ("drive", "oven", "tanks", "two"):
        yield from (
            replace(case, family="improve")
            for case in _FAMILIES[family](seed)
            if case.hidden and not case.channels
        )


_FAMILIES = {
    "none": _nothing,
    "drive": _drive,
    "outside": _outside,
    "two": _two,
    "oven": _oven,
    "tanks": _tanks,
    "improve": _improve,
}


def run(case: Case) -> dict[str, Any]:
    """Explain one case, or improve its model; the outcome as a JSON object."""
    return _improved(case) if case.family == "improve" else _explained(case)


def _improved(case: Case) -> dict[str, Any]:
    """The next record's simulation error with the model that improve makes of one, and with the true structure refitted to it."""
    nominal, records, began = load_model(case.machine), case.records(), time.perf_counter()
    record, later = next(records), next(records)
    improved = improve(nominal, [record])
    seconds = time.perf_counter() - began
    true = _true_structure(nominal, record, case)
    errors = [estimate(*match(found.model, [later]), free=()).rmse for found in (improved, true)]
    return {
        "case": case.key,
        "verdict": improved.verdict,
        "accepted": [use.id for use in improved.model.effects],
        "ratios": (errors[0] / errors[1]).tolist(),
        "seconds": seconds,
    }


def _true_structure(nominal: PhysicalModel, record: Record, case: Case) -> Improvement:
    """The nominal model with what is hidden, refitted; an effect that fits several places where it leaves the least error."""
    places = product(
        *([f"{id}@{at}" for id, at in candidates(nominal, [hidden])] for hidden, _ in case.hidden)
    )
    found = [improve(nominal, [record], add=list(place)) for place in places]
    return min(found, key=lambda improved: improved.history[-1].error)


def _explained(case: Case) -> dict[str, Any]:
    explanation = explain(load_model(case.machine), [next(case.records())])
    first = explanation.candidates[0] if explanation.candidates else None
    return {
        "case": case.key,
        "verdict": explanation.verdict,
        "first": first.effect if first else None,
        "group": [first.effect, *first.indistinguishable_from] if first else [],
        "chi_square": chi_square(case, explanation) if case.family in SINGLE else None,
        "probability": group_probability(explanation),
        "accepted": [key.effect for key in explanation.accepted],
        "unknown": explanation.probability_unknown,
        "none": explanation.probability_none,
        "by_share": explanation.by_share,
        "candidates": [[c.effect, c.step, c.probability] for c in explanation.candidates],
        "seconds": explanation.seconds,
    }


def chi_square(case: Case, explanation: Explanation) -> float | None:
    """Twice the log-likelihood that the hidden effect gains on unseen blocks: how much of it the record can show.

    None where what is left is not its own noise.
    """
    found, id = explanation.found, case.hidden[0][0]
    if not found.validation.scale.nats:
        return None
    tried = [one for one in found.every.values() if len(one.keys) == 1 and one.keys[0].effect == id]
    best = min(
        (one.cost - found.validation.scale.price * one.parameters for one in tried), default=np.inf
    )
    return max(2.0 * (found.base.cost - best), 0.0) if tried else 0.0


def group_probability(explanation: Explanation) -> float:
    """Probability of the first candidate's whole group."""
    if not explanation.candidates:
        return 0.0
    first = explanation.candidates[0]
    names = {first.effect, *first.indistinguishable_from}
    return float(
        sum(
            c.probability
            for c in explanation.candidates
            if c.effect in names and c.step == first.step
        )
    )


def campaign(chosen: Iterable[Case]) -> list[tuple[Case, dict[str, Any]]]:
    """The cases with their outcomes, from the file of results where they are there already; those that the time allowed."""
    known = {}
    if RESULTS.exists():
        known = {
            line["case"]: line for line in map(orjson.loads, RESULTS.read_bytes().splitlines())
        }
    RESULTS.parent.mkdir(parents=True, exist_ok=True)
    asked, began = list(chosen), time.monotonic()
    for k in np.random.default_rng(0).permutation(len(asked)):
        if asked[k].key in known or time.monotonic() - began > SECONDS:
            continue
        known[asked[k].key] = run(asked[k])
        with RESULTS.open("ab") as file:
            file.write(orjson.dumps(known[asked[k].key]) + b"\n")
    return [(case, known[case.key]) for case in asked if case.key in known]


def main() -> None:
    report(campaign(cases()))


def report(outcomes: list[tuple[Case, dict[str, Any]]]) -> None:
    """Tables: effects named, false blame by noise, effects outside the catalogue, pairs, calibration."""
    _report_single(outcomes)
    _report_nothing_missing(outcomes)
    _report_outside(outcomes)
    print("\n### Two at once\n\n| hidden | accepted |\n|---|---|")
    for case, out in outcomes:
        if case.family == "two":
            print(f"| {' + '.join(id for id, _ in case.hidden)} | {' + '.join(out['accepted'])} |")
    _report_calibration([(case, out) for case, out in outcomes if case.family in SINGLE])
    _report_said(
        [
            s
            for case, out in outcomes
            if "none" in out
            for s in statements([id for id, _ in case.hidden], out)
        ]
    )
    _report_improved(outcomes)
    seconds = [out["seconds"] for _, out in outcomes]
    print(
        f"\nCases: {len(outcomes)}; seconds a case: median {np.median(seconds):.1f}, largest {np.max(seconds):.1f}"
    )


def _report_single(outcomes: list[tuple[Case, dict[str, Any]]]) -> None:
    print("### Hidden effects\n")
    print("| machine | effect | size | named first (group) | misses |\n|---|---|---|---|---|")
    rows: dict[tuple[str, str, str], list[tuple[Case, dict[str, Any]]]] = defaultdict(list)
    for case, out in outcomes:
        if case.family in SINGLE:
            rows[case.machine, *case.hidden[0]].append((case, out))
    for (machine, effect, size), found in rows.items():
        hits = [_hits(case, out) for case, out in found]
        misses = ", ".join(
            _says(case, out) for (case, out), hit in zip(found, hits, strict=True) if not hit
        )
        print(f"| {machine} | {effect} | {size} | {sum(hits)} / {len(hits)} | {misses} |")


def _report_nothing_missing(outcomes: list[tuple[Case, dict[str, Any]]]) -> None:
    print("\n### Nothing missing\n\n| case | not blamed | blamed |\n|---|---|---|")
    quiet: dict[str, list[dict[str, Any]]] = defaultdict(list)
    for case, out in outcomes:
        if case.family == "none":
            what = (
                case.hidden[0][0]
                if case.hidden
                else f"noise ρ = {case.settings.get('noise_color', 0)}"
            )
            quiet[f"{case.machine}, {what}"].append(out)
    for what, found in quiet.items():
        blamed = [
            f"{out['first']} ({out['probability']:.2f})"
            for out in found
            if out["verdict"] == "missing-effect"
        ]
        print(f"| {what} | {len(found) - len(blamed)} / {len(found)} | {', '.join(blamed)} |")


def _report_outside(outcomes: list[tuple[Case, dict[str, Any]]]) -> None:
    print(
        "\n### Outside the catalogue\n\n| effect | size | not claimed with probability above .9 | claimed |\n|---|---|---|---|"
    )
    outside: dict[tuple[str, str], list[dict[str, Any]]] = defaultdict(list)
    for case, out in outcomes:
        if case.family == "outside":
            outside[case.hidden[0]].append(out)
    for (effect, size), found in outside.items():
        claimed = [
            f"{o['first']} ({o['probability']:.2f})"
            for o in found
            if o["probability"] > 0.9 and _blames(o)
        ]
        print(
            f"| {effect} | {size} | {len(found) - len(claimed)} / {len(found)} | {', '.join(claimed)} |"
        )


def _report_calibration(single: list[tuple[Case, dict[str, Any]]]) -> None:
    for least, channels, what in ((150.0, None, "all"), (40.0, (), "all channels")):
        visible = [
            _hits(case, out)
            for case, out in single
            if (out.get("chi_square") or 0.0) >= least
            and (channels is None or case.channels == channels)
        ]
        print(f"\nNamed first where χ² ≥ {least:g} ({what}): {sum(visible)} / {len(visible)}")
    sure = [(case, out) for case, out in single if out["probability"] >= 0.9]
    right = sum(case.hidden[0][0] in out["group"] for case, out in sure if _blames(out))
    print(
        f"\nVerdicts with p ≥ .9 that name the right group: {right} / {sum(_blames(out) for _, out in sure)}"
    )


def _report_said(made: list[Statement]) -> None:
    if made:
        print(told(made))
        PICTURE.parent.mkdir(parents=True, exist_ok=True)
        series = {what: lines_of([s for s in made if s.what == what]) for what in KINDS}
        PICTURE.write_text(
            reliability_svg(
                series, [(s.said, s.true) for s in real_names()], "real machines, first group"
            ),
            encoding="utf-8",
        )


def _report_improved(outcomes: list[tuple[Case, dict[str, Any]]]) -> None:
    ratios = {case.key: max(out["ratios"]) for case, out in outcomes if case.family == "improve"}
    if not ratios:
        return
    print(
        "\n### Improved, beside the true structure refitted\n\n| hidden | kept | error ÷ error, worst output |\n|---|---|---|"
    )
    for case, out in outcomes:
        if case.key in ratios:
            hidden = " + ".join(f"{id} ({size})" for id, size in case.hidden)
            kept = " + ".join(out["accepted"]) or out["verdict"]
            print(
                f"| {case.machine}, {case.settings.get('profile', '')}: {hidden} | {kept} | {ratios[case.key]:.3f} |"
            )
    print(
        f"\nMedian {np.median([*ratios.values()]):.3f}, largest {max(ratios.values()):.3f} of {len(ratios)}"
    )


def _hits(case: Case, out: dict[str, Any]) -> bool:
    return _blames(out) and case.hidden[0][0] in out["group"]


def _blames(out: dict[str, Any]) -> bool:
    return bool(out["verdict"] == "missing-effect")


def _says(case: Case, out: dict[str, Any]) -> str:
    channels = "speed only" if case.channels == ("voltage", "speed") else ""
    where = " ".join(filter(None, [case.settings.get("profile", ""), channels]))
    said = f"{out['first']} {out['probability']:.2f}" if _blames(out) else out["verdict"]
    shown = "" if out.get("chi_square") is None else f", χ² {out['chi_square']:.0f}"
    return f"{where}: {said}{shown}".strip(": ")
