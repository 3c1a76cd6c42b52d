"""The path of notification now: each address, who is on duty, and what is wrong with the roster."""

from __future__ import annotations

from dataclasses import dataclass

from app.notification.endpoints import EndpointKind, NotificationPlan
from app.notification.rules.roster import MINUTES_OF_DAY
from app.notification.service import Notification
from bus.instants import UnixTime
from bus.messages import Message


@dataclass(frozen=True, slots=True)
class EndpointStatus:
    """``works``: whether the last message was delivered; None: none was sent yet."""

    key: str
    kind: EndpointKind
    address: str
    works: bool | None
    tried_at: UnixTime | None
    result: Message | None
    waiting: int


@dataclass(frozen=True, slots=True)
class GroupDuty:
    """A group, who of it is on duty now, and when no one is."""

    name: str
    present: tuple[str, ...]
    gaps: tuple[Message, ...]


async def endpoint_statuses(notification: Notification) -> list[EndpointStatus]:
    """Each address of the configuration."""
    waiting = await notification.outbox.waiting()
    found = []
    for key, endpoint in notification.plan.endpoints.items():
        last = await notification.outbox.last_of(key)
        is_tried = last is not None and last.attempts > 0
        found.append(
            EndpointStatus(
                key=key,
                kind=endpoint.kind,
                address=endpoint.address,
                works=last.state == "delivered" if last is not None and is_tried else None,
                tried_at=last.tried_at if last is not None and is_tried else None,
                result=None if last is None else last.result,
                waiting=waiting.get(key, 0),
            )
        )
    return found


def duties(notification: Notification) -> list[GroupDuty]:
    """Each group of the configuration."""
    local = notification.local_time()
    return [
        GroupDuty(name, roster.on_duty(local), tuple(gap_messages(notification.plan, name)))
        for name, roster in notification.plan.rosters.items()
    ]


def gap_messages(plan: NotificationPlan, group: str) -> list[Message]:
    """Each span of the week in which no one of a group is on duty, in words."""
    return [
        Message.of(
            "notify_roster_gap",
            group=group,
            first_day=Message(f"day_{first // MINUTES_OF_DAY}"),
            first=clock_text(first),
            last_day=Message(f"day_{(end - 1) // MINUTES_OF_DAY}"),
            last=clock_text(end) if end % MINUTES_OF_DAY else "24:00",
        )
        for first, end in plan.rosters[group].gaps()
    ]


def clock_text(minute: int) -> str:
    """390 → ``06:30``; of a week, the time of its day."""
    hours, minutes = divmod(minute % MINUTES_OF_DAY, 60)
    return f"{hours:02}:{minutes:02}"
