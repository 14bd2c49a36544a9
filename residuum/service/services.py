"""What a request can reach: the parts of the running service, handed to the HTTP routes by the app."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Protocol

from fastapi import Depends, Request

from residuum.service.alarms.events import Events
from residuum.service.machines.judges import Judges
from residuum.service.metrics import Metrics
from residuum.service.security.access import ANYBODY, ApiKeys, Caller
from residuum.service.settings import Settings
from residuum.service.store import Store
from residuum.service.work.jobs import Jobs


class LivePipeline(Protocol):
    """The part that reads buses and has windows scored (`residuum.service.machines.pipeline.Pipeline`)."""

    async def start(self) -> None:
        """Begin to read; returns at once, training and connecting go on beside."""

    async def stop(self) -> None:
        """Stop reading, keep what is in flight."""

    def status(self) -> dict[str, Any]:
        """State of every machine and source, with every loss counter."""

    def faults(self, machine: str) -> Mapping[str, Any]:
        """The faults a demo machine has, and which are on."""

    async def switch_fault(self, machine: str, fault: str, size: float | None) -> None:
        """Switch a fault of a demo machine on (size None: its default), or off (fault `none`, or size 0)."""


@dataclass(frozen=True)
class Services:
    """The running service."""

    settings: Settings
    store: Store
    events: Events
    jobs: Jobs
    judges: Judges
    metrics: Metrics
    pipeline: LivePipeline
    keys: ApiKeys


def caller_of(request: Request) -> Caller:
    """Who sent a request that the gate has let in."""
    caller: Caller = getattr(request.state, "caller", ANYBODY)
    return caller


async def _services(request: Request) -> Services:
    """The services of the app that got the request (async: a plain function would cost a thread)."""
    services: Services = request.app.state.services
    return services


Running = Annotated[Services, Depends(_services)]
