"""The page's scripts as text: where they stand, who imports whom, and what they must not know."""

import re
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

import residuum.service.web
from residuum.diagnosis.diagnosers import DIAGNOSERS

SCRIPTS = Path(residuum.service.web.__file__).parent / "assets" / "js"
FILES = sorted(SCRIPTS.rglob("*.js"))
BELOW = {
    "lib": (),
    "charts": ("lib",),
    "steps": ("lib", "charts"),
    "pages": ("lib", "charts", "steps"),
    "watch": ("lib", "charts", "steps", "pages"),
}
"""Folders that each folder may import from, beside itself."""


def imports(file):
    return [
        (file.parent / name).resolve() for name in re.findall(r'from "(\.[^"]+)"', file.read_text())
    ]


def folder(file):
    return file.relative_to(SCRIPTS).parts[0]


def test_every_script_stands_in_a_folder_of_its_kind():
    assert {folder(file) for file in FILES} == {*BELOW, "main.js"}


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.name)
def test_imports_lead_downwards_to_files_that_are_there(file):
    allowed = (
        {*BELOW, "main.js"} if folder(file) == "main.js" else {folder(file), *BELOW[folder(file)]}
    )
    assert all(other.is_file() and folder(other) in allowed for other in imports(file))


def test_no_script_imports_itself_by_others():
    TopologicalSorter({file: imports(file) for file in FILES}).prepare()  # CycleError for a cycle


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.name)
def test_lines_are_no_longer_than_pythons_and_no_diagnoser_is_known_by_name(file):
    text = file.read_text()
    assert max(map(len, text.splitlines())) <= 130
    # but a page that is for one diagnoser, and named after it
    others = [name for name in DIAGNOSERS if name != file.stem]
    assert not [name for name in others if re.search(rf"[\"'`]{name}[\"'`]", text)]


def test_heads_of_tables_are_built_in_one_place():
    assert [file.name for file in FILES if '"thead"' in file.read_text()] == ["table_head.js"]
