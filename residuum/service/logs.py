"""Structured logs: one event a line, for people or as JSON."""

from __future__ import annotations

import logging
import sys

import structlog

from residuum.service.settings import Settings


def set_up_logs(settings: Settings) -> None:
    """Send log lines of ours to standard error, in the chosen form and from the chosen severity on."""
    form = structlog.processors.JSONRenderer() if settings.log_format == "json" else structlog.dev.ConsoleRenderer(colors=False)
    structlog.configure(
        processors=[
            structlog.contextvars.merge_contextvars,
            structlog.processors.add_log_level,
            structlog.processors.TimeStamper(fmt="iso", utc=True),
            structlog.processors.format_exc_info,
            form,
        ],
        wrapper_class=structlog.make_filtering_bound_logger(getattr(logging, settings.log_level.upper())),
        logger_factory=lambda *_: structlog.PrintLogger(sys.stderr),  # looked up a line: standard error may be redirected later
        cache_logger_on_first_use=False,
    )
