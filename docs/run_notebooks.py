"""Run the notebooks of `docs/notebooks` and write what they show into them: `python docs/run_notebooks.py [NAME…]`.

A cell is run as a notebook runs it: its statements one after the other, and the value of its last expression is shown.
No Jupyter is needed; the tests run the cells in the same way.
"""

import ast
import contextlib
import io
import json
import os
import sys
import tempfile
from pathlib import Path
from typing import Any

FOLDER = Path(__file__).parent / "notebooks"
PLOTLY = "application/vnd.plotly.v1+json"


def shown(source: str, names: dict[str, Any]) -> list[dict[str, Any]]:
    """Run a cell in `names`; its outputs as a notebook file keeps them."""
    tree = ast.parse(source)
    last = tree.body.pop() if tree.body and isinstance(tree.body[-1], ast.Expr) else None
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        exec(compile(tree, "<cell>", "exec"), names)  # noqa: S102  a notebook is code to run
        value = (
            None
            if last is None
            else eval(compile(ast.Expression(last.value), "<cell>", "eval"), names)  # noqa: S307
        )
    outputs: list[dict[str, Any]] = []
    if text := printed.getvalue():
        outputs.append(
            {"output_type": "stream", "name": "stdout", "text": text.splitlines(keepends=True)}
        )
    if value is not None:
        outputs.append(
            {
                "output_type": "execute_result",
                "execution_count": None,
                "metadata": {},
                "data": _pictured(value),
            }
        )
    return outputs


def _pictured(value: Any) -> dict[str, Any]:
    """A value as text, and as the picture that a notebook shows of it."""
    if hasattr(value, "to_plotly_json"):
        return {"text/plain": ["Figure"], PLOTLY: json.loads(value.to_json())}
    html = (
        {"text/html": value._repr_html_().splitlines(keepends=True)}
        if hasattr(value, "_repr_html_")
        else {}
    )
    return {"text/plain": repr(value).splitlines(keepends=True), **html}


def run(notebook: dict[str, Any]) -> list[list[dict[str, Any]]]:
    """The outputs of every code cell, run one after the other in a folder of their own."""
    names: dict[str, Any] = {"__name__": "notebook"}
    here = os.getcwd()
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        try:
            return [
                shown("".join(cell["source"]), names)
                for cell in notebook["cells"]
                if cell["cell_type"] == "code"
            ]
        finally:
            os.chdir(here)


def main() -> None:
    """Write the outputs of the named notebooks, or of all."""
    for path in sorted(FOLDER.glob("*.ipynb")):
        if sys.argv[1:] and path.stem not in sys.argv[1:]:
            continue
        notebook = json.loads(path.read_text(encoding="utf-8"))
        code = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
        for number, (cell, outputs) in enumerate(zip(code, run(notebook), strict=True), start=1):
            for output in outputs:
                if "execution_count" in output:
                    output["execution_count"] = number
            cell["execution_count"], cell["outputs"] = number, outputs
        path.write_text(json.dumps(notebook, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
