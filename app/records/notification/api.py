"""The HTTP API of notification: the state of its addresses, sent messages, a test, maintenance."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Query
from pydantic import ConfigDict, Field
from typing_extensions import TypeAliasType, TypedDict

from app.core.web.access import Engineer, Person
from app.core.web.api import ApiRoute
from app.core.web.services import service
from app.core.web.shape import (
    Instant,
    MaybeInstant,
    MessageShown,
    StrictBody,
    iso,
    maybe_shown,
)
from app.records.notification.outbox import MaintenanceShown, NoticeKind, NotificationDelivery
from app.records.notification.rules import DeliveryState
from app.records.notification.service import (
    BEGIN_MAINTENANCE,
    END_MAINTENANCE,
    MAX_MINUTES,
    SEND_TEST,
    Notification,
    NotificationEndpointShown,
    NotificationGroup,
    RecurringMaintenanceShown,
)
from bus.validation import OneLine

router = APIRouter(prefix="/api/v1/notifications", tags=["alarms"], route_class=ApiRoute)

MAX_DELIVERIES = 200
Notifying = Annotated[Notification, service(Notification)]
MaintenanceReason = Annotated[OneLine, Field(min_length=1, max_length=200)]
MaintenanceMinutes = Annotated[int, Field(ge=1, le=MAX_MINUTES, description="At most a day, 1440.")]
NotificationDeliveryState = TypeAliasType("NotificationDeliveryState", DeliveryState)
NotificationKind = TypeAliasType("NotificationKind", NoticeKind)


class NotificationTestRequest(StrictBody):
    """The address for a test message."""

    endpoint: Annotated[str, Field(max_length=400, description="The key of an address.")]


class MaintenanceRequest(StrictBody):
    """A maintenance of a bus or, without a bus, of everything."""

    model_config = ConfigDict(str_strip_whitespace=True)

    reason: MaintenanceReason
    minutes: MaintenanceMinutes
    bus: Annotated[str | None, Field(max_length=80, description="null: all buses and the server.")] = None


class NotificationShown(TypedDict):
    """The present state of notification."""

    endpoints: list[NotificationEndpointShown]
    groups: list[NotificationGroup]
    maintenance: list[MaintenanceShown]
    recurring: list[RecurringMaintenanceShown]


class NotificationDeliveryShown(TypedDict):
    """A message to one address."""

    id: int
    message_id: Annotated[str, Field(description="The same with every attempt.")]
    endpoint: Annotated[str, Field(description="The key of the address.")]
    state: NotificationDeliveryState
    attempts: Annotated[int, Field(description="How often it was tried, 0 or more.")]
    created_at: Annotated[Instant, Field(description="ISO 8601.")]
    tried_at: Annotated[MaybeInstant, Field(description="The last attempt, ISO 8601; null: there was none.")]
    result: Annotated[MessageShown | None, Field(description="Why it was not delivered; null: no reason.")]
    kinds: Annotated[list[NotificationKind], Field(description="Of its notices; several are a digest.")]
    alarms: Annotated[list[str], Field(description="Ids of the occurrences that it is about.")]


class NotificationDeliveries(TypedDict):
    """Deliveries, newest first. ``next`` is the ``before`` of the next page, null at the end."""

    deliveries: list[NotificationDeliveryShown]
    next: int | None


class NotificationTest(TypedDict):
    """A test message; ``delivery``: null if its first attempt takes longer than 12 s (it goes on)."""

    delivery: NotificationDeliveryShown | None


@router.get("")
async def get_notification(_: Engineer, notification: Notifying) -> NotificationShown:
    """List each address with its last result, the people on duty, and maintenance."""
    return {
        "endpoints": await notification.endpoints(),
        "groups": notification.groups(),
        "maintenance": notification.maintenance.present(),
        "recurring": notification.maintenance.recurring(),
    }


@router.get("/deliveries")
async def get_notification_deliveries(
    _: Engineer,
    notification: Notifying,
    limit: Annotated[int, Query(ge=1, le=MAX_DELIVERIES)] = 100,
    before: Annotated[int | None, Query(ge=1, le=2**62)] = None,
) -> NotificationDeliveries:
    """List the messages that were or will be sent."""
    found = await notification.outbox.deliveries(limit + 1, before)
    following = found[limit - 1].id if len(found) > limit else None
    return {"deliveries": [_delivery(each) for each in found[:limit]], "next": following}


@router.post("/test")
async def send_test_notification(
    person: Annotated[Person, SEND_TEST.permitted], notification: Notifying, body: NotificationTestRequest
) -> NotificationTest:
    """Send a test message like any other message, and wait for its first attempt."""
    delivery = await notification.test(person, body.endpoint)
    return {"delivery": None if delivery is None else _delivery(delivery)}


@router.post("/maintenance")
async def begin_maintenance(
    person: Annotated[Person, BEGIN_MAINTENANCE.permitted], notification: Notifying, body: MaintenanceRequest
) -> list[MaintenanceShown]:
    """Notify nothing for a time. Alarms that are still unacknowledged at its end are notified then."""
    await notification.maintenance.begin(person, body.bus, body.minutes, body.reason)
    return notification.maintenance.present()


@router.post("/maintenance/{maintenance_id}/end")
async def end_maintenance(
    person: Annotated[Person, END_MAINTENANCE.permitted], notification: Notifying, maintenance_id: int
) -> list[MaintenanceShown]:
    """End a maintenance before its time: alarms are notified again."""
    await notification.maintenance.end(person, maintenance_id)
    return notification.maintenance.present()


def _delivery(delivery: NotificationDelivery) -> NotificationDeliveryShown:
    return {
        "id": delivery.id,
        "message_id": delivery.message_id,
        "endpoint": delivery.endpoint,
        "state": delivery.state,
        "attempts": delivery.attempts,
        "created_at": iso(delivery.created_at),
        "tried_at": iso(delivery.tried_at) if delivery.attempts else None,
        "result": maybe_shown(delivery.result),
        "kinds": list(dict.fromkeys(item.kind for item in delivery.items)),
        "alarms": [item.alarm_notice.id for item in delivery.items if item.alarm_notice is not None],
    }
