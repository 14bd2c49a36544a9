"""`residuum doctor`: what the service needs, checked one by one; nothing is changed unless it is
asked to sweep.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import partial
from typing import Annotated

import can
import typer

from residuum.code_folder import code_folder, why_not_kept
from residuum.identification.errors import BadInput
from residuum.service.broker import BrokerAddress, try_connection
from residuum.service.cli import ANSWER_IS_NO
from residuum.service.commands.gateway import sending_of
from residuum.service.commands.machine_checks import machine_check
from residuum.service.commands.report import AsJson, report
from residuum.service.commands.settings_template import DatabaseUrl, DataFolder, SettingsFile
from residuum.service.fieldbus import SOURCES
from residuum.service.fieldbus.settings import MachineSettings, SourceSettings
from residuum.service.fieldbus.source_kind import Told, Wrong, streams_alone
from residuum.service.machines.baselines import has_baseline
from residuum.service.notifications import receivers_of
from residuum.service.receivers.receiver_settings import Refused
from residuum.service.security.access import ApiKeys
from residuum.service.settings import Settings, is_loopback, load_settings
from residuum.service.storage import DiskStore, audit
from residuum.service.storage.audit import BrokenAudit
from residuum.service.storage.blocks import Blocks, BrokenBlock
from residuum.service.storage.database import Database, newest_revision, sqlite_file
from residuum.service.storage.disk_store import SETTLED
from residuum.service.storage.identity import claim
from residuum.service.storage.rows import block_rows
from residuum.service.storage.rows.row_checks import check_rows
from residuum.service.store import StorageUnavailable
from residuum.service.window_queue.set_aside import FOLDER, SetAside

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)

_MIB = 2**20
# Free disk [bytes] that rows, logs and the database's journal should find beyond the signals still
# to come.
_SPARE = 512 * _MIB
# How long a device may take to accept a connection [s]: devices are asked one after the other, and
# the report must come also where several are away.
_PATIENCE = 3.0


@dataclass(frozen=True)
class Check:
    """One line of the report."""

    name: str
    ok: bool
    says: str
    remark: str = ""

    @property
    def line(self) -> str:
        """As it is printed: what is right with a remark is neither `ok` nor wrong."""
        word = "NOTE" if self.remark else "ok"
        if not self.ok:
            word = "WRONG"
        remark = f"; {self.remark}" if self.remark else ""
        return f"{word:<5} {self.name:<15} {self.says}{remark}"


@app.command()
def doctor(
    data: DataFolder = None,
    database: DatabaseUrl = None,
    blocks: Annotated[
        int, typer.Option(min=1, help="How many signal blocks to compare with their checksums.")
    ] = 100,
    sweep: Annotated[
        bool,
        typer.Option("--sweep", help="Delete signal blocks that no row of the database names."),
    ] = False,
    settings_file: SettingsFile = None,
    as_json: AsJson = False,
) -> None:
    """Check database, rows, blocks, disk, access, buses, machines, broker, receivers, compiled
    code; exit status 1 when one is wrong.
    """
    settings = load_settings(settings_file, data=data, database=database)
    # Before the checks, which then tell what is left.
    if sweep:
        _sweep(settings)
    checks = [
        # The database first: what rows, trail and blocks are worth hangs on it. Each check opens it
        # anew, so that one which fails leaves nothing open to the others.
        _check("database", lambda: _database(settings)),
        _check("audit trail", lambda: _audit(settings)),
        _check("rows", lambda: _rows(settings)),
        _check("signal blocks", lambda: _signal_blocks(settings, blocks)),
        _check("disk", lambda: _disk(settings)),
        _check("access", lambda: _access(settings)),
        *_buses(settings),
        *_machines(settings),
        *([_check("broker", lambda: _broker(settings))] if settings.mqtt else []),
        *([_check("service", lambda: _service(settings))] if settings.service_url else []),
        *_receivers(settings),
        _check("compiled code", _compiled_code),
    ]
    lines = [check.line for check in checks]
    healthy = all(check.ok for check in checks)
    report(
        {"ok": healthy, "checks": [asdict(check) for check in checks]},
        "\n".join(lines),
        as_json=as_json,
    )
    if not healthy:
        raise typer.Exit(ANSWER_IS_NO)


def _sweep(settings: Settings) -> None:
    """Delete what no row names; BadInput where folder and database do not belong together, or this
    program has not started.
    """
    database = _existing(settings)
    if database is None:
        raise BadInput("--sweep: there is no database yet; nothing was deleted")
    try:
        database.refuse_other_revision()
        # Beside another database no row would name any block, and all would go.
        claim(settings.data, database)
    except StorageUnavailable as error:
        raise BadInput(f"--sweep: {error}; nothing was deleted") from None
    finally:
        database.close()
    store = DiskStore(settings.data, settings.database_url)
    try:
        sys.stderr.write(
            f"residuum: deleted {store.sweep(SETTLED)} signal blocks that no row named\n"
        )
    finally:
        store.close()


def _check(name: str, look: Callable[[], str | tuple[str, str]]) -> Check:
    """What a look says, with or without a remark; wrong is what it raises."""
    try:
        says = look()
        return Check(name, True, says) if isinstance(says, str) else Check(name, True, *says)
    except (
        Wrong,
        BadInput,
        StorageUnavailable,
        BrokenBlock,
        BrokenAudit,
        OSError,
        can.CanError,
    ) as error:
        return Check(name, False, " ".join(str(error).split()))


def _machines(settings: Settings) -> list[Check]:
    """Every machine of the settings: whether its signals, its model and its baseline are there."""
    return [
        _check(f"machine {machine.asset}", partial(_machine, settings, machine))
        for machine in settings.machines
    ]


def _machine(settings: Settings, machine: MachineSettings) -> tuple[str, str]:
    says, lacks, remark = machine_check(machine, _baseline(settings, machine), settings.alarms)
    if lacks:
        raise Wrong("; ".join(lacks))
    return says, remark


def _baseline(settings: Settings, machine: MachineSettings) -> tuple[bool, int] | None:
    """Whether the machine has a baseline and how many windows are recorded; None before the first
    start.
    """
    database = _existing(settings)
    # A doctor changes nothing: a store would migrate the schema under a service of another version.
    if database is None or database.revision() != newest_revision():
        return None
    database.close()
    store = DiskStore(settings.data, settings.database_url)
    try:
        return has_baseline(store, machine.asset, machine.baseline), len(
            store.recorded_windows(machine.asset)
        )
    finally:
        store.close()


def _database(settings: Settings) -> str:
    database = _existing(settings)
    if database is None:
        return "is not there yet; the first start makes it"
    try:
        revision, newest = database.revision(), newest_revision()
        if revision != newest:
            raise Wrong(
                f"its schema is at revision {revision}, this program needs {newest}; a start of the"
                " service migrates it"
            )
        # A file's mode does not tell: it may be on a disk that is read-only, or another holds its
        # lock.
        with database.write():
            pass  # it can be written
        damage = database.damage()
        if damage is not None:
            raise Wrong(f"is damaged: {damage}; restore a backup")
        return f"{database.url.get_backend_name()}, can be written, schema at revision {revision}"
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
        return (
            f"{head.entries} entries, none changed or missing; its head is"
            f" {head.digest[:16]}…{head.digest[-8:]}"
        )
    finally:
        database.close()


def _rows(settings: Settings) -> str:
    database = _existing(settings)
    if database is None:
        return "none yet"
    try:
        if database.revision() != newest_revision():
            return "are looked at once the schema is the newest"
        with database.snapshot() as connection:
            checked = check_rows(connection)
    except (ValueError, TypeError) as error:  # a moment that is none
        raise Wrong(f"one cannot be read: {error}; restore a backup") from None
    finally:
        database.close()
    if checked.wrong:
        more = f" ({len(checked.wrong)} such in all)" if len(checked.wrong) > 1 else ""
        raise Wrong(f"{checked.wrong[0]}{more}; restore a backup")
    return f"{checked.rows} looked at, all agree"


def _existing(settings: Settings) -> Database | None:
    """The database, None when it is a SQLite file that is not there yet (opening would make it)."""
    file = sqlite_file(settings.database_url)
    return None if file is not None and not file.exists() else Database(settings.database_url)


def _signal_blocks(settings: Settings, sample: int) -> str | tuple[str, str]:
    database = _existing(settings)
    if database is None:
        return "none yet"
    try:
        with database.read() as connection:
            references = (
                block_rows.references(connection)
                if database.revision() == newest_revision()
                else []
            )
    finally:
        database.close()
    folder, named = settings.data / "blocks", {block.path for block in references}
    # Settled ones alone: a service that runs may have a block on disk whose row is still to come.
    unnamed = len(set(Blocks(folder).paths(SETTLED)) - named)
    missing = [block.path for block in references if not (folder / block.path).is_file()]
    if missing:
        raise Wrong(f"{len(missing)} of {len(references)} are missing, the first: {missing[0]}")
    # Spread evenly over all of them, rounded so that at least one is looked at.
    looked_at = references[:: max(1, -(-len(references) // sample))]
    for block in looked_at:
        Blocks(folder).verify(block)
    remark = (
        f"{unnamed} more that no row names; `residuum doctor --sweep` deletes them"
        if unnamed
        else ""
    )
    return (
        f"all {len(references)} are there; {len(looked_at)} compared with their checksums",
        remark,
    )


def _disk(settings: Settings) -> str:
    folder = next(
        parent
        for parent in (settings.data.resolve(), *settings.data.resolve().parents)
        if parent.is_dir()
    )
    # The mode of a folder does not tell: a file system may be read-only.
    with tempfile.TemporaryFile(dir=folder) as probe:
        probe.write(b"probe")
    # What is kept already needs no more room.
    held = sum(file.stat().st_size for file in settings.data.glob("blocks/*/*.block"))
    needed = max(0, settings.keep_bytes - held) + _SPARE
    free = shutil.disk_usage(folder).free
    says = (
        f"{folder} can be written, {free / _MIB:.0f} MiB free; keep_bytes and rows may still take"
        f" {needed / _MIB:.0f} MiB"
    )
    if free < needed:
        raise Wrong(says)
    return says


def _access(settings: Settings) -> str:
    keys = ApiKeys(settings.api_keys, tokens=settings.oidc_issuer is not None)
    where = (
        "this machine only"
        if is_loopback(settings.host)
        else f"{settings.host}, for other machines too"
    )
    return f"listens on {where}; " + (
        "API keys or tokens are needed" if keys.needed else "no API keys are needed"
    )


def _buses(settings: Settings) -> list[Check]:
    # Machines may share a bus: it is opened and asked once.
    sources = {
        (source.kind, source.channel, source.host, source.port, source.map): source
        for machine in settings.machines
        for source in machine.sources
    }
    if not sources:
        return [
            Check(
                "buses", True, "the demo brings its own" if settings.demo else "none are configured"
            )
        ]
    return [_check(f"{source.kind} bus", partial(_bus, source)) for source in sources.values()]


def _bus(source: SourceSettings) -> Told:
    kind = SOURCES[source.kind]
    return streams_alone(kind, source) if kind.look is None else kind.look(source, _PATIENCE)


def _receivers(settings: Settings) -> list[Check]:
    """Every receiver of alarms: whether it can be reached, and lets us in where it asks who we
    are.
    """
    try:
        receivers = receivers_of(settings)
    except BadInput as error:
        return [Check("receivers", False, str(error))]
    return [_check(f"receiver {each.called}", each.try_connection) for each in receivers]


def _broker(settings: Settings) -> str:
    address = settings.broker
    _let_in(address)
    node = f"; Sparkplug B as {settings.sparkplug}" if settings.sparkplug else ""
    return f"{address.host}:{address.port} lets us in; topics begin with {address.prefix}/{node}"


def _service(settings: Settings) -> tuple[str, str]:
    """Of a gateway: whether the service lets it in, and what it refused."""
    try:
        says = sending_of(settings).try_service()
    except (OSError, Refused) as error:
        raise Wrong(f"{settings.service_url}: {error}") from None
    aside = SetAside(settings.data)
    newest = aside.newest(1)
    remark = (
        f"{aside.count} windows were set aside in {settings.data / FOLDER}, the last:"
        f" {newest[0].reason}; `residuum set-aside` lists them"
        if newest
        else ""
    )
    return says, remark


def _let_in(address: BrokerAddress) -> None:
    """Whether a broker lets us in; Wrong when it does not."""
    try:
        try_connection(address)
    except OSError as error:
        raise Wrong(f"{address.host}:{address.port}: {error}") from None


def _compiled_code() -> str:
    # Kept nowhere, every start compiles anew; kept in a folder that others may write, code of
    # another user would be run (docs/explanation/threat-model.md).
    places = {"loops": "NUMBA_CACHE_DIR", "kernels": "RESIDUUM_CACHE"}
    for name, variable in places.items():
        why = why_not_kept(name, variable)
        if why is not None:
            raise Wrong(
                f"{name} are not kept: {why}; set {variable} to a folder of this user alone"
            )
    return " and ".join(
        f"{name} are kept in {code_folder(name, variable)}" for name, variable in places.items()
    )
