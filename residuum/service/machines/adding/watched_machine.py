"""A machine as somebody adds it to the running service: its settings, and the bus descriptions that its sources name."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, Field, StringConstraints

from residuum.service.alarms.alarm_rules import AlarmRule
from residuum.service.fieldbus.settings import MachineSettings, SecondOpinion, SourceSettings, WindowSettings

Text = Annotated[str, StringConstraints(min_length=1, max_length=200)]


class WatchedMachine(BaseModel, extra="forbid"):
    """What is watched, where it is read, how it is cut into windows, and who judges."""

    diagnoser: str = Field(max_length=64)
    window: WindowSettings
    sources: list[SourceSettings] = Field(min_length=1, max_length=8)
    channels: dict[Text, Text] = Field({}, max_length=100, description="Diagnoser's name of a signal → the bus's.")
    model: Text | None = Field(None, description="model-based: a stored or a built-in model.")
    second: SecondOpinion | None = None
    alarms: AlarmRule | None = None
    maps: dict[Text, Annotated[str, StringConstraints(max_length=2**20)]] = Field(
        {}, max_length=8, description="Texts of the DBC files and register maps that the sources name."
    )

    def settings(self, asset: str) -> MachineSettings:
        """The settings, as a file would have them; ValueError when they contradict each other."""
        return MachineSettings(asset=asset, **self.model_dump(exclude={"maps"}))
