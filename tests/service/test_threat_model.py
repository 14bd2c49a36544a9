"""The threat model names the tests that stand behind it, and each of them is there and holds tests."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
MODEL = ROOT / "docs" / "explanation" / "threat-model.md"
DOORS = re.search(r"## Doors\n(.*?)\n## ", MODEL.read_text(encoding="utf-8"), re.DOTALL)[1]
ROWS = [line.split("|")[1:-1] for line in DOORS.splitlines() if line.startswith("|")][2:]


def test_every_door_has_something_against_it_and_a_test_of_it():
    assert len(ROWS) >= 13
    for door, threat, against, tests in ROWS:
        assert against.strip() and re.search(r"\b[STRIDE]\b", threat), door
        named = re.findall(r"`(tests/[\w/]+\.py)`", tests)
        assert named, f"{door}: no test"
        for name in named:
            assert re.search(
                r"^def test_", (ROOT / name).read_text(encoding="utf-8"), re.MULTILINE
            ), f"{name}: holds no test"


def test_whatever_guards_a_door_in_the_tests_is_named():
    """A test of security or of refusals that no door names has been forgotten in the model."""
    named = set(re.findall(r"`(tests/[\w/]+\.py)`", DOORS))
    guards = [
        *ROOT.glob("tests/service/security/test_*.py"),
        *ROOT.glob("tests/service/api/test_*access*.py"),
    ]
    guards += [
        ROOT / "tests/service/api" / f"test_{name}.py"
        for name in ("gate", "bad_requests", "bearer_tokens", "long_bodies")
    ]
    assert {str(guard.relative_to(ROOT)) for guard in guards} <= named
