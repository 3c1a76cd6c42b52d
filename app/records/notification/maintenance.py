"""Maintenance: a time in which nothing of a bus, or of the site, is notified."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import date, datetime, timedelta
from functools import partial
from typing import Annotated
from zoneinfo import ZoneInfo

from pydantic import Field
from typing_extensions import TypeAliasType

from app.core.web.admission.access import Person
from app.core.web.api.shape import InstantObject
from app.core.web.services import unknown_bus
from app.errors import Problem
from app.people.audit.log import EventLog
from app.records.notification.acts import BEGIN_MAINTENANCE, END_MAINTENANCE
from app.records.notification.outbox import (
    MAX_AGE_S,
    MaintenanceShown,
    NotificationStore,
    begin_quiet,
    end_quiet,
)
from app.records.notification.rules.notices import QuietSpan
from app.records.notification.rules.recurring import recurring_spans
from app.records.notification.settings import DAYS, DayOfWeek, MaintenanceSettings
from bus.instants import Clock, UnixTime, unix_now
from bus.messages import Message

DayOfWeekShown = TypeAliasType("DayOfWeekShown", DayOfWeek)
MINUTE_S = 60
MAX_MINUTES = 1440
"""A day: it is begun again by who still needs it."""
_AHEAD = timedelta(days=14)
"""On each day of the week twice: one of them may be skipped with the clocks."""


@dataclass(frozen=True, slots=True)
class RecurringMaintenanceShown:
    """A recurring maintenance of the configuration; times by the clock of the site."""

    days: Annotated[list[DayOfWeekShown], Field(description="On which it begins.")]
    starts: Annotated[str, Field(description="Local time, such as 22:00.")]
    ends: Annotated[str, Field(description="Local time; not after starts: on the next day.")]
    last_day: Annotated[str, Field(description="The last day on which it begins, ISO 8601.")]
    buses: Annotated[list[str], Field(description="Empty: all buses and the server.")]
    reason: str
    present: Annotated[bool, Field(description="Whether it is under way.")]
    since: Annotated[InstantObject | None, Field(description="Of the present or next one; null: no more.")]
    until: Annotated[InstantObject | None, Field(description="Its end, ISO 8601; null: no more.")]


class Maintenance:
    """``rows``: those of the last weeks, as an alarm may count its times from the end of one; ``recurring``:
    those of the configuration, by the clock of ``zone``; ``buses``: the names of all."""

    def __init__(
        self,
        store: NotificationStore,
        events: EventLog,
        recurring: Sequence[MaintenanceSettings],
        zone: ZoneInfo,
        buses: Sequence[str],
        clock: Clock = unix_now,
    ) -> None:
        self._store = store
        self._events = events
        self._recurring = recurring
        self._zone = zone
        self._buses = buses
        self._clock = clock
        self._spans_of: tuple[date, list[QuietSpan]] | None = None
        self.rows: list[MaintenanceShown] = []

    async def load(self) -> None:
        """Read the stored maintenance; once at start."""
        self.rows = await self._store.quiet(self._clock())

    def spans(self) -> list[QuietSpan]:
        """The times in which nothing is notified."""
        return [*(row.span for row in self.rows), *self._recurring_spans()]

    def recurring(self) -> list[RecurringMaintenanceShown]:
        """Each recurring maintenance as it is now, with the span that is under way or comes next."""
        return [self._shown(each, self._clock()) for each in self._recurring]

    def present(self) -> list[MaintenanceShown]:
        """The maintenance that is under way, begun by people."""
        now = self._clock()
        return [row for row in self.rows if row.since <= now < row.until]

    def _shown(self, recurring: MaintenanceSettings, now: UnixTime) -> RecurringMaintenanceShown:
        day = self._day(now)
        spans = recurring_spans(recurring, day - timedelta(days=1), day + _AHEAD, self._zone)
        span = next((span for span in spans if now < span.ends), None)
        return RecurringMaintenanceShown(
            days=[day for day in DAYS if day in recurring.days],
            starts=recurring.starts,
            ends=recurring.ends,
            last_day=recurring.until.isoformat(),
            buses=list(recurring.buses),
            reason=recurring.reason,
            present=span is not None and span.starts <= now,
            since=None if span is None else span.starts,
            until=None if span is None else span.ends,
        )

    def _recurring_spans(self) -> list[QuietSpan]:
        """The spans are found once a day: notification looks at them each second."""
        day = self._day(self._clock())
        if self._spans_of is None or self._spans_of[0] != day:
            first = day - timedelta(seconds=MAX_AGE_S)
            spans = (recurring_spans(each, first, day, self._zone) for each in self._recurring)
            self._spans_of = day, [span for several in spans for span in several]
        return self._spans_of[1]

    def _day(self, at: UnixTime) -> date:
        return datetime.fromtimestamp(float(at), self._zone).date()

    async def begin(self, person: Person, bus: str | None, minutes: int, reason: str) -> None:
        """Notify nothing from now on, of a bus or (None) of all. Raises Problem 403, 404."""
        BEGIN_MAINTENANCE.check(person)
        if bus is not None and bus not in self._buses:
            raise unknown_bus(bus, self._buses)
        now = self._clock()
        span = QuietSpan(now, now + minutes * MINUTE_S, bus)
        await self._events.record(
            **BEGIN_MAINTENANCE.by(person, n=minutes),
            bus=bus,
            message=reason,
            also=partial(begin_quiet, span=span, who=person.name, reason=reason),
        )
        await self.load()

    async def end(self, person: Person, id: int) -> None:
        """End a maintenance before its time. Raises Problem 403, 404 for one that is not under way."""
        END_MAINTENANCE.check(person)
        row = next((row for row in self.present() if row.id == id), None)
        if row is None:
            raise Problem(404, "not_found", Message("maintenance_not_present"))
        await self._events.record(
            **END_MAINTENANCE.by(person),
            bus=row.bus,
            message=row.reason,
            also=partial(end_quiet, id=id, now=self._clock()),
        )
        await self.load()
