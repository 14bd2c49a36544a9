"""The lock files cover what pyproject.toml asks for, in versions that it allows, each with hashes."""

import re
import tomllib
from pathlib import Path

import pytest
from packaging.markers import default_environment
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
(IMAGE_EXTRAS,) = re.findall(r'pip install .*"\.\[(.*?)\]"', (ROOT / "Dockerfile").read_text())
LOCKS = {"run.lock": [], "image.lock": IMAGE_EXTRAS.split(",")}
PYTHONS = ("3.11", "3.12")


def locked(name, python):
    """Package → version and hashes of a lock file, for a Python."""
    text = (ROOT / "deploy" / name).read_text(encoding="utf-8").replace("\\\n", " ")
    environment = default_environment() | {
        "python_version": python,
        "python_full_version": f"{python}.0",
    }
    found = {}
    for line in text.splitlines():
        if not line.strip() or line.startswith("#"):
            continue
        requirement = Requirement(line.split("--hash")[0].strip())
        if requirement.marker is None or requirement.marker.evaluate(environment):
            (pinned,) = requirement.specifier
            assert pinned.operator == "==" and canonicalize_name(requirement.name) not in found
            found[canonicalize_name(requirement.name)] = (
                pinned.version,
                re.findall(r"--hash=sha256:([0-9a-f]{64})\b", line),
            )
    return found


@pytest.mark.parametrize("python", PYTHONS)
@pytest.mark.parametrize("name", LOCKS)
def test_it_covers_what_is_asked_for(name, python):
    asked = [
        *PROJECT["dependencies"],
        *(each for extra in LOCKS[name] for each in PROJECT["optional-dependencies"][extra]),
    ]
    known = locked(name, python)
    for requirement in map(Requirement, asked):
        version, _ = known[canonicalize_name(requirement.name)]
        assert requirement.specifier.contains(version), (
            f"{requirement} is locked as {version}: make lock"
        )
    assert all(hashes for _, hashes in known.values())


def test_both_lock_the_same_versions():
    """What is tried by `make run` is what the image has."""
    run, image = locked("run.lock", "3.12"), locked("image.lock", "3.12")
    assert run.items() <= image.items()


def test_the_image_and_make_run_install_by_them():
    dockerfile, makefile = (ROOT / "Dockerfile").read_text(), (ROOT / "Makefile").read_text()
    assert "--require-hashes -r image.lock" in dockerfile and "--no-deps" in dockerfile
    assert "--require-hashes -r deploy/run.lock" in makefile
    (extras,) = re.findall(r"foreach extra,([a-z0-9 ]+),", makefile)
    assert set(extras.split()) == set(IMAGE_EXTRAS.split(","))
