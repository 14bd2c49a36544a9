"""A TCP proxy that can fall silent, as a network that is partitioned: no connection is closed, and nothing comes through."""

from __future__ import annotations

import contextlib
import select
import socket
import threading
import time


class SilentProxy:
    """Carries bytes between whoever connects to `port` and a target, until it is told to be silent.

    Parameters
    ----------
    target : (str, int)
    keeps : bool
        Whether what is said in the silence comes through afterwards, as by TCP's own retransmission, or is thrown away, as by a
        router that has forgotten the connection.
    """

    def __init__(self, target: tuple[str, int], *, keeps: bool) -> None:
        self._server = socket.create_server(("127.0.0.1", 0))
        self.port = int(self._server.getsockname()[1])
        self._target, self._keeps = target, keeps
        self._carries = threading.Event()
        self._carries.set()
        self.connections = 0
        self._open: set[socket.socket] = set()
        threading.Thread(target=self._accept, daemon=True).start()

    def fall_silent(self) -> None:
        """Let nothing through from now on."""
        self._carries.clear()

    def speak(self) -> None:
        """Carry again."""
        self._carries.set()

    def cut(self) -> None:
        """End every connection in the midst of what it carries."""
        for client in tuple(self._open):
            with contextlib.suppress(OSError):
                client.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        """Accept nobody any more."""
        self._carries.set()
        self._server.close()

    def _accept(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                client, _ = self._server.accept()
                self.connections += 1
                threading.Thread(target=self._carry, args=(client,), daemon=True).start()

    def _carry(self, client: socket.socket) -> None:
        self._open.add(client)
        try:
            self._carried(client)
        finally:
            self._open.discard(client)

    def _carried(self, client: socket.socket) -> None:
        with client, contextlib.suppress(OSError):
            self._carries.wait()
            with socket.create_connection(self._target) as server:
                other = {client: server, server: client}
                while True:
                    for side in select.select([client, server], [], [], 0.05)[0]:
                        silent = not self._carries.is_set()
                        if silent and self._keeps:
                            time.sleep(0.05)
                            continue
                        if not (said := side.recv(65536)):
                            return
                        if not silent:
                            other[side].sendall(said)
