"""What all tests share: what takes long to learn is learned once, by the first process that asks, until the code changes."""

import fcntl
import hashlib
import os
import shutil
import sys
from importlib.metadata import version
from itertools import islice
from pathlib import Path

import pytest

from residuum.code_digest import code_digest

ROOT = Path(__file__).parents[1]
LONGEST = (
    "tests/first_use/test_documented_faults.py",
    "tests/service/web/test_watch_page.py",
    "tests/service/machines/test_watched_machine.py",
    "tests/identification/discrepancy/test_compile_ahead.py",
    "tests/identification/discrepancy/test_explain.py",
    "tests/diagnosis/model_based/test_model_based.py",
    "tests/diagnosis/diagnosers/test_conformance.py",
    "tests/diagnosis/model_based/test_recalibration.py",
    "tests/service/web/test_own_units.py",
    "tests/service/api/test_three_doors.py",
    "tests/service/api/test_analyses_api.py",
    "tests/docs/test_worked_models.py",
    "tests/service/simulated/test_demo_start.py",
    "tests/service/test_bearing_over_can.py",
)
"""Files whose tests take longest, or make what others wait for: begun first, so that no process ends long after the others."""
VERSIONS_KEPT = 4
"""Versions of the code for which what was made is kept: the newest."""
MADE_WITH = ("numba", "numpy", "scipy", "scikit-learn")


@pytest.fixture(scope="session")
def made_once(request, tmp_path_factory):
    """`made_once(name, make)`: the file that `make(file)` writes; other processes that run the tests wait for it and take it.

    It stays in pytest's cache for the next run, which takes it only if the whole package, the file with `make`, and the
    libraries that made it are the same.
    """
    kept = _kept_folder(request.config, tmp_path_factory)

    def once(name, make):
        recipe = Path(make.__code__.co_filename).read_bytes()
        folder = kept / hashlib.sha256(recipe).hexdigest()[:16]
        folder.mkdir(exist_ok=True)
        file, finished = folder / name, folder / f"{name}.finished"
        with (folder / f"{name}.lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            if not finished.exists():
                make(file)
                finished.touch()
        return file

    return once


@pytest.fixture(scope="module", autouse=True)
def own_effects():
    """Effects that the model files of a module define are in the catalogue as long as its tests run."""
    effects = sys.modules.get("residuum.identification.physics.effects")
    before = effects.EFFECTS._here.get() if effects else {}
    yield
    if effects := sys.modules.get("residuum.identification.physics.effects"):
        effects.EFFECTS._here.set(before)


def _kept_folder(config, tmp_path_factory):
    """The folder of this version of the code; those of the oldest go. Without pytest's cache it is one of this run alone."""
    versions = [f"{library} {version(library)}" for library in MADE_WITH]
    digest = hashlib.sha256(" ".join([code_digest("residuum"), *versions]).encode()).hexdigest()[
        :16
    ]
    if hasattr(config, "cache"):
        place = config.cache.mkdir("made")
    else:
        place = tmp_path_factory.getbasetemp()
        place = place.parent if "PYTEST_XDIST_WORKER" in os.environ else place
    folder = place / digest
    with (place / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        folder.mkdir(exist_ok=True)
        os.utime(folder)
        if hasattr(config, "cache"):
            kept = sorted(
                (found for found in place.iterdir() if found.is_dir()),
                key=lambda found: -found.stat().st_mtime,
            )
            for old in kept[VERSIONS_KEPT:]:
                shutil.rmtree(old)
    return folder


def pytest_collection_modifyitems(items):
    """Deal the longest files out to the heads of the equal shares that the processes begin with."""
    if gone := [name for name in LONGEST if not (ROOT / name).is_file()]:
        raise pytest.UsageError(f"tests/conftest.py, LONGEST: there is no {gone[0]}")
    if "PYTEST_XDIST_WORKER" in os.environ:
        items[:] = dealt(items, int(os.environ["PYTEST_XDIST_WORKER_COUNT"]))


def dealt(items, processes):
    """The tests in an order whose `processes` equal parts each begin with their turn of the longest files."""
    heads, rest = [[] for _ in range(processes)], []
    place = {ROOT / name: k for k, name in enumerate(LONGEST)}
    for item in sorted(items, key=lambda each: place.get(each.path, len(place))):
        (heads[place[item.path] % processes] if item.path in place else rest).append(item)
    order, waiting = [], iter(rest)
    for k, head in enumerate(heads):
        size = (len(items) - len(order)) // (processes - k)
        order += [*head, *islice(waiting, max(0, size - len(head)))]
    return [*order, *waiting]
