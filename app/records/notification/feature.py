"""The feature of notification: its page, and the page of the link in a message."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Annotated
from zoneinfo import ZoneInfo

from fastapi import APIRouter, Depends, Form, Query
from starlette.requests import Request
from starlette.responses import RedirectResponse, Response

from app.core.database import Database
from app.core.web.access import Engineer, Person, Viewer
from app.core.web.routes import GuardedRoute
from app.core.web.templating import Templates, render
from app.feature import Feature, Services
from app.line.alarms.acts import ACKNOWLEDGE
from app.line.alarms.api import Alarms
from app.line.alarms.line_alarms import LineAlarms, SiteAlarms
from app.line.conditions.catalogue import NOTIFICATION_FAILED
from app.people.audit.log import EventLog
from app.records.notification import api
from app.records.notification.api import Notifying
from app.records.notification.compose import AcknowledgeLinks, Composer
from app.records.notification.dispatcher import Dispatcher, subject_of
from app.records.notification.outbox import NotificationOutbox, ReportAttachments
from app.records.notification.rules import NotificationPlan
from app.records.notification.senders import Senders
from app.records.notification.service import (
    ACTS,
    BEGIN_MAINTENANCE,
    END_MAINTENANCE,
    MAX_MINUTES,
    SEND_TEST,
    AlarmNotifier,
    Maintenance,
    Notification,
)
from app.records.notification.settings import DAYS
from bus.messages import Message
from bus.validation import OneLine

router = APIRouter(include_in_schema=False, route_class=GuardedRoute)

SEE_OTHER = 303
ON_A_PAGE = 50


async def linked_alarm(
    notification: Notifying,
    alarm: Annotated[str, Query(max_length=300)],
    until: Annotated[int, Query(ge=0, le=2**62)],
    signature: Annotated[str, Query(max_length=100)],
) -> str:
    """Return the alarm id of a link. Raise Problem 403 if this dashboard did not make the link."""
    notification.links.check(alarm, until, signature)
    return alarm


LinkedAlarm = Annotated[str, Depends(linked_alarm)]


@router.get("/notifications")
async def notification_page(
    request: Request,
    _: Engineer,
    notification: Notifying,
    before: Annotated[int | None, Query(ge=1, le=2**62)] = None,
    endpoint: Annotated[str, Query(max_length=400)] = "",
    state: Annotated[str, Query(max_length=20)] = "",
    tested: Annotated[int | None, Query(ge=0, le=2**62)] = None,
) -> Response:
    """Show the state of notification, the people on duty, maintenance, and the sent messages: all, or those
    of an ``endpoint`` or a ``state``. ``tested``: the test message just sent, or 0 without a result."""
    return await _page(request, notification, before, endpoint, state, tested)


async def _page(
    request: Request,
    notification: Notification,
    before: int | None = None,
    endpoint: str = "",
    state: str = "",
    tested: int | None = None,
    refused: Mapping[str, object] = MappingProxyType({}),
) -> Response:
    """Show the page of notification; ``refused``: the texts of the maintenance form, and its ``fault``."""
    found = await notification.outbox.deliveries(ON_A_PAGE + 1, before, endpoint=endpoint, state=state)
    addresses = {key: each.address for key, each in notification.plan.endpoints.items()}
    return render(
        request,
        "notification/page.html",
        status=422 if refused else 200,
        refused=refused,
        endpoints=await notification.endpoints(),
        groups=notification.groups(),
        maintenance=notification.maintenance.present(),
        recurring=notification.maintenance.recurring(),
        days={day: Message(f"day_{number}") for number, day in enumerate(DAYS)},
        buses=notification.maintenance.buses,
        has_url=notification.plan.settings.dashboard_url is not None,
        deliveries=[
            (each, addresses.get(each.endpoint, each.endpoint), subject_of(each))
            for each in found[:ON_A_PAGE]
        ],
        older=found[ON_A_PAGE - 1].id if len(found) > ON_A_PAGE else None,
        before=before,
        tested=tested,
        chosen={"endpoint": endpoint, "state": state},
    )


@router.post("/notifications/test")
async def send_test(
    person: Annotated[Person, SEND_TEST.permitted],
    notification: Notifying,
    endpoint: Annotated[str, Form(max_length=400)],
) -> Response:
    """Send a test message; the page then shows its result."""
    delivery = await notification.test(person, endpoint)
    return _to_page(f"?tested={delivery.id if delivery else 0}")


@router.post("/notifications/maintenance")
async def begin_maintenance(
    request: Request,
    person: Annotated[Person, BEGIN_MAINTENANCE.permitted],
    notification: Notifying,
    minutes: Annotated[int, Form(ge=1, le=MAX_MINUTES)],
    bus: Annotated[str, Form(max_length=80)] = "",
    reason: Annotated[OneLine, Form(max_length=200)] = "",
) -> Response:
    """Begin a maintenance: nothing is notified for a time."""
    if not reason.strip():
        typed = {"bus": bus, "minutes": str(minutes), "fault": Message("maintenance_needs_reason")}
        return await _page(request, notification, refused=typed)
    await notification.maintenance.begin(person, bus or None, minutes, reason.strip())
    return _to_page()


@router.post("/notifications/maintenance/{maintenance_id}/end")
async def end_maintenance(
    person: Annotated[Person, END_MAINTENANCE.permitted], notification: Notifying, maintenance_id: int
) -> Response:
    """End a maintenance: alarms are notified again."""
    await notification.maintenance.end(person, maintenance_id)
    return _to_page()


@router.get("/notifications/acknowledge")
async def acknowledge_page(request: Request, _: Viewer, alarms: Alarms, alarm: LinkedAlarm) -> Response:
    """Show the alarm of a link, with the button. Opening the link changes nothing, as programs that look for
    malware open links too."""
    found = alarms.find(alarm).alarm
    definition = found.definition
    return render(
        request,
        "notification/acknowledge.html",
        alarm=found,
        place=alarms.place(definition.bus, definition.unit),
        state=found.state_text,
        action=request.url.path + "?" + request.url.query,
    )


@router.post("/notifications/acknowledge")
async def acknowledge_by_link(
    person: Annotated[Person, ACKNOWLEDGE.permitted], alarms: Alarms, alarm: LinkedAlarm
) -> Response:
    """Acknowledge the occurrence of a link."""
    await alarms.act(person, ACKNOWLEDGE, alarm)
    return RedirectResponse(f"/alarms/{alarms.find(alarm).alarm.id}", SEE_OTHER)


def _to_page(query: str = "") -> Response:
    return RedirectResponse(f"/notifications{query}", SEE_OTHER)


def make(services: Services) -> None:
    settings, events, templates = services.settings, services[EventLog], services[Templates]
    site, notify = settings.site, settings.notify
    plan = NotificationPlan(notify, (address for report in settings.report for address in report.to))
    outbox = NotificationOutbox(services[Database])
    links = AcknowledgeLinks(notify.dashboard_url)
    composer = Composer(
        site.name, templates.languages[site.language], templates.formats(site.language), links.make
    )
    senders = Senders(notify.smtp, composer, services[ReportAttachments])
    dispatcher = Dispatcher(plan, outbox, senders, events, services.local_time)
    services[SiteAlarms].watch("notification_failed", lambda: NOTIFICATION_FAILED.holds(dispatcher.failing))
    buses = [bus.name for bus in settings.bus]
    maintenance = Maintenance(outbox, events, notify.maintenance, ZoneInfo(site.zone), buses)
    notification = services.add(Notification(outbox, maintenance, dispatcher, links, services.local_time))
    services.lifespan.add("notification", dispatcher.follow, start=notification.load)
    notifier = services.add(
        AlarmNotifier(services[LineAlarms], outbox, maintenance, dispatcher, services.local_time)
    )
    services.lifespan.add("notification of alarms", notifier.follow, start=notifier.load)


FEATURE = Feature(make, (api.router, router), ACTS)
