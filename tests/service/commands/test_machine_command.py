"""`residuum machine` says in one line which bus it cannot have."""

import socket

import pytest

from residuum.service.cli import run


@pytest.mark.parametrize(
    ("channel", "says"),
    [
        ("udp_multicast:127.0.0.1:20000", "needs a route"),
        ("socketcan:no_such_can7", "cannot open"),
        ("no-bus", "interface:"),
    ],
)
def test_a_can_bus_that_cannot_be_opened(capsys, channel, says):
    assert run(["machine", "gate-actuator", "--can", channel]) == 2
    error = capsys.readouterr().err
    assert channel in error and says in error and error.count("\n") == 1


def test_a_port_that_is_taken(capsys):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        address = f"127.0.0.1:{taken.getsockname()[1]}"
        assert run(["machine", "process-plant", "--modbus", address]) == 2
    error = capsys.readouterr().err
    assert address in error and error.count("\n") == 1
