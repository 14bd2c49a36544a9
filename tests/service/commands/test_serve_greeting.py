"""What the demo says when it has started can be typed in another shell as it stands."""

import os
import sys
from pathlib import Path

from residuum.service.commands.serve import _greeting
from residuum.service.settings import Settings


def test_the_command_is_named_by_its_path_where_the_shell_does_not_find_it(monkeypatch, tmp_path):
    typed = "residuum fault process-plant sensor-offset --url http://127.0.0.1:8123"
    monkeypatch.setenv("PATH", str(tmp_path))
    assert f"  {Path(sys.prefix, 'bin')}{os.sep}{typed}\n" in _greeting(Settings(demo=True), 8123)
    (tmp_path / "residuum").touch(mode=0o755)
    assert f"  {typed}\n" in _greeting(Settings(demo=True), 8123)
