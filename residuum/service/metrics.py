"""Prometheus metrics of one running service."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any

from prometheus_client import CollectorRegistry, Counter, Histogram, generate_latest
from prometheus_client.core import GaugeMetricFamily
from prometheus_client.metrics_core import Metric
from prometheus_client.registry import Collector

from residuum.service.machines.machine_state import counted

# Methods that have a label of their own: a stranger may send any word as a method, and each would
# be kept for ever.
_METHODS = frozenset(("GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS"))
# Around the 100 ms for which the loop may be held up at most (docs/explanation/threat-model.md).
_STALLS = (0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1, 2.5)
# From a short window's score, under a millisecond, to the seconds of a long answer.
_SECONDS = (0.0005, 0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1, 2.5, 10)


class Metrics:
    """Counts requests, windows and alarms, and shows every number of the pipeline's status.

    A registry of its own, so that several services can live in one process (tests).
    """

    def __init__(self, status: Callable[[], Mapping[str, Any]]) -> None:
        self._registry = CollectorRegistry()
        labels = ("method", "route", "status")
        self._requests = Counter(
            "residuum_http_requests", "HTTP requests", labels, registry=self._registry
        )
        self._seconds = Histogram(
            "residuum_http_request_seconds",
            "Time to answer [s]",
            ("route",),
            buckets=_SECONDS,
            registry=self._registry,
        )
        self._findings = Counter(
            "residuum_findings",
            "Windows stored and judged",
            ("asset", "verdict"),
            registry=self._registry,
        )
        self._alarms = Counter(
            "residuum_alarm_changes",
            "Alarms that changed state",
            ("asset", "state"),
            registry=self._registry,
        )
        self._stalls = Histogram(
            "residuum_event_loop_stall_seconds",
            "Times for which the event loop was held up [s]",
            buckets=_STALLS,
            registry=self._registry,
        )
        # label objects by request; bounded, for routes, methods and statuses are
        self._children: dict[tuple[str, str, int], tuple[Counter, Histogram]] = {}
        self._registry.register(_Status(status))

    def request(self, method: str, route: str, status: int, seconds: float) -> None:
        """Count one answered request."""
        # `route` is a pattern of ours and `status` our answer: the method alone is a stranger's
        # word
        method = method if method in _METHODS else "other"
        known = self._children.get((method, route, status))
        if known is None:  # kept, because looking labels up costs more than counting
            known = self._requests.labels(method, route, status), self._seconds.labels(route)
            self._children[method, route, status] = known
        known[0].inc()
        known[1].observe(seconds)

    def event(self, kind: str, payload: Mapping[str, Any]) -> None:
        """Count what the store announces."""
        if kind == "finding":
            self._findings.labels(payload["asset"], payload["verdict"]).inc()
        elif kind == "alarm" and not payload.get("text_alone"):
            self._alarms.labels(payload["asset"], payload["state"]).inc()

    def stall(self, seconds: float) -> None:
        """Count a time for which the event loop was held up."""
        self._stalls.observe(seconds)

    def render(self) -> bytes:
        """The metrics in Prometheus' text format."""
        return generate_latest(self._registry)


class _Status(Collector):
    """Numbers of the pipeline's status: `residuum_machines{state}`, and of each
    `residuum_source{source, name}` and `residuum_machine{machine, name}`.
    """

    def __init__(self, status: Callable[[], Mapping[str, Any]]) -> None:
        self._status = status

    def _by_state(self, machines: Mapping[str, Mapping[str, Any]]) -> Metric:
        family = GaugeMetricFamily("residuum_machines", "Machines in each state", labels=("state",))
        for state, number in counted(machines).items():
            family.add_metric((state,), number)
        return family

    def collect(self) -> Iterator[Metric]:
        """One gauge a kind, with the number's name as a label."""
        status = self._status()
        yield self._by_state(status.get("machines", {}))
        for kind in ("source", "machine"):
            family = GaugeMetricFamily(
                f"residuum_{kind}", f"Numbers of a {kind}", labels=(kind, "name")
            )
            for label, state in _by_name(status.get(f"{kind}s", {})):
                for name, number in _numbers(state):
                    family.add_metric((label, name), number)
            yield family


def _by_name(states: Any) -> Iterator[tuple[str, Mapping[str, Any]]]:
    if isinstance(states, Mapping):
        yield from states.items()
    else:
        yield from ((str(state.get("name", number)), state) for number, state in enumerate(states))


def _numbers(state: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, float]]:
    for name, value in state.items():
        if isinstance(value, Mapping):
            yield from _numbers(value, f"{prefix}{name}.")
        elif isinstance(value, bool | int | float):
            yield f"{prefix}{name}", float(value)
