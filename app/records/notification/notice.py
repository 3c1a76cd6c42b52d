"""What a notification is about, as the outbox keeps it until it is delivered, and what a mail attaches."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import Literal

import msgspec

from app.line.alarms.alarm import Alarm
from app.line.alarms.rules.state_machine import AlarmState
from app.line.conditions.condition import AlarmPriority
from bus.instants import UnixTime
from bus.messages import Message

NoticeKind = Literal["alarm", "clear", "heartbeat", "test", "report"]


class AlarmNotice(msgspec.Struct, frozen=True):
    """An alarm as it was when it was to be notified; times in Unix seconds."""

    id: str
    code: str
    name: Message
    place: str
    """The name of the unit; empty for an alarm of the site."""
    bus: str | None
    unit: int | None
    priority: AlarmPriority
    state: AlarmState
    active: bool
    at: float
    cause: Message
    response: Message
    escalated: bool = False
    """Whether it was not acknowledged within the time of a rule."""


class ReportNotice(msgspec.Struct, frozen=True):
    """A report that is due. ``start`` and ``end`` in Unix seconds; ``first`` and ``last``: these by the clock
    of the site; ``place``: what it is of, for people; ``bus`` None: of the site."""

    every: Literal["shift", "day", "week"]
    start: float
    end: float
    first: str
    last: str
    place: str
    bus: str | None = None
    unit: int | None = None

    @property
    def name(self) -> Message:
        """What it is the report of."""
        return Message.of(f"notify_report_{self.every}", place=self.place, first=self.first, last=self.last)


@dataclass(frozen=True, slots=True)
class OutboxItem:
    """One notice to one address. ``key`` with ``endpoint`` is in the outbox once, whatever happens."""

    key: str
    endpoint: str
    kind: NoticeKind
    created_at: UnixTime
    notice: AlarmNotice | ReportNotice | None = None
    alarm: str = ""
    occurrence: int = 0
    id: int = 0

    @property
    def of_alarm(self) -> AlarmNotice | None:
        """The notice, where it is about an alarm."""
        return self.notice if isinstance(self.notice, AlarmNotice) else None


def notice_of(
    alarm: Alarm, place: str, at: UnixTime, state: AlarmState, occurrence: int, *, escalated: bool = False
) -> AlarmNotice:
    """The notice of an alarm in a state."""
    definition = alarm.definition
    name = definition.name
    return AlarmNotice(
        id=f"{definition.key}.{occurrence}",
        code=definition.code,
        name=name if isinstance(name, Message) else Message.of("alarm_own_text", text=name),
        place=place,
        bus=definition.bus,
        unit=definition.unit,
        priority=definition.priority,
        state=state,
        active=state in ("unack_active", "ack_active"),
        at=float(at),
        cause=definition.record.cause,
        response=definition.record.response,
        escalated=escalated,
    )


@dataclass(frozen=True, slots=True)
class Attachment:
    """A page as a file. ``summary``: lines of the text of the mail."""

    name: str
    page: str
    summary: tuple[Message, ...] = ()


@dataclass(frozen=True, slots=True)
class ReportAttachments:
    """``of`` makes the page of a report; it raises LinesideError where it cannot."""

    of: Callable[[ReportNotice], Awaitable[Attachment]]
