"""What every kind of receiver is: settings, a name and an address for the outbox, and a way to
deliver.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from fnmatch import fnmatchcase
from typing import Any

from pydantic import BaseModel, ConfigDict, Field

from residuum.service.alarms.alarm_states import Priority

PATIENCE = 5.0
"""Seconds for a receiver's answer."""

Send = Callable[[str, Mapping[str, Any]], str | None]
"""Delivers (kind of event, payload). Gives the number of the work order that was made of it, where
the receiver tells one. Raises OSError when it could not be delivered, and Refused when it never can
be.
"""


class Refused(Exception):
    """A receiver refuses a notification for good; the message says why, without secrets."""


class ReceiverSettings(BaseModel, ABC):
    """One receiver of alarms and floods of them."""

    # the input of a refusal may be a secret
    model_config = ConfigDict(extra="forbid", frozen=True, hide_input_in_errors=True)

    # a class of a kind narrows it to its own word
    kind: str
    name: str = Field(
        "",
        max_length=60,
        pattern=r"^[^\x00-\x1f\x7f]*$",
        description="What log and health call it; empty: its kind and host.",
    )

    machines: tuple[str, ...] = Field(
        (),
        max_length=1000,
        description="Machines whose alarms it is told, as press-1 or hall-1.*; empty: all.",
    )
    priorities: tuple[Priority, ...] = Field(
        (), description="Priorities of which it is told alarms; empty: all, and those of none."
    )

    def wants(self, alarm: Mapping[str, Any]) -> bool:
        """Whether it is told an alarm or a flood; a flood is of the whole plant, and told to all."""
        if "asset" not in alarm:
            return True
        of_machines = any(fnmatchcase(alarm["asset"], name) for name in self.machines)
        return (of_machines or not self.machines) and (
            alarm.get("priority") in self.priorities or not self.priorities
        )

    @property
    def called(self) -> str:
        """Its name, or kind and host: nothing that only its owner may know."""
        return self.name or f"{self.kind} {self.place}"

    @property
    @abstractmethod
    def place(self) -> str:
        """The host, without what is secret."""

    @abstractmethod
    def address(self) -> str:
        """What the outbox knows it by: it stays the same while it is the same receiver, whatever
        its password is.
        """

    @abstractmethod
    def opened(self, public_url: str | None) -> Send:
        """What delivers to it; BadInput for a file of its settings that cannot be used.

        Parameters
        ----------
        public_url : str or None
            Address by which people reach the service's pages.
        """

    @abstractmethod
    def try_connection(self) -> str:
        """How it was reached, in words; nothing is delivered. OSError when it was not."""
