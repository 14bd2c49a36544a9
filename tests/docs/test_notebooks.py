"""The notebooks run, and show the pictures that are stored in them."""

import importlib.util
import json
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[2] / "docs"
NOTEBOOKS = sorted((DOCS / "notebooks").glob("*.ipynb"))
SHOWS = {
    "first-hour": ["structured error: yes"],
    "missing-effect": ["coulomb-friction in shaft", "0.0599", "False"],
    "watch-a-machine": ["[1, 1, 1, 1, 1, 1]", "healthy", "faulty (effect)"],
    "bearing": ["'healthy'", "'outer-race'"],
    "robust-controller": ["(100, 60)", "0 unstable", "controller_step"],
}
"""What a reader must find among the outputs of each."""


def runner():
    spec = importlib.util.spec_from_file_location("run_notebooks", DOCS / "run_notebooks.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def pictures(outputs, plotly):
    """Which cells show a picture: one drawn by an answer, or a figure."""
    data = [[output.get("data", {}) for output in cell] for cell in outputs]
    return [
        any(
            "<svg" in "".join(d.get("text/html", "")) or d.get(plotly, {}).get("data") for d in cell
        )
        for cell in data
    ]


def told(outputs):
    return "".join(
        "".join(o.get("text", o.get("data", {}).get("text/plain", "")))
        for cell in outputs
        for o in cell
    )


def test_there_are_five():
    assert {path.stem for path in NOTEBOOKS} == set(SHOWS)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs_and_shows_its_pictures(path):
    module = runner()
    notebook = json.loads(path.read_text(encoding="utf-8"))
    stored = [cell["outputs"] for cell in notebook["cells"] if cell["cell_type"] == "code"]
    made = module.run(notebook)
    assert pictures(made, module.PLOTLY) == pictures(stored, module.PLOTLY)
    assert sum(pictures(made, module.PLOTLY)) >= 2
    for words in SHOWS[path.stem]:
        assert words in told(made) and words in told(stored)
