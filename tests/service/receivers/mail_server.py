"""An SMTP server of the tests' own, in a thread: by STARTTLS or TLS, with a login, and with replies that a test scripts."""

import base64
import contextlib
import email
import email.policy
import queue
import socketserver
import ssl
import threading


class MailServer:
    """Keeps what it was sent, as (recipients, message); `replies` gives a verb's next replies before it is answered as usual."""

    def __init__(self, certificate=None, tls=False, login=None, replies=None):
        self.told, self.seen = queue.Queue(), []
        self._login, self._tls, self.replies = login, tls, dict(replies or {})
        self._context = None
        if certificate is not None:
            self._context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
            self._context.load_cert_chain(*certificate)
        outer = self

        class Handler(socketserver.BaseRequestHandler):
            def handle(self):
                with contextlib.suppress(OSError), contextlib.ExitStack() as closing:
                    outer._talk(self.request, closing)

        self._server = socketserver.ThreadingTCPServer(("127.0.0.1", 0), Handler)
        self._server.daemon_threads = True
        self.port = self._server.server_address[1]
        threading.Thread(target=self._server.serve_forever, daemon=True).start()

    def stop(self):
        self._server.shutdown()
        self._server.server_close()

    def _talk(self, connection, closing):
        secured, entered, to = self._tls, self._login is None, []
        if secured:
            connection = closing.enter_context(self._secured(connection))
        lines = closing.enter_context(connection.makefile("rb"))
        connection.sendall(b"220 here\r\n")
        while line := lines.readline():
            verb, _, rest = line.decode().strip().partition(" ")
            verb = verb.upper()
            self.seen.append((verb, secured))
            scripted = self.replies.get(verb)
            if scripted and (reply := scripted.pop(0)):
                connection.sendall(reply.encode() + b"\r\n")
            elif verb == "EHLO":
                offers = ["here", *(["AUTH PLAIN"] if self._login else [])]
                offers += ["STARTTLS"] if self._context and not secured else []
                told = [f"250-{offer}\r\n" for offer in offers[:-1]] + [f"250 {offers[-1]}\r\n"]
                connection.sendall("".join(told).encode())
            elif verb == "STARTTLS":
                connection.sendall(b"220 go\r\n")
                connection = closing.enter_context(self._secured(connection))
                lines, secured = closing.enter_context(connection.makefile("rb")), True
            else:
                entered, to = self._answer(connection, lines, (verb, rest), entered, to)

    def _secured(self, connection):
        return self._context.wrap_socket(connection, server_side=True)

    def _answer(self, connection, lines, command, entered, to):
        verb, rest = command
        says = "250 ok"
        if verb == "AUTH":
            entered = base64.b64decode(rest.split()[1]).decode().split("\0")[1:] == list(
                self._login
            )
            says = "235 ok" if entered else "535 no such user or password"
        elif verb in ("MAIL", "RCPT", "DATA") and not entered:
            says = "530 log in first"
        elif verb == "MAIL":
            to = []
        elif verb == "RCPT":
            to = [*to, rest[rest.index("<") + 1 : rest.index(">")]]
        elif verb == "DATA":
            connection.sendall(b"354 go\r\n")
            text = b""
            while (line := lines.readline()) != b".\r\n":
                text += line.removeprefix(b".") if line.startswith(b"..") else line
            self.told.put((to, email.message_from_bytes(text, policy=email.policy.default)))
        elif verb == "QUIT":
            says = "221 bye"
        connection.sendall(says.encode() + b"\r\n")
        return entered, to
