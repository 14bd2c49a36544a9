"""The service stops at once, whoever listens."""

import signal
import subprocess
import sys
import time
import urllib.request


def test_an_open_stream_of_events_does_not_hold_the_service_up(tmp_path):
    command = [sys.executable, "-c", "from residuum.service.cli import main; main()", "serve", "--port", "0"]
    with subprocess.Popen(
        [*command, "--data", str(tmp_path)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as service:
        address = service.stdout.readline().split()[-1]
        with urllib.request.urlopen(f"{address}api/v1/events", timeout=60) as stream:
            assert stream.readline() == b": connected\n"
            service.send_signal(signal.SIGTERM)
            begun = time.monotonic()
            stream.read()
            assert time.monotonic() - begun < 4
        assert "Traceback" not in service.communicate(timeout=60)[1]
