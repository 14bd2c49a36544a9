"""A family by name: what is imported when, and what other packages add."""

import subprocess
import sys

import pytest

from residuum.late_members import LateMembers


def test_a_member_is_what_its_module_defines():
    family = LateMembers[type]({"fraction": ("fractions", "Fraction")})

    assert family["fraction"].__module__ == "fractions"
    assert "fraction" in family
    assert "complex" not in family
    with pytest.raises(KeyError):
        family["complex"]


def test_what_others_add_comes_last_once_and_replaces_nothing():
    asked = []

    def others():
        asked.append(1)
        return {"text": str, "fraction": int}

    family = LateMembers[type]({"fraction": ("fractions", "Fraction")}, others)

    assert family["fraction"].__name__ == "Fraction"
    assert not asked
    assert family["text"] is str
    assert list(family) == ["fraction", "text"]
    assert len(family) == 2
    assert len(asked) == 1


def test_listing_imports_nothing_and_the_order_does_not_depend_on_what_was_loaded():
    code = (
        "import sys; from residuum.late_members import LateMembers;"
        "family = LateMembers({'first': ('colorsys', 'hsv_to_rgb'), 'second': ('fractions', 'Fraction')});"
        "family['second']; print(list(family), 'colorsys' in sys.modules)"
    )
    printed = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    ).stdout

    assert printed == "['first', 'second'] False\n"


def test_one_who_watches_by_vibration_waits_for_no_search_and_no_classifier():
    code = (
        "import sys; from residuum.diagnosis.diagnosers import DIAGNOSERS; DIAGNOSERS['bearing'];"
        "print(sorted(name for name in ('sklearn', 'residuum.identification.unseen_blocks') if name in sys.modules))"
    )
    printed = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    ).stdout

    assert printed == "[]\n"


def test_a_member_is_replaced_and_taken_out_whether_or_not_it_was_loaded():
    family = LateMembers[type](
        {"fraction": ("fractions", "Fraction"), "decimal": ("decimal", "Decimal")},
        lambda: {"text": str},
    )
    family["decimal"] = float
    assert family["decimal"] is float
    assert list(family) == ["fraction", "decimal", "text"]
    for name in ("fraction", "decimal", "text"):
        del family[name]
        assert name not in family
        with pytest.raises(KeyError):
            family[name]
        with pytest.raises(KeyError):
            del family[name]
    assert not list(family)
