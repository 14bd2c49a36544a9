"""`residuum doctor`: what the service needs, checked one by one; nothing is changed."""

from __future__ import annotations

import shutil
import socket
import tempfile
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Annotated

import can
import typer

from residuum.identification.errors import BadInput
from residuum.identification.physics import load_model
from residuum.service.alarms.notifications import Broker
from residuum.service.cli import ANSWER_IS_NO
from residuum.service.commands.report import AsJson, report
from residuum.service.fieldbus.can import open_bus
from residuum.service.fieldbus.frame_layout import read_dbc
from residuum.service.fieldbus.register_map import read_register_map
from residuum.service.fieldbus.settings import MachineSettings, SourceSettings
from residuum.service.security.access import ApiKeys
from residuum.service.settings import Settings, broker_address, is_loopback, load_settings
from residuum.service.storage import audit, block_rows
from residuum.service.storage.audit import BrokenAudit
from residuum.service.storage.blocks import Blocks, BrokenBlock
from residuum.service.storage.database import Database, newest_revision, sqlite_file
from residuum.service.store import StorageUnavailable

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)

_MIB = 2**20
_SPARE = 512 * _MIB
"""Free disk [bytes] that rows, logs and the database's journal should find beyond the signals still to come."""
_PATIENCE = 3.0
"""How long a device may take to accept a connection [s]."""


class Wrong(Exception):
    """A check found something wrong; the message is one line that says what."""


@dataclass(frozen=True)
class Check:
    """One line of the report."""

    name: str
    ok: bool
    says: str


@app.command()
def doctor(
    data: Annotated[Path | None, typer.Option(help="Folder of signal blocks, baselines and the default database.")] = None,
    database: Annotated[str | None, typer.Option(help="SQLAlchemy URL; default: SQLite in the data folder.")] = None,
    blocks: Annotated[int, typer.Option(min=1, help="How many signal blocks to compare with their checksums.")] = 100,
    as_json: AsJson = False,
) -> None:
    """Check database, audit trail, blocks, disk, access, buses, broker, compiled code; exit status 1 when something is wrong."""
    settings = load_settings(data=data, database=database)
    checks = [
        _check("database", lambda: _database(settings)),
        _check("audit trail", lambda: _audit(settings)),
        _check("signal blocks", lambda: _signal_blocks(settings, blocks)),
        _check("disk", lambda: _disk(settings)),
        _check("access", lambda: _access(settings)),
        *_buses(settings),
        *_models(settings),
        *([_check("broker", lambda: _broker(settings))] if settings.mqtt else []),
        _check("compiled code", _compiled_code),
    ]
    lines = [f"{'ok   ' if check.ok else 'WRONG'} {check.name:<15} {check.says}" for check in checks]
    healthy = all(check.ok for check in checks)
    report({"ok": healthy, "checks": [asdict(check) for check in checks]}, "\n".join(lines), as_json=as_json)
    if not healthy:
        raise typer.Exit(ANSWER_IS_NO)


def _check(name: str, look: Callable[[], str]) -> Check:
    try:
        return Check(name, True, look())
    except (Wrong, BadInput, StorageUnavailable, BrokenBlock, BrokenAudit, OSError, can.CanError) as error:
        return Check(name, False, " ".join(str(error).split()))


def _models(settings: Settings) -> list[Check]:
    """The model file of every machine that is watched by one."""
    watched = [machine for machine in settings.machines if machine.diagnoser == "model-based"]
    return [_check(f"model {machine.asset}", partial(_model, machine)) for machine in watched]


def _model(machine: MachineSettings) -> str:
    if machine.model is None:
        return "none in the settings; its baseline has the one that it was trained with"
    model = load_model(machine.model)
    return f"{machine.model}: reads {', '.join(model.inputs)}, gives {', '.join(model.outputs)}"


def _database(settings: Settings) -> str:
    database = _existing(settings)
    if database is None:
        return "is not there yet; the first start makes it"
    try:
        found, newest = database.revision(), newest_revision()
        if found != newest:
            raise Wrong(f"its schema is at revision {found}, this program needs {newest}; a start of the service migrates it")
        with database.write() as connection:
            damage = connection.exec_driver_sql("PRAGMA quick_check(1)").scalar() if _is_sqlite(database) else "ok"
        if damage != "ok":
            raise Wrong(f"is damaged: {damage}; restore a backup")
        return f"{database.url.get_backend_name()}, can be written, schema at revision {found}"
    finally:
        database.close()


def _audit(settings: Settings) -> str:
    database = _existing(settings)
    if database is None:
        return "none yet"
    try:
        if database.revision() != newest_revision():
            return "is looked at once the schema is the newest"
        with database.snapshot() as connection:
            head = audit.verify(connection)
        return f"{head.entries} entries, none changed or missing; its head is {head.digest[:16]}…{head.digest[-8:]}"
    finally:
        database.close()


def _existing(settings: Settings) -> Database | None:
    """The database, None when it is a SQLite file that is not there yet (opening would make it)."""
    file = sqlite_file(settings.database_url)
    return None if file is not None and not file.exists() else Database(settings.database_url)


def _is_sqlite(database: Database) -> bool:
    return database.url.get_backend_name() == "sqlite"


def _signal_blocks(settings: Settings, sample: int) -> str:
    database = _existing(settings)
    if database is None:
        return "none yet"
    try:
        with database.read() as connection:
            references = block_rows.references(connection) if database.revision() == newest_revision() else []
    finally:
        database.close()
    folder = settings.data / "blocks"
    missing = [block.path for block in references if not (folder / block.path).is_file()]
    if missing:
        raise Wrong(f"{len(missing)} of {len(references)} are missing, the first: {missing[0]}")
    looked_at = references[:: max(1, -(-len(references) // sample))]
    for block in looked_at:
        Blocks(folder).verify(block)
    return f"all {len(references)} are there; {len(looked_at)} compared with their checksums"


def _disk(settings: Settings) -> str:
    folder = next(parent for parent in (settings.data.resolve(), *settings.data.resolve().parents) if parent.is_dir())
    with tempfile.TemporaryFile(dir=folder) as probe:
        probe.write(b"probe")
    held = sum(file.stat().st_size for file in settings.data.glob("blocks/*/*.block"))
    needed = max(0, settings.keep_bytes - held) + _SPARE
    free = shutil.disk_usage(folder).free
    says = f"{folder} can be written, {free / _MIB:.0f} MiB free; keep_bytes and rows may still take {needed / _MIB:.0f} MiB"
    if free < needed:
        raise Wrong(says)
    return says


def _access(settings: Settings) -> str:
    keys = ApiKeys(settings.api_keys, tokens=settings.oidc_issuer is not None)
    where = "this machine only" if is_loopback(settings.host) else f"{settings.host}, for other machines too"
    return f"listens on {where}; " + ("API keys or tokens are needed" if keys.needed else "no API keys are needed")


def _buses(settings: Settings) -> list[Check]:
    sources = {
        (source.kind, source.channel, source.host, source.port, source.map): source
        for machine in settings.machines
        for source in machine.sources
    }
    if not sources:
        return [Check("buses", True, "the demo brings its own" if settings.demo else "none are configured")]
    return [_check(f"{source.kind} bus", partial(_bus, source)) for source in sources.values()]


def _bus(source: SourceSettings) -> str:
    if source.kind == "can":
        messages = len(read_dbc(source.map_file))
        open_bus(source.channel).close()
        return f"{source.channel} can be opened; {source.map} has {messages} messages"
    streams = len(read_register_map(source.map_file).streams)
    address = f"{source.host}:{source.port}"
    try:
        socket.create_connection((source.host, source.port), timeout=_PATIENCE).close()
    except OSError as error:
        raise Wrong(f"{address}: no connection: {error}") from None
    return f"{address} accepts connections; {source.map} has {streams} streams"


def _broker(settings: Settings) -> str:
    address = broker_address(settings.mqtt)
    where = f"{address.host}:{address.port}"
    try:
        Broker(address).try_connection()
    except OSError as error:
        raise Wrong(f"{where}: {error}") from None
    return f"{where} lets us in; topics begin with {address.prefix}/"


def _compiled_code() -> str:
    try:
        from residuum.identification.physics.simulate.integration import new_memory  # noqa: PLC0415 - numba refuses at import
    except RuntimeError as error:
        raise Wrong(f"there is no folder to cache it in ({error}); set NUMBA_CACHE_DIR to one that can be written") from None
    folder = Path(str(new_memory.stats.cache_path))
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryFile(dir=folder):
        return f"is cached in {folder}"
