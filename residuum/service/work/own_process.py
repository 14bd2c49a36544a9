"""Work that may end its process, in one of its own: code of a stranger's is called there, and nothing
else is lost with it.

The process is this module run as a program; work and answers travel through a socket of its own,
so that what the code prints is none of them.
"""

from __future__ import annotations

import os
import resource
import select
import signal
import socket
import subprocess
import sys
import threading
import weakref
from collections.abc import Callable
from contextlib import suppress
from multiprocessing.connection import Connection
from typing import Any, TypeVar

from residuum.identification.errors import BadInput
from residuum.identification.physics.fmu.permission import fmus_allowed

T = TypeVar("T")
_MOST_SECONDS = 600
"""[s] Of processor time for one piece of work: code that never returns would hold whoever waits."""
_STANDARD_ERROR = 2
_DONE, _REFUSED, _FAILED = "done", "refused", "failed"


class ProcessEnded(Exception):
    """The process of a piece of work ended before it was done; the message says how."""


class OwnProcess:
    """A process that does one piece of work after the other. It is begun when it is first asked,
    and anew after it has ended; it ends with this one.

    Parameters
    ----------
    seconds : int
        Of processor time for one piece of work.
    """

    def __init__(self, seconds: int = _MOST_SECONDS) -> None:
        self._seconds = seconds
        self._lock = threading.Lock()
        self._process: subprocess.Popen[bytes] | None = None
        self._channel: Connection[Any, Any] | None = None

    def call(self, work: Callable[..., T], *arguments: Any) -> T:
        """What a function of a module gives for arguments, which travel there.

        Raises
        ------
        ProcessEnded
            It ended the process.
        BadInput
            The work refused its arguments.
        """
        with self._lock:
            channel = self._channel or self._begun()
            try:
                channel.send((work, arguments))
                kind, answer = channel.recv()
            except (EOFError, OSError):
                raise ProcessEnded(self._ended()) from None
        if kind == _REFUSED:
            raise BadInput(**answer)
        if kind == _FAILED:
            raise RuntimeError(answer)
        done: T = answer
        return done

    def _begun(self) -> Connection[Any, Any]:
        ours, theirs = socket.socketpair()
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", __name__, str(theirs.fileno()), str(self._seconds)],
            pass_fds=[theirs.fileno()],
            stdin=subprocess.DEVNULL,
            stdout=_STANDARD_ERROR,  # what a library prints is no answer of ours
        )
        theirs.close()
        self._channel = Connection(ours.detach())
        # its end of the channel tells it to go; then it is waited for
        weakref.finalize(self, _end, self._process, self._channel)
        return self._channel

    def _ended(self) -> str:
        assert self._process is not None
        assert self._channel is not None
        self._channel.close()
        self._channel = None
        status = self._process.wait()
        if status == -signal.SIGXCPU:
            return f"it took more than {self._seconds} s of processor time"
        return signal.Signals(-status).name if status < 0 else f"exit status {status}"


def _end(process: subprocess.Popen[bytes], channel: Connection[Any, Any]) -> None:
    channel.close()
    process.kill()
    process.wait()


def main(number: int, seconds: int) -> None:
    """Do what comes through the channel with this number, until its other end is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the service decides when it ends
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    threading.Thread(target=_end_with_the_other, args=(number,), daemon=True).start()
    channel: Connection[Any, Any] = Connection(number)
    with fmus_allowed(), suppress(EOFError, OSError):
        while True:
            work, arguments = channel.recv()
            _limit_time(seconds)
            channel.send(_answer(work, arguments))


def _end_with_the_other(number: int) -> None:
    """End in the middle of work whose answer nobody waits for any more: who asked was ended."""
    closed = select.poll()
    closed.register(number, 0)  # a closed end is told whatever is asked for
    closed.poll()
    os._exit(1)


def _answer(work: Callable[..., Any], arguments: tuple[Any, ...]) -> tuple[str, Any]:
    try:
        return _DONE, work(*arguments)
    except BadInput as error:
        return _REFUSED, error.parts
    except Exception as error:
        return _FAILED, f"{type(error).__name__}: {error}"


def _limit_time(seconds: int) -> None:
    """So much processor time more than was used by now."""
    used = resource.getrusage(resource.RUSAGE_SELF)
    most = int(used.ru_utime + used.ru_stime) + seconds
    resource.setrlimit(resource.RLIMIT_CPU, (most, resource.RLIM_INFINITY))


if __name__ == "__main__":
    os.set_inheritable(int(sys.argv[1]), False)
    main(*map(int, sys.argv[1:]))
