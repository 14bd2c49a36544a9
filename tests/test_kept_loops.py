"""A compiled loop is compiled anew when anything changes that it is made of, and only then."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import residuum

CALLED = "from residuum.{place} import njit\n\n@njit({kept})\ndef gain(x):\n    return {gain} * x\n"
CALLING = """from residuum.{place} import njit
from residuum.room import (
    called,
)
from residuum.room.numbers import OFFSET
gain = called.gain

@njit({kept})
def line(x):
    return gain(x) + OFFSET
"""
RUN = """
import numba.core.event as event
class Compiled(event.Listener):
    def on_start(self, e): print("compiled", e.data["dispatcher"].py_func.__name__)
    def on_end(self, e): pass
event.register("numba:compile", Compiled())
from residuum.room.calling import line
print(line(1.0))
"""


@pytest.fixture
def package(tmp_path):
    """A package of this one's name with two loops, one calling the other; `run()` gives what it prints, or a copy of it."""
    real, room = Path(residuum.__file__).parent, tmp_path / "residuum" / "room"
    room.mkdir(parents=True)
    for name in ("code_folder.py", "kept_loops.py"):
        shutil.copy(real / name, tmp_path / "residuum")
    for folder in (tmp_path / "residuum", room):
        (folder / "__init__.py").touch()
    (tmp_path / "residuum" / "plain.py").write_text("from numba import njit\n")

    def write(gain, offset, place="kept_loops", kept=""):
        (room / "called.py").write_text(CALLED.format(place=place, kept=kept, gain=gain))
        (room / "calling.py").write_text(CALLING.format(place=place, kept=kept))
        (room / "numbers.py").write_text(f"OFFSET = {offset}\n")

    def run(where=tmp_path):
        environment = os.environ | {
            "PYTHONPATH": str(where),
            "NUMBA_CACHE_DIR": str(tmp_path / "kept"),
        }
        environment["PYTHONDONTWRITEBYTECODE"] = (
            "1"  # Python's own takes a file of the same second and size for the same
        )
        command = [sys.executable, "-c", RUN]
        done = subprocess.run(
            command, env=environment, cwd=where, capture_output=True, text=True, check=False
        )
        assert not done.returncode, done.stderr
        return done.stdout.split("\n")[:-1]

    return write, run


def test_a_loop_follows_what_it_calls_and_the_numbers_it_holds(package, tmp_path):
    write, run = package
    write(2.0, 1.0)
    assert run() == ["compiled line", "compiled gain", "3.0"]
    assert run() == ["3.0"]
    write(5.0, 1.0)
    assert run()[-1] == "6.0"
    write(5.0, 7.0)
    assert run() == ["compiled line", "12.0"]  # the called one knows nothing of that number
    assert run() == ["12.0"]


def test_versions_of_a_loop_do_not_pile_up(package, tmp_path):
    write, run = package
    for gain in range(7):
        write(float(gain), 0.0)
        assert run()[-1] == str(float(gain))
    assert len(list(tmp_path.glob("kept/loops/*called/*/*.nbc"))) == 4
    write(6.0, 0.0)
    assert run() == ["6.0"]  # the newest stay


def test_a_copied_package_compiles_nothing_again(package, tmp_path):
    write, run = package
    write(2.0, 1.0)
    assert run()[-1] == "3.0"
    shutil.copytree(tmp_path / "residuum", tmp_path / "copy" / "residuum")
    assert run(tmp_path / "copy") == ["3.0"]


def test_without_it_numba_goes_on_with_what_was_there_before(package):
    write, run = package
    write(2.0, 1.0, "plain", "cache=True")
    assert run()[-1] == "3.0"
    write(5.0, 7.0, "plain", "cache=True")
    assert run()[-1] == "3.0", (
        "Numba's own cache has become as careful: residuum/kept_loops.py can go"
    )


def test_every_loop_of_ours_is_kept_so():
    files = [
        file
        for file in Path(residuum.__file__).parent.rglob("*.py")
        if file.name != "kept_loops.py"
    ]
    careless = [str(file) for file in files if "cache=True" in file.read_text(encoding="utf-8")]
    assert careless == []
