"""The console command `residuum`: one file a command in `commands/`, loaded when it is called."""

import os
import re
import signal
import sys
import traceback
from importlib import import_module
from importlib.metadata import version
from pathlib import Path
from typing import Any

import typer

from residuum.identification.errors import SAID_IN, BadInput
from residuum.identification.physics.fmu.permission import holds_fmu
from residuum.nearest_names import known_names
from residuum.service.commands import COMMANDS, FORMER, as_option
from residuum.service.entry import end_at_once
from residuum.service.work.loaded_modules import loading_modules

# A "no" is told from a mistake, and a mistake from a fault of ours, so that scripts can tell them;
# 130 is 128 + SIGINT, as shells have it.
DONE, ANSWER_IS_NO, BAD_INPUT, OUR_FAULT, INTERRUPTED = 0, 1, 2, 3, 130

# Bytes of a model file that are looked at for the FMU that it names. A key of the file's first
# level; parsing the whole YAML would cost each command its time.
_HEAD = 10_000
# The base of typer's usage errors, which typer itself does not export by name.
_UsageError: type[Exception] = typer.BadParameter.__mro__[2]


def run(arguments: list[str]) -> int:
    """Run one command and return its exit status (0 done, 1 answer is no, 2 bad input, 3 internal
    error, 130 interrupted).
    """
    if not arguments or arguments[0] in ("--help", "-h", "help"):
        sys.stdout.write(_overview())
        return DONE if arguments else BAD_INPUT
    if arguments[0] == "--version":
        sys.stdout.write(f"residuum {version('residuum')}\n")
        return DONE
    name, *words = arguments
    if name in FORMER:
        return _refuse(f"command {name!r}: is no more; {FORMER[name]}")
    if name not in COMMANDS:
        return _refuse(
            f"command {name!r}: there is none of this name; {known_names(name, COMMANDS)}"
        )
    return _exit_status(name, words)


def _exit_status(name: str, words: list[str]) -> int:
    """Run a command by its words; whatever ends it, one line says why."""
    words_before = SAID_IN.set(as_option)
    try:
        return _run_command(name, words)
    except typer.Exit as done:
        return done.exit_code
    except _UsageError as error:
        return _refuse(f"{name}: {_usage(error)}")
    except BadInput as error:
        return _refuse(str(error))
    except (typer.Abort, KeyboardInterrupt):
        _refuse("interrupted")
        return INTERRUPTED
    except BrokenPipeError:
        # the reader left; nothing more can be printed
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return DONE
    except Exception as error:
        traceback.print_exc()
        sys.stderr.write(f"residuum: internal error: {type(error).__name__}: {error}\n")
        return OUR_FAULT
    finally:
        SAID_IN.reset(words_before)


def _run_command(name: str, words: list[str]) -> int:
    # an FMU is machine code of somebody else's: what it does to its process, it does to that alone
    # `--model=drive.fmu` is one word
    values = [word.partition("=")[2] if word.startswith("--") else word for word in words]
    fmus = [
        value
        for value in values
        # only `score` reads baselines; a word that is a pipe is not looked into
        if names_fmu(value) or (name == "score" and Path(value).is_file() and holds_fmu(value))
    ]
    if fmus:
        apart = import_module("residuum.service.commands.fmu_process")
        if apart.is_wanted(name):
            return int(apart.run_apart([name, *words], fmus[0]))
    with loading_modules():
        command = import_module(f"residuum.service.commands.{COMMANDS[name][0]}").app
    _take_interrupts()
    status = command(args=words, prog_name=f"residuum {name}", standalone_mode=False)
    return status if isinstance(status, int) else DONE


def names_fmu(word: str) -> bool:
    """Whether a word of a command is an FMU, or a model file that names one."""
    path = Path(word)
    if path.suffix.lower() == ".fmu":
        return True
    if path.suffix.lower() not in (".yaml", ".yml"):
        return False
    try:
        with path.open("rb") as file:
            return re.search(rb"^fmu\s*:", file.read(_HEAD), re.MULTILINE) is not None
    except OSError:
        return False  # who reads it refuses it


def _overview() -> str:
    width = max(map(len, COMMANDS))
    lines = [f"  {name:<{width}}  {says}" for name, (_, says) in COMMANDS.items()]
    return "\n".join(["usage: residuum COMMAND [--help]", "", *lines, ""])


def _usage(error: Any) -> str:
    """What is wrong with a command's words: typer's own sentence, but for a name, which is refused
    as all names are.
    """
    says = str(getattr(error, "format_message", error.__str__)())
    command: Any = getattr(getattr(error, "ctx", None), "command", None)
    if option := getattr(error, "option_name", None):
        options = [
            flag
            for parameter in command.params
            for flag in (*parameter.opts, *parameter.secondary_opts)
        ]
        return (
            f"there is no option {option};"
            f" {known_names(option, [flag for flag in options if flag.startswith('-')])}"
        )
    if unknown := re.match(r"No such command '([^']*)'", says):
        return f"there is no command {unknown[1]!r}; {known_names(unknown[1], command.commands)}"
    # typer knows choices only as part of its sentence
    if choice := re.match(r"Invalid value for '([^']*)': .*?'([^']*)' is not one of (.*)", says):
        known = known_names(choice[2], re.findall(r"'([^']*)'", choice[3]), "must be one of")
        return f"{choice[1]} {choice[2]!r}: {known}"
    return says


def _refuse(message: str) -> int:
    sys.stderr.write(f"residuum: {' '.join(message.split())}\n")
    return BAD_INPUT


def _take_interrupts() -> None:
    """Ctrl-C from now on as an exception; while modules were loaded it ended the process
    (`residuum.service.entry`).
    """
    if signal.getsignal(signal.SIGINT) is end_at_once:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def main() -> None:
    """Entry point of the console command."""
    sys.exit(run(sys.argv[1:]))
