"""The bill of materials: valid CycloneDX, and nothing that is installed to run the service is missing."""

import json
import re
import subprocess
import sys
import tomllib
from importlib.metadata import version
from pathlib import Path

import pytest

pytest.importorskip(
    "cyclonedx", reason="cyclonedx-bom is not installed: no bill of materials was tried"
)
ROOT = Path(__file__).parents[2]


def test_the_tool_of_make_sbom_lists_every_dependency_with_its_version(tmp_path):
    made = (ROOT / "Makefile").read_text()
    (line,) = re.findall(r"cyclonedx-py (environment .*) -o residuum\.cdx\.json", made)
    command = [
        sys.executable,
        "-m",
        "cyclonedx_py",
        *line.split(),
        "-o",
        str(tmp_path / "bom.json"),
        sys.executable,
    ]
    # it validates what it writes
    subprocess.run(command, check=True, cwd=ROOT, capture_output=True, timeout=600)
    bom = json.loads((tmp_path / "bom.json").read_text())
    assert (bom["bomFormat"], bom["metadata"]["component"]["name"]) == ("CycloneDX", "residuum")
    found = {re.sub(r"[-_.]+", "-", each["name"]).lower(): each for each in bom["components"]}
    wanted = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["dependencies"]
    assert len(wanted) > 20
    for dependency in wanted:
        name = re.match(r"[A-Za-z0-9._-]+", dependency)[0].lower()
        assert found[name]["version"] == version(name) and found[name]["purl"].startswith(
            f"pkg:pypi/{name}@"
        )
