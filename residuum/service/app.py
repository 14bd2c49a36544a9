"""The service as an ASGI app: storage, events, jobs, pipeline and routes joined."""

from __future__ import annotations

import asyncio
import shutil
import threading
from collections.abc import AsyncIterator, Callable, Iterator, Mapping, Sequence
from contextlib import AsyncExitStack, asynccontextmanager, suppress
from dataclasses import asdict
from functools import partial
from importlib import import_module
from importlib.metadata import version
from typing import Any, NamedTuple, Protocol, TypeVar

import structlog
from fastapi import FastAPI
from sqlalchemy.engine import make_url

from residuum.identification.units import read_registry
from residuum.service import problems
from residuum.service.alarms.alarm_states import AlarmRule
from residuum.service.alarms.events import Events
from residuum.service.api import ROUTERS, health
from residuum.service.api.responses import downloads
from residuum.service.known_queries import KnownQueries
from residuum.service.logs import set_up_logs
from residuum.service.machines.pipeline import Pipeline
from residuum.service.machines.scoring import Judges
from residuum.service.metrics import Metrics
from residuum.service.notifications import Notifications
from residuum.service.security.access import ApiKeys
from residuum.service.security.bearer_tokens import BearerTokens
from residuum.service.security.gate import Gate
from residuum.service.security.refusals import Refusals
from residuum.service.services import LivePipeline, Services
from residuum.service.settings import BadSettings, Settings
from residuum.service.simulated.demo_pipeline import DemoPipeline
from residuum.service.storage.database import sqlite_file
from residuum.service.storage.disk_store import SETTLED, DiskStore
from residuum.service.storage.retention import Retention
from residuum.service.store import Alarm, Page, StorageUnavailable
from residuum.service.web import web_routes
from residuum.service.work.jobs import Jobs
from residuum.service.work.worker_pool import WorkerPool

log = structlog.get_logger()

API = "/api/v1"
# Seconds between looks at shelved alarms that have run out: fine enough, as shelving is said in
# minutes.
_TICK = 5.0
# Seconds for which equal refusals are one entry of the audit trail. Somebody who guesses keys would
# else write the trail full, and queue all other writers for it.
_AUDIT_EVERY = 10.0
# Seconds between looks at signals that need not be kept.
_RETAIN_EVERY = 60.0

MakePipeline = Callable[[Settings, DiskStore, Events, WorkerPool], LivePipeline]


def create_app(settings: Settings, make_pipeline: MakePipeline | None = None) -> FastAPI:
    """The service, ready to be run by an ASGI server; everything it holds lives from startup to
    shutdown. Without `make_pipeline` the settings say which one watches its machines.

    Raises BadSettings for keys that cannot be read or a database URL that names none.
    """
    keys = ApiKeys(settings.api_keys, tokens=settings.oidc_issuer is not None)
    tokens = None if settings.oidc_issuer is None else BearerTokens(settings)
    # Here and not with the rest: the gate is made with the app, and refuses before the service has
    # started.
    refusals = Refusals()
    pipeline = make_pipeline or (DemoPipeline if settings.demo else Pipeline)

    def pipeline_status() -> Mapping[str, Any]:
        return app.state.services.pipeline.status()

    metrics = Metrics(pipeline_status)
    shared = _SharedWithGate(metrics, keys, refusals)

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        async with _running(app, settings, shared, pipeline) as services:
            app.state.services = services
            yield

    app = FastAPI(
        title="Residuum",
        summary="Condition monitoring for machines that have a model",
        description=(
            "Scores signal windows of machines, keeps findings and alarms, and says what physics a"
            " model is missing."
        ),
        version=version("residuum"),
        lifespan=lifespan,
        # FastAPI's own pages fetch scripts from the network, which neither the content policy nor a
        # plant's firewall lets in.
        docs_url=None,
        redoc_url=None,
    )
    problems.install(app)
    # behind the gate: a stranger is told of no keys
    app.add_middleware(KnownQueries, document=app.openapi)
    app.add_middleware(
        Gate,
        settings=settings,
        keys=keys,
        tokens=tokens,
        measure=metrics.request,
        refusals=refusals,
    )
    _add_routes(app)
    return app


def _add_routes(app: FastAPI) -> None:
    # Health also without the prefix, where orchestrators look for it; told once in the document.
    for router in (*ROUTERS, health.router):
        app.include_router(router, prefix=API)
    app.include_router(health.router, include_in_schema=False)
    app.router.routes.extend(web_routes())


class _SharedWithGate(NamedTuple):
    """What is there before the service is started: the gate, which has it too, is made with the
    app.
    """

    metrics: Metrics
    keys: ApiKeys
    refusals: Refusals


@asynccontextmanager
async def _running(
    app: FastAPI, settings: Settings, shared: _SharedWithGate, make_pipeline: MakePipeline
) -> AsyncIterator[Services]:
    set_up_logs(settings)
    metrics, keys, refusals = shared
    events, notifications = Events(), Notifications(settings)

    outs: list[Any] = []

    def announce(kind: str, payload: Mapping[str, Any]) -> None:
        metrics.event(kind, payload)
        events.publish(kind, payload)
        for out in outs:
            out.tell(kind, payload)
        notifications.tell(kind, payload)

    def rule_of(asset: str) -> AlarmRule:
        return pipeline.alarm_rule(asset)

    # whatever fails at the start, what was started before it is ended
    async with AsyncExitStack() as started:

        def ends(stop: Callable[[], Any]) -> None:
            started.push_async_callback(asyncio.to_thread, stop)

        store = await asyncio.to_thread(
            DiskStore, settings.data, settings.database_url, announce, rule_of
        )
        ends(store.close)
        ends(partial(_audit_refusals, store, refusals))
        outs += await asyncio.to_thread(_finding_outs, settings, keys)
        for out in outs:
            ends(out.stop)
        await asyncio.to_thread(tell_latest, store, outs)
        await asyncio.to_thread(notifications.start, store.outbox, store.note_order)
        ends(notifications.stop)
        executor = WorkerPool(settings.workers)
        started.callback(executor.shutdown, wait=False, cancel_futures=True)
        jobs = Jobs(events.publish)
        ends(jobs.close)
        # what was started last is ended first: the pipeline before the store that it writes to
        pipeline = make_pipeline(settings, store, events, executor)
        started.push_async_callback(pipeline.stop)
        services = Services(
            settings,
            store,
            events,
            jobs,
            Judges(_baselines(store), fmus=settings.allow_fmus),
            metrics,
            pipeline,
            keys,
            executor,
            notifications.troubles,
        )
        await _tell_start(settings, store)
        # left by a crash
        await asyncio.to_thread(shutil.rmtree, downloads(settings.data), ignore_errors=True)
        for watch in (
            _watch_shelved(store),
            _retain(store, settings),
            watch_loop(metrics.stall),
            _watch_refusals(store, refusals),
        ):
            started.callback(asyncio.create_task(watch).cancel)
        if sqlite_file(settings.database_url) is not None:
            threading.Thread(
                target=_look_for_damage, args=(store,), name="look for damage", daemon=True
            ).start()
        # Beside the start: the registry of units is read with the first unit, and would hold up
        # whoever brings it.
        threading.Thread(target=read_registry, name="read units", daemon=True).start()
        # After the store, the listeners and the workers: its first window uses all of them.
        await pipeline.start()
        # routes are put together at first use, which would hold up whoever asks then
        await asyncio.to_thread(app.openapi)
        started.callback(events.close)
        yield services
    log.info("stopped")


async def _tell_start(settings: Settings, store: DiskStore) -> None:
    """Log which data the service works on, and what a crash has left there."""
    log.info(
        "started",
        database=make_url(settings.database_url).render_as_string(hide_password=True),
        data=str(settings.data),
    )
    orphans = len(await asyncio.to_thread(store.orphans, SETTLED))
    if orphans:
        log.warning(
            "signal blocks that no row names, left by a crash; `residuum doctor --sweep`"
            " removes them",
            blocks=orphans,
        )


def _finding_outs(settings: Settings, keys: ApiKeys) -> list[Any]:
    """The OPC UA server and the Sparkplug edge node that offer the latest findings, started, as far
    as they are set.
    """
    nodes = None
    if settings.opcua_server:
        module = import_module("residuum.service.finding_nodes")
        nodes = module.FindingNodes(settings.opcua_server, module.entrance_of(settings, keys))
        nodes.start()
    finding_node = _sparkplug_findings(settings)
    return [out for out in (nodes, finding_node) if out is not None]


def _sparkplug_findings(settings: Settings) -> Any:
    """The edge node that publishes findings, started; None where none is set. BadSettings without
    its libraries.
    """
    if not settings.sparkplug:
        return None
    try:
        module = import_module("residuum.service.finding_metrics")
    except ModuleNotFoundError:
        raise BadSettings(
            "setting sparkplug: needs the extra `sparkplug`: pip install 'residuum[sparkplug]'"
        ) from None
    node = module.FindingMetrics(settings.broker, settings.sparkplug)
    node.start()
    return node


def _baselines(store: DiskStore) -> Any:
    def newest(name: str) -> tuple[str, bytes]:
        version = store.model_versions(name)[0]
        return f"{version.number}-{version.checksum}", store.model_content(name, version.number)

    return newest


async def _watch_shelved(store: DiskStore) -> None:
    while True:
        await asyncio.sleep(_TICK)
        with suppress(StorageUnavailable):
            await asyncio.to_thread(store.unshelve_expired)


async def _watch_refusals(store: DiskStore, refusals: Refusals) -> None:
    while True:
        await asyncio.sleep(_AUDIT_EVERY)
        await asyncio.to_thread(_audit_refusals, store, refusals)


def _audit_refusals(store: DiskStore, refusals: Refusals) -> None:
    """Into the trail with what was refused; what the database cannot take now is in the log."""
    if refused := refusals.take():
        with suppress(StorageUnavailable):
            store.audit_refusals([(asdict(refusal), times) for refusal, times in refused])


def _look_for_damage(store: DiskStore) -> None:
    """Beside the running service, which ends without waiting for it: a large file takes minutes."""
    with suppress(StorageUnavailable):
        damage = store.look_for_damage()
        if damage is not None:
            log.error("the database is damaged; restore a backup", reason=damage)


async def _retain(store: DiskStore, settings: Settings) -> None:
    rule = Retention(
        settings.keep_days, settings.keep_bytes, settings.keep_row_days, settings.keep_rows
    )
    logged: str | None = None
    while True:
        try:
            freed = await asyncio.to_thread(store.retain, rule)
            if freed:
                log.info("let signals go", windows=freed)
            # A doubt is logged once, not each minute for as long as the clock is wrong.
            doubt = store.troubles().get("retention")
            if doubt not in (None, logged):
                log.error("signals and rows are kept beyond their days", reason=doubt)
            logged = doubt
        except (StorageUnavailable, OSError) as error:
            log.error("signals could not be let go", reason=str(error))
        await asyncio.sleep(_RETAIN_EVERY)


# The latest finding and alarms of every machine, told from the store to who shows only these.

T = TypeVar("T")


class Out(Protocol):
    """Who shows them."""

    def tell(self, kind: str, payload: Mapping[str, Any]) -> None:
        """A finding or an alarm."""


def tell_latest(store: DiskStore, outs: Sequence[Out]) -> None:
    """Tell the latest `finding` of every asset, and of its alarms the `alarm` that changed last;
    StorageUnavailable.
    """
    if not outs:
        return
    # Of what a broker or a server offers, clients see the latest: after a start it would be empty
    # until the next window of each machine.
    assets = _all(store.assets)
    news = [
        ("finding", asset.last_finding.to_json())
        for asset in assets
        if asset.last_finding is not None
    ]
    alarms = sorted(_all(lambda cursor: store.alarms(active=False, cursor=cursor)), key=_changed)
    news += [
        ("alarm", alarm.to_json()) for alarm in {alarm.asset: alarm for alarm in alarms}.values()
    ]
    for out in outs:
        for kind, payload in news:
            out.tell(kind, payload)


def _changed(alarm: Alarm) -> float:
    moments = (alarm.raised_at, alarm.cleared_at, alarm.acknowledged_at)
    return max((moment.timestamp() for moment in moments if moment is not None), default=0.0)


def _all(read: Callable[[str | None], Page[T]]) -> Iterator[T]:
    cursor = None
    while True:
        page = read(cursor)
        yield from page.items
        cursor = page.next_cursor
        if cursor is None:
            return


# How long the event loop is held up: everything that the service answers waits for it.

# A stall of 100 ms, the longest that is allowed (`python -m benchmarks.unit_bombs`), is then seen
# as at least half of it.
TICK = 0.05
"""Seconds between looks."""


async def watch_loop(tell: Callable[[float], None], tick: float = TICK) -> None:
    """Tell again and again by how many seconds a timer of the running loop was late; ends when it
    is cancelled.

    A stall of length s is seen as at least s − `tick`.
    """
    loop = asyncio.get_running_loop()
    while True:
        due = loop.time() + tick
        await asyncio.sleep(tick)
        tell(max(0.0, loop.time() - due))
