"""Gateway: sends the windows of its spool until the service has said that they are stored."""

from __future__ import annotations

import io
import threading
import zipfile
from collections.abc import Callable
from email.message import Message
from functools import partial
from pathlib import Path
from urllib.parse import urlencode

import structlog

from residuum.diagnosis.finding import Finding
from residuum.identification.errors import BadInput
from residuum.identification.record import Record
from residuum.identification.record_formats.npz import write_npz
from residuum.service.fieldbus.settings import MachineSettings
from residuum.service.receivers.delivery import Delivery, Words
from residuum.service.receivers.http_receiver import LATER, PROBLEM, NoReceipt, Poster
from residuum.service.receivers.receiver_settings import Refused
from residuum.service.secret_texts import first_line
from residuum.service.window_queue.set_aside import SetAside
from residuum.service.window_queue.spool import Spool

log = structlog.get_logger()

# [s] For an answer: the service judges before it answers. A window that takes it longer is stored
# all the same, and known when it is sent again.
_PATIENCE = 60.0
# Statuses that are not about the window: who sends it is not let in, and may be later.
_NOT_LET_IN = (401, 403)
_TOO_LARGE = 413
_FAULT = 500
# Where a stored window is, in the answer's head.
_STORED = "/windows/"
# Times that a fault of the service is answered to one window; then it is set aside.
_MOST_FAULTS = 5
# [s] Between two tries to write a window to the spool.
_RETRY = 2.0
# [s] How long it takes at most to notice that a machine's sender is to end.
_LOOK = 1.0
# [s] For the window that is being sent when it ends.
_LAST_WINDOW = 4.0
_WORDS = Words("the service", "window", "set aside")


def request_of(machine: MachineSettings, window: Record) -> bytes:
    """A window as it is sent and kept: a line with what is asked, and the window as NPZ.

    All of it is kept, for a window that is sent again must be the same request.
    """
    asked = {
        "diagnoser": machine.diagnoser,
        "baseline": machine.baseline,
        "method": machine.method,
        "unattended": "true",
    }
    query = urlencode({name: value for name, value in asked.items() if value is not None})
    body = io.BytesIO()
    write_npz(window, body, zipfile.ZIP_STORED)
    return f"/api/v1/assets/{machine.asset}/windows?{query}\n".encode() + body.getvalue()


def window_of(request: bytes) -> bytes:
    """The window of a request, as NPZ."""
    return request.partition(b"\n")[2]


def _for_good(status: int, head: Message) -> bool:
    """Whether the service refuses a window itself: in words of its own, or as too large."""
    if not 400 <= status < 500 or status in (*LATER, *_NOT_LET_IN):
        return False
    return status == _TOO_LARGE or head.get_content_type() == PROBLEM


class Sending:
    """How windows are sent to a service.

    Parameters
    ----------
    url : str
        Its address.
    key_file : Path or None
        File whose first line is the API key; read anew for each window, so that it can be changed.
    ca : Path or None
        PEM file of the authority that signed the service's certificate; None: those of the system.
    name : str
        Of this gateway, for logs of proxies.
    patience : float
        Seconds for an answer.
    """

    def __init__(
        self,
        url: str,
        key_file: Path | None = None,
        ca: Path | None = None,
        name: str = "",
        patience: float = _PATIENCE,
    ) -> None:
        self.url, self._key_file = url.rstrip("/"), key_file
        self._poster = Poster(self.url, ca, (), patience, _for_good)
        self._head = {"User-Agent": f"residuum-gateway/{name}" if name else "residuum-gateway"}
        self._key()

    def send(self, key: str, request: bytes) -> None:
        """Return when the service has it on disk; Refused when it never will, NoReceipt when it has
        to be sent again.
        """
        asked, _, body = request.partition(b"\n")
        head = {"Content-Type": "application/zip", "Idempotency-Key": key}
        head |= {**self._head, **self._key()}
        _, answer = self._poster.ask(body, head, self.url + asked.decode())
        # a proxy that asks for a password, or says that it is busy, may do so with status 200
        if _STORED not in answer.get("Location", ""):
            raise NoReceipt("what answers does not say where it stored the window: is no Residuum")

    def try_service(self) -> str:
        """How the service was reached, in words; OSError or Refused where it does not let us in."""
        self._poster.ask(None, {**self._head, **self._key()}, f"{self.url}/api/v1/assets?limit=1")
        return f"{self.url} lets us in"

    def _key(self) -> dict[str, str]:
        if self._key_file is None:
            return {}
        key = first_line(self._key_file, "service_key_file")
        if not (key.isascii() and key.isprintable()):
            raise BadInput(
                f"service_key_file {self._key_file}: is no API key, which has letters, digits and"
                " signs of ASCII alone; `residuum keys` makes one"
            )
        return {"X-API-Key": key}


class _Sender(Delivery):
    """Sends the windows of one machine, in their order: what waits for one machine's holds up no
    other's.
    """

    def __init__(self, machine: str, spool: Spool, aside: SetAside, sending: Sending) -> None:
        super().__init__(machine, log.bind(machine=machine), _WORDS)
        self._spool, self._aside, self._sending = spool, aside, sending
        self._faults = 0
        self._thread = threading.Thread(target=self._send_all, name=f"send {machine}", daemon=True)
        self._thread.start()

    def join(self) -> None:
        """Wait for its end, for a while."""
        self._thread.join(_LAST_WINDOW)

    def _send_all(self) -> None:
        while not self.stopped.is_set():
            self.news.clear()
            try:
                self._send_oldest()
            except Exception as error:
                # whatever it is, the machine's windows are not given up
                self._log.exception("window not sent, trying again", reason=str(error))
                self.pause()

    def _send_oldest(self) -> None:
        key = self._spool.oldest(self.name)
        if key is None:
            self.news.wait(_LOOK)
        elif self.attempt(partial(self._send, key)):
            self._spool.remove(key)

    def _send(self, key: str) -> None:
        request = self._spool.read(key)
        if request is None:
            return
        try:
            self._answered(key, request)
        except Refused as refused:
            # on disk there before it leaves the spool
            self._aside.put(key, self.name, request, str(refused))
            raise
        self._faults = 0

    def _answered(self, key: str, request: bytes) -> None:
        try:
            self._sending.send(key, request)
        except NoReceipt as error:
            self._faults = self._faults + 1 if error.status == _FAULT else 0
            if self._faults < _MOST_FAULTS:
                raise
            self._faults = 0
            raise Refused(f"{_MOST_FAULTS} times, {error}") from None
        except BadInput as error:  # the file of the key cannot be read now
            raise NoReceipt(str(error)) from None


class Gateway:
    """The sending side: every machine's windows, kept and sent.

    Parameters
    ----------
    spool : Spool
    aside : SetAside
        Gets what the service refuses for good.
    sending : Sending
    """

    def __init__(self, spool: Spool, aside: SetAside, sending: Sending) -> None:
        self.spool = spool
        self._make: Callable[[str], _Sender] = partial(
            _Sender, spool=spool, aside=aside, sending=sending
        )
        self._senders: dict[str, _Sender] = {}
        self._started, self._lock = False, threading.Lock()

    def start(self) -> None:
        """Begin to send, with what an earlier run has left."""
        self._started = True
        for machine in self.spool.machines():
            self._look(machine)

    def stop(self) -> None:
        """End; what is not known to be stored stays in the spool."""
        with self._lock:
            self._started = False
        # all are asked first: they end side by side
        for sender in self._senders.values():
            sender.stop()
        for sender in self._senders.values():
            sender.join()

    def handle(
        self,
        machine: MachineSettings,
        window: Record,
        _baseline: str | None,
        stopped: threading.Event,
    ) -> Finding | None:
        """Keep a window of a machine in the spool (what a `MachineLine` does with it); there is no
        finding yet.
        """
        request = request_of(machine, window)
        while True:
            try:
                self.spool.put(request, machine.asset)
                self._look(machine.asset)
                return None
            except OSError as error:
                log.error(
                    "window not spooled, trying again", machine=machine.asset, reason=str(error)
                )
                if stopped.wait(_RETRY):
                    return None

    def status(self) -> dict[str, int]:
        """What became of the windows so far: one that is gone from the spool is counted."""
        senders = list(self._senders.values())
        return {
            "stored": sum(sender.sent for sender in senders),
            "refused": sum(sender.dropped for sender in senders),
            "waiting": len(self.spool),
            "dropped": self.spool.dropped,
        }

    def troubles(self) -> dict[str, str]:
        """Machine → what the last attempt to send a window of it failed by."""
        senders = list(self._senders.values())
        return {s.name: s.trouble for s in senders if s.trouble is not None}

    def _look(self, machine: str) -> None:
        with self._lock:
            if not self._started:
                return
            if machine not in self._senders:
                self._senders[machine] = self._make(machine)
        self._senders[machine].look()
