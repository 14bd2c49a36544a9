"""A Modbus TCP device written by hand (no pymodbus): four tables, registers that are not there, nothing else."""

import contextlib
import socket
import struct
import threading

TABLES = {1: "coils", 2: "discrete", 3: "holding", 4: "input"}


class SmallDevice:
    """`tables` has of each table what is in its registers, by address; what is not there is refused with exception 2."""

    def __init__(self, unit=1, **tables):
        self.tables, self.unit, self.asked = tables, unit, []
        self._listening = socket.create_server(("127.0.0.1", 0))
        self.port = self._listening.getsockname()[1]
        self._open = []
        threading.Thread(target=self._serve, daemon=True).start()

    def __enter__(self):
        return self

    def __exit__(self, *_error):
        self._listening.shutdown(socket.SHUT_RDWR)
        self._listening.close()
        for connection in self._open:
            with contextlib.suppress(OSError):
                connection.shutdown(socket.SHUT_RDWR)

    def _serve(self):
        with contextlib.suppress(OSError):
            while True:
                connection, _ = self._listening.accept()
                self._open.append(connection)
                threading.Thread(target=self._talk, args=(connection,), daemon=True).start()

    def _talk(self, connection):
        with (
            contextlib.suppress(OSError, struct.error),
            connection,
            connection.makefile("rwb") as stream,
        ):
            while True:
                transaction, _, length, unit = struct.unpack(">HHHB", stream.read(7))
                function, address, count = struct.unpack(">BHH", stream.read(length - 1))
                body = self._answer(unit, function, address, count)
                stream.write(struct.pack(">HHHB", transaction, 0, len(body) + 1, unit) + body)
                stream.flush()

    def _answer(self, unit, function, address, count):
        table = TABLES.get(function)
        self.asked.append((table, address, count))
        if unit != self.unit:
            return bytes([function | 0x80, 11])
        if table not in self.tables:
            return bytes([function | 0x80, 1])
        there = self.tables[table]
        if any(place not in there for place in range(address, address + count)):
            return bytes([function | 0x80, 2])
        values = [there[place] for place in range(address, address + count)]
        if table in ("coils", "discrete"):
            packed = sum(value << k for k, value in enumerate(values)).to_bytes(
                -(-count // 8), "little"
            )
            return bytes([function, len(packed)]) + packed
        return struct.pack(f">BB{count}H", function, 2 * count, *values)
