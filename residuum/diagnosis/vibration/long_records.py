"""A recording of hours, judged block by block so that memory does not grow with it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from residuum.diagnosis.finding import Finding, Verdict
from residuum.identification.record import Record

LONGEST = 1 << 22  # samples judged as one: 5 min at 12.8 kHz
_FEWEST_FAULTY = 2
_FAULTY_SHARE = 0.05  # of the blocks


def blocks_of(record: Record, longest: int = LONGEST) -> Iterator[Record]:
    """The record in the fewest equal windows of at most `longest` samples (views of it, no copy).

    >>> record = Record({"a": np.zeros(25)}, {"a": "g"}, 0.1)
    >>> [block.n for block in blocks_of(record, 10)]
    [8, 8, 9]
    """
    count = -(-record.n // longest)
    edges = [k * record.n // count for k in range(count + 1)]
    return (record.window(start, stop) for start, stop in pairwise(edges))


def score_in_blocks(name: str, score: Callable[[Record], Finding], record: Record, longest: int = LONGEST) -> Finding:
    """One finding of the blocks' own.

    Faulty when at least 2 blocks, and 5 % of them, are (a single block of many may be a false alarm; a fault that began
    during the recording still counts), with the class that most of these name. A block that cannot be judged makes the whole not
    assessable, unless others show a fault: a recording with a gap is never healthy. Indicators are medians over the
    blocks that decide; `evidence` says which these are.

    Parameters
    ----------
    name : str
        Of the diagnoser.
    score : callable
        Judges one block.
    longest : int
        Samples of a block.
    """
    findings, seconds = [], []
    for block in blocks_of(record, longest):
        findings.append(score(block))
        seconds.append(float(block.t0 - record.t0))
    faulty = [k for k, finding in enumerate(findings) if finding.verdict is Verdict.FAULTY]
    unusable = [k for k, finding in enumerate(findings) if finding.verdict is Verdict.NOT_ASSESSABLE]
    needed = min(len(findings), max(_FEWEST_FAULTY, int(np.ceil(_FAULTY_SHARE * len(findings)))))
    evidence = {"blocks": len(findings), "block_seconds": record.duration / len(findings)}
    if len(faulty) >= needed:
        named = Counter(findings[k].fault_class for k in faulty).most_common(1)[0][0]
        deciding = [findings[k] for k in faulty if findings[k].fault_class == named]
        evidence |= {"faulty_blocks": len(faulty), "first_faulty_block_s": seconds[faulty[0]]}
        says = (
            f"{len(faulty)} of {len(findings)} blocks are faulty, the first at {seconds[faulty[0]]:.0f} s: {deciding[0].reason}"
        )
        return _together(name, Verdict.FAULTY, named, deciding, evidence, says)
    if unusable:
        k = unusable[0]
        return Finding.not_assessable(
            name, f"block {k + 1} of {len(findings)}, at {seconds[k]:.0f} s: {findings[k].reason}", **evidence
        )
    told = next((f"at {seconds[k]:.0f} s: {finding.reason}" for k, finding in enumerate(findings) if finding.reason), None)
    return _together(name, Verdict.HEALTHY, None, findings, evidence | {"faulty_blocks": len(faulty)}, told)


def _together(
    name: str, verdict: Verdict, named: str | None, findings: Sequence[Finding], evidence: Mapping[str, Any], says: str | None
) -> Finding:
    def median(key: str, part: str) -> float:
        return float(np.median([getattr(finding, part)[key] for finding in findings if key in getattr(finding, part)]))

    first = findings[0]
    return Finding(
        name,
        verdict,
        named,
        {key: median(key, "indicators") for key in first.indicators},
        {key: median(key, "thresholds") for key in first.thresholds},
        first.units,
        {**first.evidence, **evidence},
        says,
    )
