"""Who may import whom: data flows one way, and the simulators share no code with the models they test."""

import ast
from pathlib import Path

import pytest

import residuum

ROOT = Path(residuum.__file__).parent
MAY_IMPORT = {
    "identification": set(),
    "diagnosis": {"identification"},
    "robust_control": {"identification"},
    "simulation": set(),
    "library": {"identification", "diagnosis", "robust_control", "simulation"},
    "service": {"identification", "diagnosis", "robust_control", "simulation", "library"},
}
FOR_ALL = {"residuum.code_folder", "residuum.kept_loops"}
"""How compiled code is kept: no physics and no method, so also the simulators may use it."""
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
            yield from {f"{name}.{alias.name}" if is_module(f"{name}.{alias.name}") else name for alias in node.names}


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
                assert any(str(path.relative_to(ROOT)).startswith(place) for place in MAY_USE_SIMULATION), f"imports {name}"
        if room != "service":
            assert top not in ONLY_IN_SERVICE, f"{name} belongs to service"
        if room == "service" and len(parts) > 2 and parts[1] in APART and top == "residuum" and rest[:1] == ["service"]:
            assert len(rest) < 2 or rest[1] not in APART or rest[1] == parts[1], f"{parts[1]} must not import {name}"


def test_no_import_cycles():
    graph = {}
    for path in modules():
        name = ".".join(["residuum", *path.relative_to(ROOT).with_suffix("").parts]).removesuffix(".__init__")
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


STARTED = {
    "__main__": "python -m residuum",
    "identification/discrepancy/compile_ahead": "python -m, by make and the container's build",
    "identification/physics/files/model_schema": "docs/make_reference.py writes the schema of model files from it",
    "identification/unit_registry": "units loads it for a unit that is none of the common ones",
    "service/fieldbus/can_record": "the commands load it when a record is a CAN log: the libraries of buses take a second",
    "service/fieldbus/opcua": "the list of sources loads it when such a source is opened: its library is an extra",
    "service/fieldbus/sparkplug": "the list of sources loads it when such a source is opened: its libraries are an extra",
    "service/finding_metrics": "the service loads it when findings are published as Sparkplug B: its libraries are an extra",
    "service/finding_nodes": "the service loads it when findings are offered over OPC UA: its library is an extra",
    "service/commands/": "the console program loads a command by its name",
    "service/storage/migrations/": "alembic loads them by their place",
    "service/work/worker_preload": "the fork server loads it by its name",
}
"""What nothing imports because something else starts it, and what that is."""


def test_every_module_is_reached():
    """A module that nothing imports is started by something named here, or goes: to the peers of `benchmarks`, or altogether."""
    names = {str(path.relative_to(ROOT).with_suffix("")): path for path in modules() if path.stem != "__init__"}
    reached = {name for path in modules() for name in imported(path)}
    alone = {name for name in names if "residuum." + name.replace("/", ".") not in reached}
    unnamed = {name for name in alone if not name.startswith(tuple(STARTED))}
    assert not unnamed, f"nothing reaches {sorted(unnamed)}"
