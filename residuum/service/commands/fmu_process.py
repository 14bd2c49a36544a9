"""Commands on a model that is an FMU run in a process of their own: a foreign library may end it,
and nothing else.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys

from residuum.identification.errors import BadModel
from residuum.identification.physics.fmu.parameter_file import named
from residuum.library.model import Model, model
from residuum.service.cli import names_fmu

INSIDE = "RESIDUUM_FMU_PROCESS"
"""Set in the process that may load an FMU."""
# The commands that take an FMU for their model, and so would load its library.
_COMMANDS = ("compare", "explain", "improve", "estimate", "train", "score")


def is_wanted(command: str) -> bool:
    """Whether this command, here, has to be handed to a process of its own."""
    return command in _COMMANDS and not is_inside()


def is_inside() -> bool:
    """Whether this is that process."""
    return INSIDE in os.environ


def run_apart(arguments: list[str], fmu: str) -> int:
    """Exit status of the command in a process of its own; `fmu` is what names or holds the FMU.

    Raises
    ------
    BadModel
        The FMU cannot run on this platform (said before anything of it is loaded), or it ended the
        process.
    """
    # Refused here where it cannot run on this platform: nothing of it is loaded for that.
    if names_fmu(fmu):
        named(fmu)
    # Its standard error is ours: progress is seen as it comes, and what a crashing library says,
    # too.
    done = subprocess.run(
        [sys.executable, "-m", "residuum", *arguments],
        env=os.environ | {INSIDE: "1"},
        stdout=subprocess.PIPE,
        check=False,
    )
    sys.stdout.write(done.stdout.decode("utf-8", "replace"))
    # A negative status is the signal that ended the process.
    if done.returncode < 0:
        how = signal.Signals(-done.returncode).name
        what = "model" if names_fmu(fmu) else "baseline"
        raise BadModel(
            f"{what} {fmu!r}: the FMU ended the process that ran it ({how}); nothing else was harmed"
        )
    return done.returncode


def model_for(name: str) -> Model:
    """The model of a command; in this process that of an FMU, too."""
    if is_inside() and names_fmu(name):
        # loads what compiles, for FMUs alone
        from residuum.library.fmu import fmu  # noqa: PLC0415

        return fmu(name)
    return model(name)
