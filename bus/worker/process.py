"""The set-up that every process of the program shares: its log, and that a child ends with its parent."""

from __future__ import annotations

import ctypes
import io
import logging
import os
import signal
import sys
from contextlib import suppress
from typing import TextIO, cast

import structlog
from structlog.typing import EventDict, WrappedLogger

from bus.validation import escaped


class BestEffortStream(io.TextIOBase):
    """A stream that drops log lines that cannot be written (disk full, pipe closed): the log never stops the
    line."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def write(self, text: str) -> int:
        with suppress(OSError, ValueError):
            self._stream.write(text)
        return len(text)

    def flush(self) -> None:
        with suppress(OSError, ValueError):
            self._stream.flush()


def without_escapes(_logger: WrappedLogger, _method: str, event: EventDict) -> EventDict:
    """Return a log event with escaped texts: a terminal would obey control codes that a client sent."""
    return {name: escaped(value) if isinstance(value, str) else value for name, value in event.items()}


def configure_log() -> None:
    """Log to standard error: for people on a terminal, otherwise one JSON object a line."""
    renderers = (
        [without_escapes, structlog.dev.ConsoleRenderer()]
        if sys.stderr.isatty()
        else [structlog.processors.JSONRenderer()]
    )
    structlog.configure(
        processors=[
            structlog.contextvars.merge_contextvars,
            structlog.processors.add_log_level,
            structlog.processors.TimeStamper(fmt="iso", utc=True),
            structlog.processors.format_exc_info,
            *renderers,
        ],
        wrapper_class=structlog.make_filtering_bound_logger(logging.INFO),
        logger_factory=structlog.PrintLoggerFactory(cast(TextIO, BestEffortStream(sys.stderr))),
        cache_logger_on_first_use=True,
    )


PARENT = "LINESIDE_PARENT"
"""The environment variable that names the parent of a child process."""
_PR_SET_PDEATHSIG = 1


def tied_environment() -> dict[str, str]:
    """Return the environment for a child of this process."""
    return {**os.environ, PARENT: str(os.getpid())}


def named_parent() -> int | None:
    """Return the parent process id from the environment, and remove it there so that no child inherits it."""
    named = os.environ.pop(PARENT, "")
    return int(named) if named.isdecimal() else None


def tie_to(parent: int) -> None:
    """End this process by SIGTERM when ``parent`` ends; at once if it has ended. Call this first of all."""
    if sys.platform != "linux":
        return
    ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM, 0, 0, 0)
    if os.getppid() != parent:
        raise SystemExit(1)
