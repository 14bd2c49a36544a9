"""`python -m reproduction [--record] [NAME…]`: reproduce the source, or the named parts of it.

Exit status 1 when an item that agreed before, by `agreed.json`, does not agree now; `--record` writes what agrees into that file.
"""

import sys
from importlib import import_module
from pathlib import Path

from reproduction.agreement import lost, recorded, with_parts, write_recorded
from reproduction.report import write_report

PARTS: dict[str, str] = {
    "prediction_error": "Examples 1.2–1.4, Fig. 25–32: least squares and its ellipses",
    "uncertainty": "Fig. 43–45: identification of (2.38) and its uncertainty weights",
    "robust_residual": "Fig. 56–58: the robust residual of (4.10) and sensor steps of 30 and of 3",
    "gripping_pliers": "Fig. 73–77, Table 6: the damaged bearing of the gripping pliers",
    "gate_actuator": "Fig. 78, 85–87, Table 7: criticality, residual, features and classifier of the gate actuator",
    "robust_control": "Fig. 42, 46–54: manual and automatic controllers for (2.38), and the true plant",
    "oven": "Fig. 60–65: one controller for the best and the worst configuration of the oven",
}
"""Module of this package → what of the source it reproduces; each has `items() -> list[Item]`."""


def main() -> None:
    """Run the parts, say each item's line, write the report."""
    record = "--record" in sys.argv[1:]
    names = [name for name in sys.argv[1:] if name != "--record"] or list(PARTS)
    if unknown := [name for name in names if name not in PARTS]:
        sys.exit(f"part {unknown[0]!r}: there is none of this name; known are {', '.join(PARTS)}")
    items, by_part = [], {}
    for name in names:
        print(f"{name}: {PARTS[name]}")
        found = import_module(f"reproduction.{name}").items()
        items += found
        by_part[name] = found
        for item in found:
            print(f"  {item.word} {item.where}: {item.says}")
    path = Path(__file__).parent / "report.html"
    write_report(items, path)
    print(f"written to {path}")
    before = recorded()
    if record:
        write_recorded(with_parts(before, by_part))
    elif gone := lost(before, by_part):
        sys.exit("\n".join(f"agreed before, and not now: {part}, {where}" for part, where in gone))


if __name__ == "__main__":
    main()
