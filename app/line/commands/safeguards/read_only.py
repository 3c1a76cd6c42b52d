"""A read-only bus: it is sent no command but one that makes it slower, for a time or until an administrator
ends that: who is at the line then, and may not end it, can still slow it down."""

from __future__ import annotations

import math
from dataclasses import astuple, dataclass

from app.core.database import Database
from app.core.database.connection import upsert
from app.core.web.admission.access import account_shown
from bus.instants import Monotonic, UnixTime
from bus.messages import Message

MAX_READ_ONLY_MINUTES = 7 * 24 * 60
"""Longer is for the role of an account, or for the configuration."""
_COLUMNS = ("reason", "set_by", "set_at", "until")


@dataclass(frozen=True, slots=True)
class ReadOnly:
    """Why a bus is read-only, set by whom and when, and until when: None for no end. Unix times."""

    reason: str
    set_by: str
    set_at: UnixTime
    until: UnixTime | None = None

    def refusal(self) -> Message:
        """Why a command is not sent to the bus."""
        return Message.of("bus_read_only", who=account_shown(self.set_by), reason=self.reason)


class ReadOnlyStore:
    """Whether one bus is read-only: read once, written through. Its duration is of the monotonic clock: one
    that is set neither ends nor prolongs it."""

    def __init__(self, database: Database, bus: str) -> None:
        self._database = database
        self._bus = bus
        self._set: ReadOnly | None = None
        self._ends_at = Monotonic(math.inf)

    async def load(self, now: UnixTime, monotonic: Monotonic) -> None:
        """Load from the database; once, before the first command."""
        query = f"SELECT {', '.join(_COLUMNS)} FROM read_only WHERE bus = ?"
        rows = await self._database.read(lambda store: store.execute(query, (self._bus,)).fetchall())
        self._keep(ReadOnly(*rows[0]) if rows else None, now, monotonic)

    def of(self, monotonic: Monotonic) -> ReadOnly | None:
        """The mode while it lasts, or None."""
        return self._set if monotonic < self._ends_at else None

    def left_s(self, monotonic: Monotonic) -> float:
        """Seconds of its duration that are left; infinite where it has none, 0 where it is not set."""
        return 0.0 if self._set is None else max(self._ends_at - monotonic, 0.0)

    async def put(self, mode: ReadOnly, monotonic: Monotonic) -> None:
        """Begin, or give another reason and time."""
        statement = upsert("read_only", ["bus"], list(_COLUMNS))
        row = self._bus, *astuple(mode)
        await self._database.write(lambda store: store.execute(statement, row))
        self._keep(mode, mode.set_at, monotonic)

    async def end(self) -> None:
        delete = "DELETE FROM read_only WHERE bus = ?"
        await self._database.write(lambda store: store.execute(delete, (self._bus,)))
        self._set = None

    def _keep(self, mode: ReadOnly | None, now: UnixTime, monotonic: Monotonic) -> None:
        self._set = mode
        lasts_s = math.inf if mode is None or mode.until is None else mode.until - now
        self._ends_at = monotonic + lasts_s
