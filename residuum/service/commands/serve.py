"""`residuum serve`: the service, with `--demo` together with its simulated machines."""

import asyncio
import os
import shutil
import signal
import socket
import ssl
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Annotated

import typer
import uvicorn
from fastapi import FastAPI

from residuum.identification.errors import BadInput
from residuum.service.app import create_app
from residuum.service.cli import INTERRUPTED
from residuum.service.commands.settings_template import DatabaseUrl, DataFolder, SettingsFile
from residuum.service.security.http_connections import bounded_connections
from residuum.service.settings import Settings, is_loopback, load_settings
from residuum.service.storage.database import Database
from residuum.service.storage.identity import claim
from residuum.service.storage.service_lock import database_lock, folder_lock
from residuum.service.store import StorageUnavailable
from residuum.service.work.jobs import CompilingBehind
from residuum.service.work.loaded_modules import settle_memory
from residuum.service.work.worker_pool import give_back_large_arrays

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)

# Seconds in which what is under way may end when the service stops. Streams of events are ended
# before: an open page held every stop for all of it.
_STOP_WITHIN = 5


@app.command()
def serve(
    demo: Annotated[
        bool | None, typer.Option("--demo", help="Start the simulated machines and watch them.")
    ] = None,
    host: Annotated[
        str | None,
        typer.Option(help="Address to listen on; any but this machine's own needs API keys."),
    ] = None,
    port: Annotated[
        int | None, typer.Option(min=0, max=65535, help="TCP port; 0 takes a free one.")
    ] = None,
    database: DatabaseUrl = None,
    data: DataFolder = None,
    settings_file: SettingsFile = None,
) -> None:
    """Run the service until it is interrupted."""
    settings = load_settings(
        settings_file, demo=demo or None, host=host, port=port, database=database, data=data
    )
    # Before anything is held or opened: it costs nothing, and is told in a line.
    _check_certificate(settings)
    give_back_large_arrays()
    try:
        # The data before the port: a second service is refused by the folder that it shares,
        # whichever port it was given.
        with _owned(settings), _listening(settings.host, settings.port) as sockets:
            ended_by = _run(settings, sockets)
    except (StorageUnavailable, OSError) as error:
        raise BadInput(f"settings data, database: {error}") from None
    except KeyboardInterrupt:
        sys.stderr.write("residuum: interrupted\n")
        raise typer.Exit(INTERRUPTED) from None
    for number in ended_by:  # all is closed: now it ends as whoever sent the signal expects
        signal.raise_signal(number)


def _run(settings: Settings, sockets: list[socket.socket]) -> list[int]:
    """Serve until a signal comes; gives the signals other than SIGINT, which is raised as
    KeyboardInterrupt.
    """
    service = create_app(settings)
    config = uvicorn.Config(
        service,
        log_config=None,
        # Requests are counted in the metrics, refusals are logged with their key; a line for each
        # window would hide them.
        access_log=False,
        proxy_headers=False,  # the gate believes those of trusted proxies alone
        # begun and ended below: what fails at the start is then told as every other failure
        lifespan="off",
        http=bounded_connections(settings),  # type: ignore[arg-type]  # TLS, too
        ws="none",  # a connection that turned into one would be bounded no more
        timeout_graceful_shutdown=_STOP_WITHIN,
        # A head is held in memory until it is whole.
        h11_max_incomplete_event_size=settings.header_limit,
    )
    server = _Server(config, service)
    asyncio.run(_serve(server, service, sockets, settings))
    if signal.SIGINT in server.ended_by:
        raise KeyboardInterrupt
    return server.ended_by


class _Server(uvicorn.Server):
    """Ends streams of events when it stops: they have no end of their own, and would be waited for
    as long as may be.
    """

    def __init__(self, config: uvicorn.Config, app: FastAPI) -> None:
        super().__init__(config)
        self._app = app
        self.ended_by: list[int] = []

    @contextmanager
    def capture_signals(self) -> Iterator[None]:
        """Keep the signals that end it: raised again here, they would end the process before the
        rest of the service ends.
        """
        with super().capture_signals():
            yield
            self.ended_by = list(self._captured_signals)
            self._captured_signals.clear()

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """End the streams, answer what is under way, stop."""
        self._app.state.services.events.close()
        await super().shutdown(sockets)


async def _serve(
    server: uvicorn.Server, service: FastAPI, sockets: list[socket.socket], settings: Settings
) -> None:
    async with service.router.lifespan_context(service):
        running = asyncio.create_task(server.serve(sockets))
        # uvicorn tells its start by a flag alone; a start that failed ends its task.
        while not server.started and not running.done():
            await asyncio.sleep(0.02)
        behind = CompilingBehind()
        try:
            if server.started:
                settle_memory()
                sys.stdout.write(_greeting(settings, sockets[0].getsockname()[1]))
                sys.stdout.flush()
                # Behind the greeting: a fresh installation once waited a minute for it before it
                # served.
                await asyncio.to_thread(behind.start)
            await running
        finally:
            await asyncio.to_thread(behind.stop)


def _greeting(settings: Settings, port: int) -> str:
    host = f"[{settings.host}]" if ":" in settings.host else settings.host
    scheme = "http" if settings.tls_certificate is None else "https"
    lines = [f"Residuum is at {scheme}://{host}:{port}/"]
    if is_loopback(settings.host):
        lines.append("It listens on this machine only.")
    if settings.demo:
        lines.append(
            "Demo: three simulated machines; their diagnosers are being trained. Switch a fault on"
            " the page, or in another shell:"
        )
        lines.append(
            f"  {_typed_command()} fault process-plant sensor-offset --url {scheme}://{host}:{port}"
        )
    return "\n".join(lines) + "\n"


def _typed_command() -> str:
    """How this program is called from another shell: by its whole path where its environment is not
    on the PATH.
    """
    return "residuum" if shutil.which("residuum") else str(Path(sys.prefix, "bin", "residuum"))


def _check_certificate(settings: Settings) -> None:
    """BadInput in one line, rather than a failure at the start, for files that are no certificate
    with its key.
    """
    if settings.tls_certificate is None:
        return
    try:
        ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER).load_cert_chain(
            settings.tls_certificate, settings.tls_key
        )
    except (OSError, ssl.SSLError) as error:
        raise BadInput(
            f"settings tls_certificate, tls_key: {settings.tls_certificate}: {error}"
        ) from None


def _refuse_damage(database: Database) -> None:
    """BadInput for a small file of which SQLite says that it is damaged; the rest is looked through
    while the service runs.
    """
    damage = database.damage() if database.looked_through_first() else None
    if damage is not None:
        raise BadInput(
            f"setting database: {database.url.database}: is damaged: {damage}; restore a backup"
            " into a new folder"
        )


def _end(reason: str) -> None:
    """End this service in good order: another one has what it needs."""
    sys.stderr.write(f"residuum: {reason}\n")
    os.kill(os.getpid(), signal.SIGTERM)


@contextmanager
def _owned(settings: Settings) -> Iterator[None]:
    """Hold data folder and database for this service alone, with the newest schema and the same
    identity.

    BadInput in one line where another service holds them, they do not belong together, or one
    cannot be read and written.
    """
    with ExitStack() as held:
        try:
            # The folder first: the database may lie in it.
            held.enter_context(folder_lock(settings.data))
        except OSError as error:
            raise BadInput(
                f"setting data: {settings.data}: cannot be written: {error.strerror}"
            ) from None
        try:
            database = Database(settings.database_url)
            held.callback(database.close)
            # Refused before its schema is migrated.
            _refuse_damage(database)
            database.migrate()
            held.enter_context(database_lock(database, claim(settings.data, database), _end))
        except StorageUnavailable as error:
            raise BadInput(f"setting database: {error}") from None
        except OSError as error:
            raise BadInput(
                f"settings data, database: {error.filename}: cannot be written: {error.strerror}"
            ) from None
        yield


@contextmanager
def _listening(host: str, port: int) -> Iterator[list[socket.socket]]:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    listening = socket.socket(family, socket.SOCK_STREAM)
    try:
        # A service that starts again need not wait for connections of the last one to be forgotten.
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listening.bind((host, port))
        listening.listen(512)
    except OSError as error:
        listening.close()
        raise BadInput(
            f"--host {host} --port {port}: cannot listen there: {error.strerror or error}"
        ) from None
    try:
        yield [listening]
    finally:
        listening.close()
