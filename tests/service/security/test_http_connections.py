"""Connections that ask for nothing, and too many of them."""

import asyncio
import contextlib
import socket
import threading
import time

import pytest
import uvicorn

from residuum.service.security import http_connections
from residuum.service.security.http_connections import BoundedConnection

ASK = b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n"


async def slow_app(scope, receive, send):
    """Answers after longer than a head may take."""
    await asyncio.sleep(0.6)
    await send({"type": "http.response.start", "status": 200, "headers": [(b"content-length", b"2")]})
    await send({"type": "http.response.body", "body": b"ok"})


@pytest.fixture
def connect(monkeypatch):
    monkeypatch.setattr(http_connections, "ASK_WITHIN", 0.3)
    listening = socket.create_server(("127.0.0.1", 0))
    server = uvicorn.Server(uvicorn.Config(slow_app, http=BoundedConnection, lifespan="off", log_config=None))
    thread = threading.Thread(target=server.run, args=([listening],))
    thread.start()
    with contextlib.ExitStack() as opened:
        yield lambda: opened.enter_context(socket.create_connection(listening.getsockname(), timeout=20))
    server.should_exit = True
    thread.join(20)


def said(connection):
    """What comes until the other side has closed."""
    with contextlib.suppress(ConnectionError):
        return b"".join(iter(lambda: connection.recv(65536), b""))
    return b""


def test_a_head_that_does_not_come_to_its_end_is_not_waited_for(connect):
    slow, silent = connect(), connect()
    with contextlib.suppress(ConnectionError):
        for byte in ASK[:-1]:
            slow.sendall(bytes([byte]))
            time.sleep(0.05)
    assert said(slow) == said(silent) == b""  # who is not closed by the other side waits in vain, and fails


def test_a_request_under_way_may_take_its_time_and_the_next_one_too(connect):
    connection = connect()
    for _ in range(2):
        connection.sendall(ASK)
        answer = b""
        while not answer.endswith(b"ok"):  # its head and its body may come one after the other
            part = connection.recv(65536)
            assert part
            answer += part
        assert answer.startswith(b"HTTP/1.1 200")


def test_a_body_that_nobody_reads_does_not_hold_the_connection(connect):
    connection = connect()
    connection.sendall(b"POST / HTTP/1.1\r\nHost: localhost\r\nContent-Length: 1000\r\n\r\n")
    assert connection.recv(65536).startswith(b"HTTP/1.1 200")
    with pytest.raises(ConnectionError):
        for _ in range(60):
            connection.sendall(b"x")
            time.sleep(0.05)


def test_more_connections_than_may_be_are_closed_at_once(connect, monkeypatch):
    monkeypatch.setattr(http_connections, "most_connections", lambda: 2)
    monkeypatch.setattr(http_connections, "ASK_WITHIN", 60.0)
    first, second = connect(), connect()
    first.sendall(ASK)
    assert first.recv(65536).startswith(b"HTTP/1.1 200")
    assert said(connect()) == b""
    second.sendall(ASK)
    assert second.recv(65536).startswith(b"HTTP/1.1 200")
