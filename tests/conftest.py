"""What all tests share: things that take long to learn are learned once in a run, by the first of its processes that asks."""

import fcntl
import os

import pytest


@pytest.fixture(scope="session")
def made_once(tmp_path_factory):
    """`made_once(name, make)`: the file that `make(file)` writes; other processes that run the tests wait for it and take it."""
    folder = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        folder = folder.parent

    def once(name, make):
        file, finished = folder / name, folder / f"{name}.finished"
        with (folder / f"{name}.lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            if not finished.exists():
                make(file)
                finished.touch()
        return file

    return once
