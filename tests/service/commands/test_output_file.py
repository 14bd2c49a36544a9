from pathlib import Path

import pytest

from residuum.service.cli import BAD_INPUT, run

COMMANDS = {
    "improve": ["improve", "oven", "absent.csv", "--auto"],
    "estimate": ["estimate", "oven", "absent.csv"],
    "simulate": ["simulate", "gate-drive"],
    "train": ["train", "bearing", "absent.csv"],
    "identify": ["identify", "absent.csv", "--input", "u", "--output", "y"],
}


@pytest.mark.parametrize("command", COMMANDS)
def test_a_file_in_no_folder_is_refused_before_any_work(command, tmp_path, capsys):
    assert run([*COMMANDS[command], "--out", str(tmp_path / "nowhere" / "made")]) == BAD_INPUT
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.count("\n") == 1
    assert "nowhere' does not exist" in captured.err


@pytest.mark.parametrize("command", COMMANDS)
def test_a_folder_is_no_file_to_write(command, tmp_path: Path, capsys):
    assert run([*COMMANDS[command], "--out", str(tmp_path)]) == BAD_INPUT
    assert "is a folder" in capsys.readouterr().err
