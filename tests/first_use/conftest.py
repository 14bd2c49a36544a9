"""What a new user does: the wheel in an empty environment, and the demo started from an empty folder with an empty home."""

import fcntl
import json
import os
import shutil
import signal
import subprocess
import sys
import time
import urllib.request
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
NOT_SHIPPED = (
    ".git",
    ".venv",
    "build",
    "*.egg-info",
    "__pycache__",
    ".*_cache",
    "tests",
    "benchmarks",
    "reproduction",
    "site",
)
PATIENCE = 900.0
"""Seconds until a condition is given up; only a broken program or a very busy machine ever waits for so long."""


@pytest.fixture(scope="session")
def residuum(tmp_path_factory):
    """The command `residuum` of an empty environment into which this checkout's wheel was installed, and nothing else."""
    given = os.environ.get("RESIDUUM_FIRST_USE")
    folder = Path(given) if given else tmp_path_factory.mktemp("first-use")
    with (folder / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not (folder / "installed").exists():
            _install(folder)
            (folder / "installed").touch()
    return folder / "environment" / "bin" / "residuum"


def _install(folder):
    shutil.copytree(
        ROOT, folder / "source", ignore=shutil.ignore_patterns(*NOT_SHIPPED), symlinks=True
    )
    python = folder / "environment" / "bin" / "python"
    _run(
        folder, sys.executable, "-m", "pip", "wheel", "-q", "--no-deps", "-w", "wheels", "./source"
    )
    _run(folder, sys.executable, "-m", "venv", "environment")
    _run(folder, python, "-m", "pip", "install", "-q", *(folder / "wheels").glob("*.whl"))
    shutil.rmtree(folder / "source")


def _run(folder, *command):
    # pip would take a checkout there for it
    alone = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    done = subprocess.run(
        [str(part) for part in command],
        cwd=folder,
        env=alone,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr


class Demo:
    """`residuum serve --demo` as a process of an installed program: no checkout, an empty home, nothing compiled."""

    def __init__(self, residuum, folder):
        self._residuum, self._folder = residuum, folder
        self._environment = {
            "HOME": str(folder),
            "PATH": f"{residuum.parent}:/usr/bin:/bin",
            "LANG": "C.UTF-8",
        }
        self._log = folder / "demo.log"
        self._process = None
        self.address = ""

    def start(self):
        """Start it and read its address from what it prints."""
        command = [str(self._residuum), "serve", "--demo", "--port", "0", "--data", "data"]
        with self._log.open("ab") as log:
            self._process = subprocess.Popen(
                command,
                cwd=self._folder,
                env=self._environment,
                stdout=subprocess.PIPE,
                stderr=log,
                text=True,
                start_new_session=True,
            )
        self.address = self._process.stdout.readline().split()[-1].rstrip("/")
        return self

    def command(self, *arguments):
        """Run another command of the same program, as from another shell."""
        command = [str(self._residuum), *arguments, "--url", self.address]
        subprocess.run(
            command,
            cwd=self._folder,
            env=self._environment,
            capture_output=True,
            text=True,
            check=True,
        )

    def ask(self, path):
        """What the service answers."""
        with urllib.request.urlopen(f"{self.address}/api/v1{path}", timeout=60) as answer:
            return json.load(answer)

    def state(self, machine):
        """What the page says of a machine: training, running, failed …, and why."""
        return self.ask("/status")["machines"][machine]

    def verdict(self, machine):
        """Verdict of a machine's last finding, None before the first."""
        return (self.ask(f"/assets/{machine}")["last_finding"] or {}).get("verdict")

    def alarms(self, machine):
        """States of a machine's alarms."""
        return {alarm["state"] for alarm in self.ask(f"/alarms?asset={machine}")["items"]}

    def wait(self, what, condition):
        """Return when a condition holds; fails when the program ended, a machine failed, or the patience is over."""
        end = time.monotonic() + PATIENCE
        while not condition():
            assert self._process.poll() is None, f"{what}: the service ended\n{self.log()}"
            broken = {
                name: told["doing"]
                for name, told in self.ask("/status")["machines"].items()
                if told["state"] == "failed"
            }
            assert not broken, f"{what}: {broken}\n{self.log()}"
            assert time.monotonic() < end, f"{what}: not within {PATIENCE:g} s\n{self.log()}"
            time.sleep(0.5)

    def log(self):
        """The end of what it logged."""
        return self._log.read_text(encoding="utf-8")[-4000:]

    def interrupt(self):
        """Press Ctrl-C: every process in the terminal's foreground is told. Gives the exit status."""
        os.killpg(self._process.pid, signal.SIGINT)
        status = self._process.wait(PATIENCE)
        self._process.stdout.close()
        return status

    def wait_until_nothing_runs(self):
        """Return when no process of its session is left: they see their parent's end, each in its own time."""
        end = time.monotonic() + PATIENCE
        while left := self._left_running():
            assert time.monotonic() < end, f"left running: {left}"
            time.sleep(0.1)

    def _left_running(self):
        command = ["ps", "-o", "pid=,args=", "-s", str(self._process.pid)]
        return subprocess.run(command, capture_output=True, text=True, check=False).stdout.split(
            "\n"
        )[:-1]

    def end(self):
        """End all of it, however a test ended."""
        if self._process is not None and self._process.poll() is None:
            os.killpg(self._process.pid, signal.SIGKILL)
            self._process.wait()
            self._process.stdout.close()


@pytest.fixture
def demo(residuum, tmp_path):
    """A demo that was not started yet."""
    made = Demo(residuum, tmp_path)
    yield made
    made.end()
