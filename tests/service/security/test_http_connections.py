"""Connections that do not move on, and strangers who take all places."""

import asyncio
import contextlib
import select
import socket
import ssl
import threading
import time
from functools import partial

import pytest
import uvicorn

from benchmarks.certificates import certificate_and_key
from benchmarks.slow_connections import KINDS, campaign
from residuum.service.security import http_connections
from residuum.service.security.forwarded import TrustedProxies
from residuum.service.security.http_connections import KNOWN, BoundedConnection, Places

ASK = b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n"
WITH_KEY = b"GET /known HTTP/1.1\r\nHost: localhost\r\n\r\n"
LARGE = b"GET /large HTTP/1.1\r\nHost: localhost\r\n\r\n"
LENGTH = 2**25


async def slow_app(scope, receive, send):
    """Answers after longer than a head may take; at once to who has a key, or wants what is large."""
    headers = [(b"content-length", b"%d" % (LENGTH if scope["path"] == "/large" else 2))]
    if scope["path"] == "/known":
        scope[KNOWN]()
    elif scope["path"] == "/read":
        while (await receive()).get("more_body"):
            pass
    elif scope["path"] == "/":
        await asyncio.sleep(0.6)
    await send({"type": "http.response.start", "status": 200, "headers": headers})
    for _ in range(LENGTH // 2**16 if scope["path"] == "/large" else 0):
        await send({"type": "http.response.body", "body": bytes(2**16), "more_body": True})
    await send({"type": "http.response.body", "body": b"" if scope["path"] == "/large" else b"ok"})


@pytest.fixture
def begin(monkeypatch):
    """Begins a server with so many places; gives what connects to it, from an address of this machine."""
    monkeypatch.setattr(http_connections, "MOVES_WITHIN", 0.3)
    monkeypatch.setattr(http_connections, "HANDSHAKE_WITHIN", 0.3)
    with contextlib.ExitStack() as opened:

        def run(most=1000, per_address=1000, proxies=(), tls=None):
            listening = socket.create_server(("127.0.0.1", 0))
            http = partial(
                BoundedConnection, Places(most, per_address, TrustedProxies(proxies)), tls
            )
            server = uvicorn.Server(
                uvicorn.Config(
                    slow_app, http=http, lifespan="off", log_config=None, timeout_keep_alive=60
                )
            )
            thread = threading.Thread(target=server.run, args=([listening],))
            thread.start()
            opened.callback(thread.join, 20)
            opened.callback(setattr, server, "should_exit", True)
            where = listening.getsockname()
            return lambda address="127.0.0.1": opened.enter_context(
                socket.create_connection(where, timeout=60, source_address=(address, 0))
            )

        yield run


@pytest.fixture
def connect(begin):
    return begin()


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
    # who is not closed by the other side waits in vain, and fails
    assert said(slow) == said(silent) == b""


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


def answered(connection, ask=WITH_KEY):
    connection.sendall(ask)
    answer = b""
    while part := connection.recv(65536):
        answer += part
        if answer.endswith(b"ok"):
            break
    return answer.startswith(b"HTTP/1.1 200")


def closed(connection):
    """Once the other side has given it up, though nothing that came was read."""
    poll = select.poll()
    poll.register(connection, select.POLLERR | select.POLLHUP)
    return bool(poll.poll(60_000))


def test_a_body_that_comes_too_slowly_is_not_waited_for(connect):
    connection = connect()
    connection.sendall(b"POST /read HTTP/1.1\r\nHost: localhost\r\nContent-Length: 1000\r\n\r\n")
    with pytest.raises(ConnectionError):
        for _ in range(900):
            connection.sendall(b"x")
            time.sleep(0.02)


def test_a_body_that_comes_fast_enough_may_take_its_time(connect, monkeypatch):
    monkeypatch.setattr(http_connections, "MOVES_WITHIN", 1.0)
    connection = connect()
    connection.sendall(b"POST /read HTTP/1.1\r\nHost: localhost\r\nContent-Length: 40000\r\n\r\n")
    for _ in range(40):
        connection.sendall(b"x" * 1000)
        time.sleep(0.05)
    assert connection.recv(65536).startswith(b"HTTP/1.1 200")


def test_an_answer_that_nobody_takes_is_not_kept(connect):
    connection = connect()
    connection.sendall(LARGE)
    assert closed(connection)


def test_an_answer_that_is_taken_slowly_comes_to_its_end(connect, monkeypatch):
    monkeypatch.setattr(http_connections, "MOVES_WITHIN", 1.0)
    connection = connect()
    connection.sendall(LARGE)
    taken = 0
    while taken < LENGTH:
        taken += len(part := connection.recv(2**20))
        assert part
        time.sleep(0.05)


def test_a_handshake_that_stops_is_not_waited_for_and_others_are_answered(begin, tmp_path):
    certificate, key = certificate_and_key(tmp_path)
    tls = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    tls.load_cert_chain(certificate, key)
    connect = begin(tls=tls)
    silent, halfway, nonsense = connect(), connect(), connect()
    halfway.sendall(b"\x16\x03\x01\x02\x00\x01")
    nonsense.sendall(ASK)
    trusted = ssl.create_default_context(cafile=certificate)
    with trusted.wrap_socket(connect(), server_hostname="localhost") as safe:
        assert answered(safe) and answered(safe, ASK)
    with trusted.wrap_socket(connect(), server_hostname="localhost") as safe:
        safe.sendall(LARGE)
        taken = 0
        while taken < LENGTH:
            taken += len(part := safe.recv(2**20))
            assert part
    with trusted.wrap_socket(connect(), server_hostname="localhost") as safe:
        safe.sendall(LARGE)
        assert closed(safe)
    assert said(silent) == said(halfway) == b"" and ASK not in said(nonsense)


def test_strangers_take_places_of_strangers_only(begin, monkeypatch):
    monkeypatch.setattr(http_connections, "MOVES_WITHIN", 60.0)
    connect = begin(most=8)
    known = [connect() for _ in range(4)]
    for each in known:
        assert answered(each)
    strangers = [connect() for _ in range(12)]
    for gone in strangers[:8]:
        assert said(gone) == b""  # in the order in which they came
    assert all(answered(each) for each in known)
    assert answered(connect())  # whoever shows a key finds a place
    assert said(strangers[8]) == b""
    assert all(answered(each) for each in strangers[9:])


def test_where_a_key_was_shown_newcomers_have_time_to_show_it(begin, monkeypatch):
    monkeypatch.setattr(http_connections, "MOVES_WITHIN", 60.0)
    connect = begin(most=8)
    assert answered(connect("127.0.0.2"))
    newcomer, strangers = connect("127.0.0.2"), [connect("127.0.0.3") for _ in range(12)]
    for gone in strangers[:9]:
        assert said(gone) == b""
    assert all(answered(each) for each in (newcomer, *strangers[9:]))


def test_an_address_has_so_many_strangers_and_others_keep_theirs(begin, monkeypatch):
    monkeypatch.setattr(http_connections, "MOVES_WITHIN", 60.0)
    connect = begin(per_address=2)
    operator, other = connect("127.0.0.2"), connect("127.0.0.3")
    assert answered(operator)
    many = [connect("127.0.0.2") for _ in range(5)]
    for gone in many[:3]:
        assert said(gone) == b""
    assert all(answered(each) for each in (operator, other, *many[3:]))


def test_a_trusted_proxy_stands_for_many(begin, monkeypatch):
    monkeypatch.setattr(http_connections, "MOVES_WITHIN", 60.0)
    connect = begin(per_address=2, proxies=["127.0.0.4"])
    assert all(answered(each) for each in [connect("127.0.0.4") for _ in range(5)])


def test_nobody_is_counted_twice_or_for_ever():
    places, closed = Places(4, 4, TrustedProxies([])), []

    class Connection:
        def give_up(self):
            closed.append(self)
            places.leave(self)

    for _ in range(50):
        first, second = Connection(), Connection()
        places.take(first, "2001:db8::1")
        places.take(second, "192.0.2.1")
        places.know(first)
        places.know(first)
        places.leave(second)
        places.leave(first)
    assert not closed and not places._of_address and not places._strangers and not places._count
    assert list(places._acquainted) == ["2001:db8::/64"]


def test_source_and_operator_notice_nothing_of_strangers():
    found = campaign(2.0, connections=150)  # more than there are places
    assert found["windows"] and not (found["lost"] or found["twice"] or found["other than 200"])
    assert set(found["sent away"]) == set(KINDS)
