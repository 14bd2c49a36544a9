"""What a command imports before it begins: a library that it seldom needs must not cost its seconds every time."""

import subprocess
import sys

import pytest

HEAVY = (
    "sympy",
    "pint",
    "scipy.stats",
    "scipy.signal",
    "scipy.io",
    "sklearn",
    "fastapi",
    "pyarrow",
    "h5py",
)


@pytest.mark.parametrize("command", ["compare", "explain", "improve", "estimate"])
def test_a_command_on_a_model_begins_without_what_it_seldom_needs(command):
    script = f"import sys, residuum.service.commands.{command}; print([name for name in {HEAVY!r} if name in sys.modules])"
    found = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    assert found.stdout.strip() == "[]"


def test_the_catalogue_is_listed_without_compiler_solver_or_registry():
    script = (
        "import sys; from residuum.service.cli import run; run(['effects', 'gate-drive']); run(['effects']);"
        "print([name for name in ('sympy', 'numba', 'scipy', 'pint', 'sklearn', 'fastapi', 'pandas') if name in sys.modules])"
    )
    found = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    assert found.stdout.splitlines()[-1] == "[]" and "coulomb-friction" in found.stdout


def test_the_service_starts_without_what_only_its_workers_need():
    """Who reads a stored estimator imports skops, and with it all of scikit-learn: a third of the service's start."""
    script = "import sys, residuum.service.app; print('skops' in sys.modules)"
    found = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    assert found.stdout.strip() == "False"
