"""A server for the OPC UA campaign, told on standard input what to do wrong; its values say when they were measured.

Sample i of a true clock (a sample every STEP seconds since 1970) has u = i and y = 2·i + 1; its stamp is i·STEP, plus what the
clock was set by. A value whose status is not good has half a unit added, so that it is known wherever it turns up.
"""

import asyncio
import sys
import threading
import time

from asyncua import ua

from residuum.service.fieldbus.opcua.node_server import NodeServer

STEP = 0.05


class Faults:
    """What is wrong now; changed by lines of standard input."""

    def __init__(self):
        self.shift, self.status, self.every, self.drop = 0.0, ua.StatusCodes.Good, 1, False

    def listen(self):
        for line in sys.stdin:
            word, *rest = line.split()
            if word == "jump":
                self.shift += float(rest[0])
            elif word == "status":
                self.status = int(rest[0])
            elif word == "every":
                self.every = int(rest[0])
            elif word == "drop":
                self.drop = True


def drop_sessions(server):
    """Close every connection without a word."""
    for client in list(server._server.bserver.clients):
        client.transport.abort()


async def main(port, shift):
    faults = Faults()
    faults.shift = shift
    server = NodeServer(f"opc.tcp://127.0.0.1:{port}/")
    await server.start({"m": ("u", "y")})
    threading.Thread(target=faults.listen, daemon=True).start()
    sys.stdout.write(f"up {time.monotonic()}\n")
    sys.stdout.flush()
    last = int(time.time() / STEP)
    while True:
        now = int(time.time() / STEP)
        for i in range(last + 1, now + 1):
            status, good = faults.status, faults.status == ua.StatusCodes.Good
            for part in range(faults.every):  # parts of a sample: values faster than the map says
                stamp = (i + 0.2 * part) * STEP + faults.shift
                await server.write("m", "u", i + (0.0 if good else 0.5), stamp, status)
                await server.write("m", "y", 2 * i + 1 + (0.0 if good else 0.5), stamp, status)
        last = now
        if faults.drop:
            faults.drop = False
            drop_sessions(server)
        await asyncio.sleep(0.02)


if __name__ == "__main__":
    asyncio.run(main(int(sys.argv[1]), float(sys.argv[2])))
