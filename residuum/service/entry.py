"""The console command `residuum`, before any of its modules is loaded.

Modules take up to a second to load. Ctrl-C meanwhile ends the process at once, with one line: an
exception in the middle of an import would be told with a traceback, or be taken for a module that
cannot be loaded.
"""

import os
import signal
from importlib import import_module
from types import FrameType


def end_at_once(_number: int, _frame: FrameType | None) -> None:
    """End as an interrupted command does."""
    os.write(2, b"residuum: interrupted\n")
    os._exit(130)


def main() -> None:
    """Entry point of the console command."""
    signal.signal(signal.SIGINT, end_at_once)
    import_module("residuum.service.cli").main()
