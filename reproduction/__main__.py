"""`python -m reproduction [--short] [--record] [NAME…]`: reproduce the source, or the named parts of it.

Exit status 1 when a check that agreed before, by `agreed.json`, does not agree now; `--record` writes what agrees into that file.
`--short` draws fewer repeats and plants, within a minute, and has a record of its own.
"""

import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

from reproduction.agreement import lost, recorded, with_parts, write_recorded
from reproduction.item import Item
from reproduction.parts import PARTS, run
from reproduction.report import summary, write_report


def main() -> None:
    """Run the parts, say each item's line, write the report."""
    options, names = _arguments()
    short = "--short" in options
    by_part = _run(names, short)
    before = recorded(short)
    gone = lost(before, by_part)
    items = [item for found in by_part.values() for item in found]
    path = Path(__file__).parent / "report.html"
    write_report(items, gone, path)
    print(f"{summary(items)}\nwritten to {path}")
    if "--record" in options:
        write_recorded(with_parts(before, by_part), short)
    elif gone:
        sys.exit("\n".join(f"agreed before, and not now: {', '.join(one)}" for one in gone))


def _arguments() -> tuple[list[str], list[str]]:
    options = [name for name in sys.argv[1:] if name.startswith("--")]
    names = [name for name in sys.argv[1:] if name not in options] or list(PARTS)
    if unknown := [option for option in options if option not in ("--short", "--record")]:
        sys.exit(f"option {unknown[0]!r}: there is none of this name; known are --short, --record")
    if unknown := [name for name in names if name not in PARTS]:
        sys.exit(f"part {unknown[0]!r}: there is none of this name; known are {', '.join(PARTS)}")
    return options, names


def _run(names: Sequence[str], short: bool) -> Mapping[str, Sequence[Item]]:
    by_part = {}
    for name in names:
        begun = time.perf_counter()
        by_part[name] = run(name, short)
        print(f"{name}: {PARTS[name]} ({time.perf_counter() - begun:.0f} s)")
        for item in by_part[name]:
            print(f"  {item.word} {item.where}: {item.says or item.title}", flush=True)
            if item.differs:
                print(f"    reason: {item.reason}")
    return by_part


if __name__ == "__main__":
    main()
