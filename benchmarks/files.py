"""Mutated record files: thousands of each format, read as an uploaded file is, in a process of its own with the upload's limits.

    python -m benchmarks.files --mutants 2000

A valid file of each format is changed by flipped bits, overwritten, inserted, removed, repeated and swapped stretches, cut ends,
and lengths made extreme; some mutants carry several changes. The reader must give a record or one line of refusal. Its process
is forked from one that has imported everything (the service starts a new interpreter instead, which takes a second); some
mutants go the service's whole way, to see that both agree.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import resource
import sys
import tempfile
import time
from collections import Counter
from importlib import import_module
from pathlib import Path

import h5py
import numpy as np
from scipy.io import savemat

from residuum.identification.errors import BadInput
from residuum.identification.record import Record
from residuum.identification.record_formats import WRITERS, write_record
from residuum.service.work import upload_reader

MEMORY, SECONDS = 512 * 2**20, 10
LARGEST = 1 << 16
"""A file of this size is mutated: small, so that a change hits what describes it as often as its samples."""
LIBRARIES = ("asammdf", "h5py", "nptdms", "pandas", "pyarrow.parquet", "pyuff", "scipy.io")
"""What the readers import when they need it: imported before the fork, so that not every mutant costs a second."""
EXTREME = (
    b"\xff" * 4,
    b"\xff" * 8,
    b"\x00" * 4,
    b"\x00" * 8,
    b"\xff\xff\xff\x7f",
    b"\x00\x00\x00\x80",
    b"9" * 12,
    b"-1",
    b"1e999",
    b"nan",
)


FORMATS = sorted([*(ending[1:] for ending in WRITERS), "mat v5", "mat v7.3"])


def examples(folder: Path) -> dict[str, tuple[str, bytes]]:
    """A valid file of every format: name → (ending, content).

    They are written in a process of their own: a library that has begun threads cannot be used in a forked process.
    """
    child = os.fork()
    if child == 0:
        try:
            _write_examples(folder)
        finally:
            os._exit(0)
    os.waitpid(child, 0)
    return {file.stem: (file.suffix, file.read_bytes()) for file in folder.glob("*.*")}


def _write_examples(folder: Path) -> None:
    t = np.arange(500) / 1000.0
    channels = {"speed": 100.0 + np.sin(20 * t), "current": np.cos(30 * t).astype(np.float32)}
    record = Record(channels, {"speed": "rad/s", "current": "A"}, 1e-3, notes=("split: 0.7",))
    for ending in WRITERS:
        write_record(record, folder / f"{ending[1:]}{ending}")
    with h5py.File(folder / "mat v7.3.mat", "w", userblock_size=512) as file:
        for name, values in {**channels, "time": t}.items():
            file.create_dataset(
                name, data=values[None, :], compression="gzip" if name == "speed" else None
            )
    units = {"speed_unit": "rad/s", "current_unit": "A"}
    savemat(folder / "mat v5.mat", channels | units | {"sample_time": 1e-3}, do_compression=True)


def mutant(content: bytes, rng: random.Random) -> bytes:
    """The content with one to four changes."""
    changed = bytearray(content)
    for _ in range(rng.choice((1, 1, 1, 2, 4))):
        _change(changed, rng)
    return bytes(changed)


def _change(content: bytearray, rng: random.Random) -> None:
    # Heads and tails describe the rest: half of the changes go there.
    n = max(1, len(content))
    at = rng.choice(
        (
            rng.randrange(n),
            rng.randrange(n),
            rng.randrange(min(n, 400)),
            n - 1 - rng.randrange(min(n, 400)),
        )
    )
    length = min(n - at, rng.choice((1, 2, 4, 8, 64, 512)))
    kind = rng.randrange(9)
    if kind == 0:
        content[at : at + 1] = bytes([(content[at] if content else 0) ^ (1 << rng.randrange(8))])
    elif kind == 1:
        content[at : at + length] = rng.randbytes(length)
    elif kind == 2:
        content[at:at] = rng.randbytes(length)
    elif kind == 3:
        del content[at : at + length]
    elif kind == 4:
        content[at:at] = content[at : at + length] * rng.randrange(1, 20)
    elif kind == 5:
        del content[at:]
    elif kind in (6, 7):
        extreme = rng.choice(EXTREME)
        content[at : at + len(extreme)] = extreme
    else:
        other = rng.randrange(n)
        content[at : at + length], content[other : other + length] = (
            content[other : other + length],
            content[at : at + length],
        )


def read_apart(content: bytes, ending: str, folder: Path) -> tuple[str, int, float]:
    """(outcome, peak memory [bytes], seconds) of reading a file in a forked process under the upload's limits."""
    file = folder / f"upload{ending}"
    file.write_bytes(content)
    begun = time.monotonic()
    child = os.fork()
    if child == 0:
        _read_and_exit(file)
    _, status, used = os.wait4(child, 0)
    code = os.waitstatus_to_exitcode(status)
    outcome = {0: "read", 2: "refused"}.get(code, f"reader ended ({code})")
    return outcome, used.ru_maxrss * 1024, time.monotonic() - begun


def _read_and_exit(file: Path) -> None:
    silence = os.open(os.devnull, os.O_WRONLY)
    said = os.open(file.parent / "said", os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    os.dup2(said, 1)
    os.dup2(silence, 2)
    tempfile.tempdir = str(file.parent)
    code = 1
    try:
        code = upload_reader.main(
            MEMORY, SECONDS, str(file), f'{{"options": {{}}, "unpacked": {MEMORY}, "dbc": null}}'
        )
        sys.stdout.flush()
    except Exception as error:
        os.write(1, f"{type(error).__name__}: {error}".encode("utf-8", "replace"))
    finally:
        os._exit(code)


def campaign(
    mutants: int, whole_way: int, seed: int = 0, formats: tuple[str, ...] = ()
) -> dict[str, dict[str, object]]:
    """What became of the mutants of each format."""
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    for name in LIBRARIES:
        import_module(name)
    found: dict[str, dict[str, object]] = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for kind, (ending, content) in sorted(examples(folder).items()):
            if formats and kind not in formats:
                continue
            rng = random.Random(f"{seed} {kind}")
            if read_apart(content, ending, folder)[0] != "read":
                raise RuntimeError(
                    f"the unchanged {kind} file is not read: {(folder / 'said').read_text()}"
                )
            outcomes: Counter[str] = Counter()
            memory, seconds, lines = 0, 0.0, 0
            for _ in range(mutants):
                outcome, most, took = read_apart(mutant(content[:LARGEST], rng), ending, folder)
                outcomes[outcome] += 1
                if outcome.startswith("reader ended"):
                    sys.stderr.write(f"{kind}: {outcome} {(folder / 'said').read_text()[:200]}\n")
                memory, seconds = max(memory, most), max(seconds, took)
                if outcome == "refused" and _is_no_line(folder / "said"):
                    lines += 1
                    sys.stderr.write(
                        f"{kind}: not one line: {(folder / 'said').read_text()[:500]!r}\n"
                    )
            for _ in range(whole_way):
                outcomes[f"whole way: {_whole_way(mutant(content[:LARGEST], rng), ending)}"] += 1
            found[kind] = dict(outcomes) | {
                "MiB": memory >> 20,
                "longest [s]": round(seconds, 2),
                "not one line": lines,
            }
            sys.stderr.write(f"{kind}: {found[kind]}\n")
    return found


def _is_no_line(said: Path) -> bool:
    """Whether a refusal, [kind, parts], is told in no line, in more than one, or in a very long one."""
    _, parts = json.loads(said.read_text())
    text = str(BadInput(**parts))
    return not text.strip() or "\n" in text.strip() or len(text) > 2000


def _whole_way(content: bytes, ending: str) -> str:
    try:
        upload_reader.read_upload(content, ending, f"mine{ending}", memory=MEMORY, seconds=SECONDS)
    except BadInput as error:
        return "not one line" if "\n" in str(error) else "refused"
    return "read"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--mutants", type=int, default=2000)
    parser.add_argument("--whole-way", type=int, default=10)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    print(
        "| format | read | refused | reader ended | most memory [MiB] | longest [s] | not one line |"
    )
    print("|---|---|---|---|---|---|---|")
    wrong = False
    for kind, found in campaign(given.mutants, given.whole_way, given.seed).items():
        ended = sum(
            int(str(times)) for what, times in found.items() if what.startswith("reader ended")
        )
        row = (
            found.get("read", 0),
            found.get("refused", 0),
            ended,
            found["MiB"],
            found["longest [s]"],
            found["not one line"],
        )
        print(f"| {kind} | {' | '.join(map(str, row))} |")
        wrong |= bool(ended or found["not one line"] or "whole way: not one line" in found)
    if wrong:
        sys.exit(1)


if __name__ == "__main__":
    main()
