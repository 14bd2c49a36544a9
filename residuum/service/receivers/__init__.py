"""Receivers of alarms: webhooks, e-mail, Microsoft Teams, Slack.

A new kind is one file with a `ReceiverSettings` whose `kind` is its word, and one line in
`RECEIVERS`: settings, refusals, notifications, `doctor` and the reference take the kinds from
there.
"""

from __future__ import annotations

from functools import reduce
from operator import or_
from typing import TYPE_CHECKING, Annotated, get_args

from pydantic import Field

from residuum.service.receivers.email_receiver import Email
from residuum.service.receivers.receiver_settings import ReceiverSettings
from residuum.service.receivers.slack import Slack
from residuum.service.receivers.teams import Teams
from residuum.service.receivers.webhook import Webhook

RECEIVERS: dict[str, type[ReceiverSettings]] = {
    get_args(of_kind.model_fields["kind"].annotation)[0]: of_kind
    for of_kind in (
        Webhook,
        Email,
        Teams,
        Slack,
    )
}
"""Kind of a receiver → its settings, which say how it is told."""

if TYPE_CHECKING:
    AnyReceiver = ReceiverSettings
else:  # mypy takes no names that are not written here; a new kind is one line in `RECEIVERS`
    AnyReceiver = Annotated[reduce(or_, RECEIVERS.values()), Field(discriminator="kind")]
