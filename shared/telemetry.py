"""Structured logs with a correlation id that follows a cycle through every service."""

from __future__ import annotations

import contextlib
import logging
import re
import sys
import uuid
from contextvars import ContextVar
from typing import Any, TextIO, cast

import structlog

CORRELATION_HEADER = "X-Correlation-ID"
correlation_id: ContextVar[str] = ContextVar("correlation_id", default="")
_ALLOWED = re.compile(r"^[A-Za-z0-9._:+-]{1,128}$")


def new_correlation_id() -> str:
    """A fresh id for a request that came without one."""
    return uuid.uuid4().hex


def accept_correlation_id(offered: str | None) -> str:
    """The offered id if it is a harmless word, else a fresh one: what enters the log must not forge lines."""
    return offered if offered and _ALLOWED.fullmatch(offered) else new_correlation_id()


class _UnfailingStream:
    """Standard error, but a line that cannot be written (a full disk, a closed pipe) is lost instead of raising.

    Log lines are written where faults are handled; an error of their own would take the thread down with it.
    """

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def write(self, text: str) -> int:
        with contextlib.suppress(OSError, ValueError):
            return self._stream.write(text)
        return 0

    def flush(self) -> None:
        with contextlib.suppress(OSError, ValueError):
            self._stream.flush()


def configure_logging(service: str, level: str = "INFO") -> None:
    """One JSON object a line on standard error, with service, time, level and correlation id."""

    def add_context(_: Any, __: str, event: structlog.typing.EventDict) -> structlog.typing.EventDict:
        event["service"] = service
        if correlation_id.get():
            event["correlation_id"] = correlation_id.get()
        return event

    structlog.configure(
        processors=[
            structlog.processors.add_log_level,
            structlog.processors.TimeStamper(fmt="iso", utc=True),
            add_context,
            structlog.processors.format_exc_info,
            structlog.processors.JSONRenderer(sort_keys=True),
        ],
        wrapper_class=structlog.make_filtering_bound_logger(logging.getLevelName(level)),
        logger_factory=structlog.PrintLoggerFactory(file=cast(TextIO, _UnfailingStream(sys.stderr))),
    )


def logger() -> Any:
    """The logger; configure_logging decides what becomes of its lines."""
    return structlog.get_logger()
