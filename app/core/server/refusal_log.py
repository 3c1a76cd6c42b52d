"""The log of refused requests and of errors: one line for the first of its kind, and then the number of those
that followed, once a minute.

A client decides how many requests it sends: a line for each, and more so a traceback, would let it fill the
disk. `Repeats` is pure: times are monotonic and passed in.
"""

from __future__ import annotations

import logging
from collections.abc import Hashable
from dataclasses import dataclass
from typing import Generic, TypeVar

import structlog

from app.core.server.addresses import source_of
from bus.instants import Monotonic, MonotonicClock, monotonic_now

WINDOW_S = 60.0
MAX_KEYS = 100
Item = TypeVar("Item")
_log = structlog.get_logger()
OTHERS = "others"
"""The name of all that are counted together."""
REFUSED = frozenset({400, 401, 403, 408, 413, 414, 415, 417, 421, 429, 431})
"""Statuses for requests that a client may not send or cannot mean; one that mistypes gets others."""
MAX_SHOWN = 100
"""The most characters from a client that are shown."""
_OF_CLIENTS = frozenset(
    {
        "ASGI callable returned without completing handshake.",
        "Invalid UTF-8 sequence received from client.",
        "opening handshake failed",
        "parser failed",
    }
)
"""The loggers' texts about a refused handshake or frame, which is noted here by its address."""


@dataclass(frozen=True, slots=True)
class Repetition(Generic[Item]):
    """The repetitions since the last note: ``count`` of them, the last being ``item``. ``is_of_others``:
    whether several keys are counted together."""

    item: Item
    count: int
    is_of_others: bool


@dataclass(slots=True)
class _Window(Generic[Item]):
    item: Item
    since: Monotonic
    count: int = 0


class Repeats(Generic[Item]):
    """A counter of the items that follow the first of each key, a minute at a time. Beyond ``max_keys`` keys
    all others count as one."""

    def __init__(self, max_keys: int = MAX_KEYS) -> None:
        self._max_keys = max_keys
        self._windows: dict[Hashable, _Window[Item]] = {}

    def note(self, key: Hashable, item: Item, now: Monotonic) -> Repetition[Item] | None:
        """Return ``item`` if it is the first of its key for a minute; otherwise count it and return None."""
        if key not in self._windows and len(self._windows) >= self._max_keys:
            key = None
        window = self._windows.get(key)
        if window is None:
            self._windows[key] = _Window(item, now)
            return Repetition(item, 1, key is None)
        window.item = item
        window.count += 1
        return None

    def take_counted(self, now: Monotonic, *, everything: bool = False) -> list[Repetition[Item]]:
        """Return the repetitions of each key for each minute that has passed, or with ``everything`` for all;
        a minute without any is forgotten."""
        found = []
        for key, window in list(self._windows.items()):
            if not everything and now - window.since < WINDOW_S:
                continue
            del self._windows[key]
            if window.count:
                found.append(Repetition(window.item, window.count, key is None))
                self._windows[key] = _Window(window.item, now)
        return found


class RefusalLog:
    """The log of refused requests, by the address of the client."""

    def __init__(self, now: MonotonicClock = monotonic_now) -> None:
        self._now = now
        self._repeats = Repeats[str]()

    def note(self, address: str, reason: str, request: str = "") -> None:
        """Count one more refusal. ``request``: its path, of which the first is shown."""
        source = source_of(address)
        if self._repeats.note(source, source, self._now()):
            _log.warning("request refused", address=source, reason=reason, request=request[:MAX_SHOWN])

    def sum_up(self) -> None:
        """Log the numbers of the minutes that have passed; to be called about once a second."""
        for each in self._repeats.take_counted(self._now()):
            source = OTHERS if each.is_of_others else each.item
            _log.warning(f"refused {each.count:,} requests from {source} in the last minute")


class ErrorLines(logging.Handler):
    """The log handler of the errors that uvicorn and asyncio report, each once a minute: a failure of ours
    with its traceback, one that a client has caused without."""

    def __init__(self, now: MonotonicClock = monotonic_now) -> None:
        super().__init__(logging.ERROR)
        self._now = now
        self._repeats = Repeats[str]()

    def emit(self, record: logging.LogRecord) -> None:
        text = record.getMessage().partition("\n")[0].strip()
        error = record.exc_info[1] if record.exc_info else None
        place = f"{text} {_place_of(error)}".strip()
        if text not in _OF_CLIENTS and self._repeats.note(place, place, self._now()):
            _log.error(text, exc_info=error)

    def install(self) -> None:
        """Make this the only handler of the loggers of uvicorn and asyncio."""
        for name in ("uvicorn", "asyncio"):
            logger = logging.getLogger(name)
            logger.handlers, logger.propagate = [self], False

    def sum_up(self) -> None:
        """Log how often each text came in the minutes that have passed."""
        for each in self._repeats.take_counted(self._now()):
            text = OTHERS if each.is_of_others else each.item
            _log.error(f"{each.count:,} times more in the last minute: {text}")


def _place_of(error: BaseException | None) -> str:
    """Return the place at which an exception was raised."""
    trace = error.__traceback__ if error else None
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    where = "" if trace is None else f"{trace.tb_frame.f_code.co_qualname}:{trace.tb_lineno}"
    return f"{type(error).__name__} in {where}" if error else ""
