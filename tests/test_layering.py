"""Who may import whom: data flows one way, and the simulators share no code with the models they test."""

import ast
import re
from pathlib import Path

import pytest

import residuum
from residuum.service.commands import COMMANDS

ROOT = Path(residuum.__file__).parent
MAY_IMPORT = {
    "identification": set(),
    "diagnosis": {"identification"},
    "robust_control": {"identification"},
    "simulation": set(),
    "library": {"identification", "diagnosis", "robust_control", "simulation"},
    "service": {"identification", "diagnosis", "robust_control", "simulation", "library"},
}
FOR_ALL = {
    f"residuum.{name}"
    for name in (
        "array_types",
        "code_digest",
        "code_folder",
        "kept_loops",
        "late_members",
        "nearest_names",
    )
}
"""Types of arrays, how compiled code is kept, how a family loads its members, how a name is refused:
no physics, no method; simulators may use it, too.
"""
ONLY_IN_SERVICE = {
    "fastapi",
    "starlette",
    "pydantic",
    "pydantic_settings",
    "sqlalchemy",
    "can",
    "cantools",
    "pymodbus",
    "typer",
    "uvicorn",
}
QUESTIONS = ("library", "questions")
"""Here pydantic declares what all doors ask."""
MAY_USE_SIMULATION = ("library/virtual_machine", "service/commands/", "service/simulated/")
APART = ("fieldbus", "storage", "api")


def modules():
    return sorted(path for path in ROOT.rglob("*.py"))


def imported(path):
    package = ("residuum", *path.relative_to(ROOT).parts[:-1])
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else ()
            name = ".".join([*base, *([node.module] if node.module else [])])
            yield from {
                f"{name}.{alias.name}" if is_module(f"{name}.{alias.name}") else name
                for alias in node.names
            }


def is_module(name):
    place = ROOT.parent.joinpath(*name.split("."))
    return place.with_suffix(".py").is_file() or (place / "__init__.py").is_file()


@pytest.mark.parametrize("path", modules(), ids=lambda path: str(path.relative_to(ROOT)))
def test_imports_follow_the_layers(path):
    parts = path.relative_to(ROOT).parts
    if len(parts) == 1:
        return
    room = parts[0]
    for name in imported(path):
        top, *rest = name.split(".")
        if top == "residuum" and rest and rest[0] != room and name not in FOR_ALL:
            assert rest[0] in MAY_IMPORT[room], f"{room} must not import {name}"
            if rest[0] == "simulation":
                assert any(
                    str(path.relative_to(ROOT)).startswith(place) for place in MAY_USE_SIMULATION
                ), f"imports {name}"
        if room != "service" and not (top == "pydantic" and parts[:2] == QUESTIONS):
            assert top not in ONLY_IN_SERVICE, f"{name} belongs to service"
        if (
            room == "service"
            and len(parts) > 2
            and parts[1] in APART
            and top == "residuum"
            and rest[:1] == ["service"]
        ):
            assert len(rest) < 2 or rest[1] not in APART or rest[1] == parts[1], (
                f"{parts[1]} must not import {name}"
            )


def test_no_import_cycles():
    graph = {}
    for path in modules():
        name = ".".join(["residuum", *path.relative_to(ROOT).with_suffix("").parts]).removesuffix(
            ".__init__"
        )
        graph[name] = {target for target in imported(path) if target.startswith("residuum.")}
    done: set[str] = set()

    def visit(name, trail):
        assert name not in trail, f"import cycle: {' → '.join([*trail[trail.index(name) :], name])}"
        if name in done or name not in graph:
            return
        for target in graph[name]:
            if target != name:
                visit(target, [*trail, name])
        done.add(name)

    for name in graph:
        visit(name, [])


SEARCH = ROOT / "identification/unseen_blocks"


def test_the_plan_draws_the_search_as_its_imports_run():
    """What ARCHITECTURE.md calls a chain is one: every module stands in it, right of all that it imports of its room."""
    text = (ROOT.parent / "ARCHITECTURE.md").read_text(encoding="utf-8")
    chain = text.partition("each importing only what stands left of it:")[2].split("`")[1].split()
    assert sorted(chain) == sorted(
        path.stem for path in SEARCH.glob("*.py") if path.stem != "__init__"
    )
    for place, name in enumerate(chain):
        of_the_room = {
            each.rpartition(".")[2]
            for each in imported(SEARCH / f"{name}.py")
            if ".unseen_blocks." in each
        }
        assert of_the_room <= set(chain[:place]), name


def test_rooms_do_not_import_each_other_in_circles():
    """The pictures, which a test of the written pages holds against the imports, join rooms that do by a plus."""
    text = (ROOT.parent / "ARCHITECTURE.md").read_text(encoding="utf-8")
    joined = set(re.findall(r"\[([\w ]+ \+ [\w +]+)\]", text))
    assert joined == {"kernel_based + linear_models"}  # two halves of one room


DOORS = {
    "library": ["residuum"],
    "command line": [
        "residuum.__main__",
        "residuum.service.cli",
        *(f"residuum.service.commands.{module}" for module, _ in COMMANDS.values()),
    ],
    "service": ["residuum.service.app"],
}
"""Where a user comes in, and the modules that this begins with; commands are loaded by their names."""
STARTED = {
    "identification/physics/files/model_schema": "docs/make_reference.py writes the schema of model files from it",
    "service/storage/migrations/": "alembic loads them by their place",
}
"""What no door reaches because something else starts it, and what that is."""


def named(path):
    """Modules that the text of a module names: what is imported by its name, when it is needed."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if (
            isinstance(node, ast.Constant)
            and isinstance(node.value, str)
            and node.value.startswith("residuum.")
        ):
            yield node.value


def dotted(path):
    return ".".join(["residuum", *path.relative_to(ROOT).with_suffix("").parts]).removesuffix(
        ".__init__"
    )


def reached_from(starts):
    """All modules; and those that these import, with the packages that they lie in, however far away."""
    files = {dotted(path): path for path in modules()}
    reached, waiting = set(), list(starts)
    while waiting:
        name = waiting.pop()
        if name in files and name not in reached:
            reached.add(name)
            waiting += [*imported(files[name]), *named(files[name]), name.rpartition(".")[0]]
    return set(files), reached


def test_every_module_is_reached_from_a_door():
    """A module that neither library nor commands nor service reach gets a door, or goes: to the peers, or altogether."""
    everything, reached = reached_from(start for starts in DOORS.values() for start in starts)
    places = {
        f"{name.removeprefix('residuum.').replace('.', '/')}/" for name in everything - reached
    }
    unnamed = {place for place in places if not place.startswith(tuple(STARTED))}
    assert not unnamed, f"neither library nor command line nor service reaches {sorted(unnamed)}"
    assert all(any(place.startswith(start) for place in places) for start in STARTED), (
        "what is reached needs no other start"
    )


@pytest.mark.parametrize("door", DOORS)
def test_what_begins_a_door_is_there(door):
    everything, _ = reached_from(())
    assert set(DOORS[door]) <= everything


def test_what_only_a_name_in_nobodys_text_reaches_is_found(tmp_path, monkeypatch):
    (tmp_path / "library").mkdir()
    (tmp_path / "__init__.py").write_text("from residuum.library import used")
    (tmp_path / "library" / "island.py").write_text("from residuum.library import other_island")
    for name in ("__init__", "used", "other_island"):
        (tmp_path / "library" / f"{name}.py").touch()
    (tmp_path / "residuum").symlink_to(tmp_path)
    monkeypatch.setattr(f"{__name__}.ROOT", tmp_path / "residuum")
    everything, reached = reached_from(["residuum"])
    assert everything - reached == {"residuum.library.island", "residuum.library.other_island"}
