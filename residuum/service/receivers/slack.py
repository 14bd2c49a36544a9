"""Slack: a message of blocks a change of an alarm, by an incoming webhook."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

from residuum.service.receivers.alarm_text import alarm_text
from residuum.service.receivers.http_receiver import HttpReceiver

# Characters of a header and of a field, fields of a section: Slack refuses more.
_HEADER, _FIELD, _FIELDS = 150, 2000, 10


class Slack(HttpReceiver):
    """A channel of Slack, by the address of an incoming webhook."""

    kind: Literal["slack"]

    def body(self, kind: str, payload: Mapping[str, Any], public_url: str | None) -> Any:
        """A message with a header, its facts as fields, and a link."""
        text = alarm_text(kind, payload, public_url)
        header = {"type": "plain_text", "text": text.title[:_HEADER], "emoji": False}
        fields = [
            {"type": "mrkdwn", "text": f"*{_escaped(name)}*\n{_escaped(value)}"[:_FIELD]}
            for name, value in text.facts
        ]
        blocks: list[dict[str, Any]] = [
            {"type": "header", "text": header},
            *(
                {"type": "section", "fields": fields[first : first + _FIELDS]}
                for first in range(0, len(fields), _FIELDS)
            ),
        ]
        if text.link:
            link = {"type": "mrkdwn", "text": f"<{_escaped(text.link)}|Open>"}
            blocks.append({"type": "section", "text": link})
        return {"text": _escaped(text.title), "blocks": blocks}


def _escaped(text: str) -> str:
    """A text that Slack takes for no link and no mention."""
    return text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
