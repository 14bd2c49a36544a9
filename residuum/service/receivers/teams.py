"""Microsoft Teams: an Adaptive Card a change of an alarm, by the webhook of a workflow."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

from residuum.service.receivers.alarm_text import alarm_text
from residuum.service.receivers.http_receiver import HttpReceiver

_CARD = "application/vnd.microsoft.card.adaptive"


class Teams(HttpReceiver):
    """A channel or chat of Microsoft Teams, by the address that the workflow *Send webhook alerts to
    a channel* shows.
    """

    kind: Literal["teams"]

    def body(self, kind: str, payload: Mapping[str, Any], public_url: str | None) -> Any:
        """A message with one Adaptive Card."""
        text = alarm_text(kind, payload, public_url)
        card: dict[str, Any] = {
            "$schema": "http://adaptivecards.io/schemas/adaptive-card.json",
            "type": "AdaptiveCard",
            "version": "1.4",
            "fallbackText": text.title,
            "body": [
                _line({"text": text.title, "weight": "bolder", "size": "medium"}),
                *(
                    _line({"text": f"{name}: ", "weight": "bolder"}, {"text": value})
                    for name, value in text.facts
                ),
            ],
        }
        if text.link:
            card["actions"] = [{"type": "Action.OpenUrl", "title": "Open", "url": text.link}]
        attachment = {"contentType": _CARD, "contentUrl": None, "content": card}
        return {"type": "message", "attachments": [attachment]}


def _line(*runs: dict[str, str]) -> dict[str, Any]:
    # runs of text, for a text block would read `_` and `*` of names as Markdown
    return {"type": "RichTextBlock", "inlines": [{"type": "TextRun", **run} for run in runs]}
