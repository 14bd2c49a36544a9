"""The service stops at once, whoever listens, and does not begin without its database."""

import json
import signal
import subprocess
import sys
import time
import urllib.request

from residuum.service.cli import run


def test_an_open_stream_of_events_does_not_hold_the_service_up(tmp_path):
    command = [
        sys.executable,
        "-c",
        "from residuum.service.cli import main; main()",
        "serve",
        "--port",
        "0",
    ]
    with subprocess.Popen(
        [*command, "--data", str(tmp_path)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as service:
        address = service.stdout.readline().split()[-1]
        with urllib.request.urlopen(f"{address}api/v1/events", timeout=60) as stream:
            assert stream.readline() == b": connected\n"
            service.send_signal(signal.SIGTERM)
            stream.read()  # its end is that of an answer; a stream that is cut off when the service's patience ends has none
        assert "Traceback" not in service.communicate(timeout=60)[1]


def test_a_database_that_does_not_answer_is_told_in_one_line(tmp_path, capsys):
    nobody = "postgresql+psycopg://plant:secret@127.0.0.1:1/plant"
    (tmp_path / "text.db").write_text(
        "no database, but so long that SQLite looks at its first hundred bytes: " + "-" * 200
    )
    for url in (nobody, f"sqlite:///{tmp_path}/text.db"):
        assert run(["serve", "--port", "0", "--data", str(tmp_path), "--database", url]) == 2
        says = capsys.readouterr().err
        assert (
            says.startswith("residuum: setting database: ")
            and says.count("\n") == 1
            and "secret" not in says
        )


def test_what_explanations_need_is_compiled_behind_the_running_service(tmp_path, monkeypatch):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "loops"))
    command = [
        sys.executable,
        "-c",
        "from residuum.service.cli import main; main()",
        "serve",
        "--port",
        "0",
    ]
    with subprocess.Popen(
        [*command, "--data", str(tmp_path / "data")],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as service:
        address = service.stdout.readline().split()[-1]
        with urllib.request.urlopen(f"{address}api/v1/status", timeout=60) as answer:
            assert json.load(answer)["compiled"] is False  # it answers meanwhile
        said = next(line for line in service.stderr if "compiling behind" in line)
        assert "first explanation" in said
        end = time.monotonic() + 600
        while not list((tmp_path / "loops").rglob("ahead_*.lock")):
            assert time.monotonic() < end, "nobody began to compile"
            time.sleep(0.1)
        service.send_signal(signal.SIGTERM)  # and is not held up by it
        assert "Traceback" not in service.communicate(timeout=60)[1]
