"""Maintenance: a time in which nothing of a bus, or of the site, is notified."""

from __future__ import annotations

from app.alarms.notification.rules.notices import QuietSpan
from app.alarms.notification.store import NotificationStore, QuietRow, quiet_beginning, quiet_ending
from app.audit.log import EventLog
from app.errors import Problem
from app.web.access import Person
from bus.instants import Clock, unix_now
from bus.messages import Message

MINUTE_S = 60
MOST_MINUTES = 1440
"""A day: it is begun again by who still needs it."""


class Maintenance:
    """``rows``: those of the last weeks, as an alarm may count its times from the end of one."""

    def __init__(self, store: NotificationStore, events: EventLog, clock: Clock = unix_now) -> None:
        self._store = store
        self._events = events
        self._clock = clock
        self.rows: list[QuietRow] = []

    async def load(self) -> None:
        """Once at start."""
        self.rows = await self._store.quiet(self._clock())

    def spans(self) -> list[QuietSpan]:
        """The times in which nothing is notified."""
        return [row.span for row in self.rows]

    def present(self) -> list[QuietRow]:
        """Those under way."""
        now = self._clock()
        return [row for row in self.rows if row.span.starts <= now < row.span.ends]

    async def begin(self, person: Person, bus: str | None, minutes: int, reason: str) -> None:
        """From now on, of a bus or (None) of everything."""
        now = self._clock()
        span = QuietSpan(now, now + minutes * MINUTE_S, bus)
        await self._events.record(
            kind="notification",
            who=person.name,
            origin=person.via,
            bus=bus,
            what=Message.of("event_maintenance_begun", n=minutes),
            message=reason,
            also=quiet_beginning(span, person.name, reason),
        )
        await self.load()

    async def end(self, person: Person, id: int) -> None:
        """Before its time. Raises Problem 404 for one that is not under way."""
        row = next((row for row in self.present() if row.id == id), None)
        if row is None:
            raise Problem(404, "not_found", Message("maintenance_not_present"))
        await self._events.record(
            kind="notification",
            who=person.name,
            origin=person.via,
            bus=row.span.bus,
            what=Message("event_maintenance_ended"),
            message=row.reason,
            also=quiet_ending(id, self._clock()),
        )
        await self.load()
