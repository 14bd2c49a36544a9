"""Under `log_format: json` every line of the service is JSON, also those of the HTTP server, and tells its request's id."""

import json
import os
import signal
import socket
import subprocess
import sys

import httpx

COMMAND = [sys.executable, "-c", "from residuum.service.cli import main; main()", "serve"]


def test_every_line_is_json_with_the_id_of_its_request(tmp_path, free_port):
    port = free_port()
    chosen = {"RESIDUUM_LOG_FORMAT": "json", "RESIDUUM_LOG_LEVEL": "debug"}
    with subprocess.Popen(
        [*COMMAND, "--port", str(port), "--data", str(tmp_path)],
        env=os.environ | chosen,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        assert "Residuum is at" in process.stdout.readline()
        httpx.get(
            f"http://127.0.0.1:{port}/api/v1/assets", headers={"X-Request-ID": "first"}, timeout=60
        )
        with socket.create_connection(("127.0.0.1", port), timeout=60) as connection:
            connection.sendall(b"no HTTP at all\r\n\r\n")
            assert connection.recv(1000).startswith(b"HTTP/1.1 400")
        process.send_signal(signal.SIGTERM)
        lines = [json.loads(line) for line in process.communicate(timeout=120)[1].splitlines()]
    assert {"event", "level", "timestamp"} <= set.intersection(*(set(line) for line in lines))
    (asked,) = [
        line for line in lines if line["event"] == "request" and line["path"] == "/api/v1/assets"
    ]
    assert asked["request_id"] == "first" and asked["status"] == 200
    assert [line["logger"] for line in lines if line["level"] == "warning"] == ["uvicorn.error"]
