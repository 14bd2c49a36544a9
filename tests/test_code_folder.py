"""Compiled code lies where nobody but its user can put any."""

import os
import stat
import subprocess
import sys
from pathlib import Path

import pytest

from residuum.code_folder import code_folder, why_not_kept

OTHER = 65534
NEEDS_ROOT = pytest.mark.skipif(
    os.getuid() != 0, reason="only root can give a folder to somebody else"
)


@pytest.fixture
def chosen(tmp_path, monkeypatch):
    monkeypatch.setenv("OUR_CODE", str(tmp_path / "code"))
    return tmp_path / "code"


def refused(says):
    with pytest.warns(RuntimeWarning, match=says):
        folder = code_folder("kernels", "OUR_CODE")
    assert why_not_kept("kernels", "OUR_CODE") is not None
    return folder


def test_a_folder_is_closed_to_others_even_when_it_was_open(chosen):
    (chosen / "kernels").mkdir(parents=True)
    (chosen / "kernels").chmod(0o777)
    assert (
        code_folder("kernels", "OUR_CODE") == chosen / "kernels"
        and why_not_kept("kernels", "OUR_CODE") is None
    )
    assert stat.S_IMODE((chosen / "kernels").stat().st_mode) == 0o700


def test_a_folder_is_kept_whatever_the_umask_is(tmp_path):
    made = "import os; os.umask(0o002); from residuum.code_folder import *; "
    asked = made + "print(why_not_kept('kernels', 'OUR_CODE'), code_folder('kernels', 'OUR_CODE'))"
    home = os.environ | {"HOME": str(tmp_path / "home")}
    said = subprocess.run(
        [sys.executable, "-W", "error", "-c", asked],
        capture_output=True,
        text=True,
        check=True,
        env=home,
    ).stdout
    folder = tmp_path / "home" / ".cache" / "residuum" / "kernels"
    assert said.split() == ["None", str(folder)]
    assert [stat.S_IMODE(each.stat().st_mode) for each in (folder, folder.parent)] == [0o700, 0o700]


def test_a_folder_that_others_may_exchange_is_not_used(chosen):
    chosen.mkdir()
    chosen.chmod(0o777)
    folder = refused("in which others may write; OUR_CODE names another")
    assert not folder.is_relative_to(chosen) and stat.S_IMODE(folder.stat().st_mode) == 0o700
    chosen.chmod(0o1777)  # sticky: nobody exchanges another's
    assert "others may write" in why_not_kept("kernels", "OUR_CODE")  # found out once a process


def test_a_link_is_not_followed(chosen, tmp_path):
    (tmp_path / "elsewhere").mkdir()
    chosen.mkdir()
    (chosen / "kernels").symlink_to(tmp_path / "elsewhere")
    assert not refused("belongs to another").is_relative_to(tmp_path)


@NEEDS_ROOT
@pytest.mark.parametrize("whose", ["code", "code/kernels"])
def test_a_folder_of_somebody_else_is_not_used(chosen, tmp_path, whose):
    (chosen / "kernels").mkdir(parents=True)
    os.chown(tmp_path / whose, OTHER, OTHER)
    assert not refused("another user").is_relative_to(tmp_path)


def test_what_cannot_be_kept_is_gone_with_its_process(chosen):
    chosen.mkdir()
    chosen.chmod(0o777)
    command = [
        sys.executable,
        "-W",
        "ignore",
        "-c",
        "from residuum.code_folder import *; print(code_folder('k', 'OUR_CODE'))",
    ]
    folder = subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()
    assert folder and not Path(folder).exists()
