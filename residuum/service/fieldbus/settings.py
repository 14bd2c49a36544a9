"""What is to be watched: machines, the buses that carry their signals, and how windows are cut."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Literal

from pydantic import Field, model_validator

from residuum.library.questions import field
from residuum.service.alarms.alarm_states import AlarmRule
from residuum.service.fieldbus import SOURCES
from residuum.service.fieldbus.strict_model import StrictModel

MAPS = Path(__file__).parent / "maps"


KINDS = {name: kind.called for name, kind in SOURCES.items()}
"""Kind of a source → how people call it."""
_BY_HOST = ({"kind": [name for name, kind in SOURCES.items() if kind.by_host]},)
_BY_CHANNEL = ({"kind": [name for name, kind in SOURCES.items() if not kind.by_host]},)
_EXAMPLES = ", ".join(
    f"{name} {kind.example}" for name, kind in SOURCES.items() if not kind.by_host
)
if TYPE_CHECKING:
    Kind = str
else:  # mypy takes no names that are not written here; a new kind is one line in `SOURCES`
    Kind = Literal[*SOURCES]


def map_file(name: str) -> Path:
    """The DBC file or register map of this name: one that comes with Residuum, or a file."""
    built_in = MAPS / name
    return built_in if "/" not in name and built_in.is_file() else Path(name)


class SourceSettings(StrictModel):
    """One bus connection.

    `can` needs `channel` (`socketcan:can0`, `udp_multicast:239.74.163.2:43113`, `virtual:bench`)
    and a DBC file; `modbus` needs `host`, `port` and a register map; `opcua` needs `channel`
    (`opc.tcp://host:4840`) and a node map; `sparkplug` needs `channel`
    (`mqtt[s]://[user:password@]broker[:port]`) and a metric map; `mqtt` the same and a topic map;
    `file` needs `channel`
    (`file:/var/log/machine.csv`) and a column map. `map` is a file, or the name of one that comes
    with Residuum.
    """

    kind: Kind = Field(json_schema_extra={"x-titles": dict(KINDS)})
    map: str
    channel: str = field(
        "",
        f"Address of the bus: {_EXAMPLES}.",
        only_with=_BY_CHANNEL,
    )
    host: str = field("127.0.0.1", "Address of the device.", only_with=_BY_HOST)
    port: int = field(502, "Port of the device.", only_with=_BY_HOST, ge=1, le=65535)

    @model_validator(mode="after")
    def _complete(self) -> SourceSettings:
        SOURCES[self.kind].check(self)  # raises where it is no address of this kind
        return self

    @property
    def map_file(self) -> Path:
        """The DBC file or register map."""
        return map_file(self.map)


class WindowSettings(StrictModel):
    """How the streams are cut into windows.

    `movement`: from the phase signal's leaving 0 to its return. `round`: from the first of four
    indicator pulses to the next one like it. `sliding`: `length` seconds every `step` seconds.
    """

    cut: Literal["movement", "round", "sliding"]
    length: float = Field(
        default=60.0, gt=0, le=3600, description="Length of a sliding window [s]."
    )
    step: float = Field(
        default=10.0, gt=0, le=3600, description="From one sliding window to the next [s]."
    )


class SecondOpinion(StrictModel):
    """Who else judges the windows of a machine: its findings are shown beside the first one's and
    raise no alarm.
    """

    diagnoser: Literal["model-based"] = "model-based"
    model: str = Field(description="The machine's model, stored, built in, or a file.")
    baseline: str | None = Field(
        default=None, description="Name of its trained baseline; None: the asset's, with `.second`."
    )


class MachineSettings(StrictModel):
    """One machine: its name (the asset), the diagnoser that judges it, its windows, sources and
    alarm rule.
    """

    asset: str = Field(min_length=1, max_length=64, pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*$")
    diagnoser: str
    window: WindowSettings
    sources: list[SourceSettings] = Field(min_length=1)
    baseline: str | None = Field(
        default=None, description="Name of the trained baseline; None: the asset's own."
    )
    model: str | None = Field(
        default=None,
        description=(
            "model-based: the machine's model, a file or a built-in name; its baseline has it too."
        ),
    )
    channels: dict[str, str] = Field(
        default={},
        max_length=100,
        description=(
            "Names of signals: the one that the diagnoser or its model uses → the one on the bus."
        ),
    )
    second: SecondOpinion | None = Field(
        default=None, description="A second opinion on every window; None: none."
    )
    method: Literal["source", "default"] | None = Field(
        default=None,
        description=(
            "gate-actuator, robust-residual: what decides; None: what the baseline was trained"
            " with."
        ),
    )
    alarms: AlarmRule | None = Field(
        default=None,
        description="Rule of its alarms; None: that of the service.",
    )

    def alarm_rule(self, of_service: AlarmRule) -> AlarmRule:
        """The rule of its alarms, its own or that of the service, with its signals called as the
        machine's windows call them.
        """
        rule = self.alarms or of_service
        called = {bus: name for name, bus in self.channels.items()}
        states = [
            state.model_copy(update={"signal": called.get(state.signal, state.signal)})
            for state in rule.suppress
        ]
        return rule.model_copy(update={"suppress": tuple(states)})

    @model_validator(mode="after")
    def _each_channel_once(self) -> MachineSettings:
        if len(set(self.channels.values())) < len(self.channels):
            twice = next(
                bus for bus in self.channels.values() if list(self.channels.values()).count(bus) > 1
            )
            raise ValueError(f"channels: {twice!r} of the bus has two names")
        return self

    @model_validator(mode="after")
    def _model_where_one_is_used(self) -> MachineSettings:
        if self.model is not None and self.diagnoser != "model-based":
            raise ValueError(
                f"model: only the diagnoser model-based has one, not {self.diagnoser!r}"
            )
        return self
