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
        if top == "residuum" and rest and rest[0] != room:
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
