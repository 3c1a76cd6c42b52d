"""Notification of a site: its outbox, its dispatcher and its maintenance, and a notifier for each bus."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime
from typing import Annotated
from zoneinfo import ZoneInfo

from pydantic import Field
from typing_extensions import TypeAliasType

from app.core.database import Database
from app.core.messages.languages import Languages
from app.core.web.admission.access import Person
from app.core.web.api.shape import InstantObject, MessageObject
from app.core.web.rendering.formats import Formats
from app.errors import Problem
from app.line.alarms.site_alarms import FailingEndpoints
from app.people.audit.log import EventLog
from app.records.notification.acts import SEND_TEST
from app.records.notification.compose import Composer, acknowledge_link, check_link
from app.records.notification.maintenance import Maintenance
from app.records.notification.notice import ReportAttachments
from app.records.notification.outbox import NotificationDelivery, NotificationOutbox, NotificationStore
from app.records.notification.rules.notices import QuietSpan
from app.records.notification.sending.dispatcher import Dispatcher
from app.records.notification.sending.endpoints import EndpointKind, NotificationPlan
from app.records.notification.sending.senders import Senders
from app.settings import Settings
from bus.instants import Clock, UnixTime, unix_now
from bus.messages import Message

NotificationEndpointKind = TypeAliasType("NotificationEndpointKind", EndpointKind)


@dataclass(frozen=True, slots=True)
class NotificationEndpointShown:
    """An address that is notified."""

    key: Annotated[str, Field(description="Identifies it.")]
    kind: NotificationEndpointKind
    address: Annotated[str, Field(description="As people may see it; a URL is not shown.")]
    works: Annotated[
        bool | None, Field(description="Whether the last attempt was delivered; null: there was none.")
    ]
    tried_at: Annotated[InstantObject | None, Field(description="The last attempt; null: there was none.")]
    result: Annotated[MessageObject | None, Field(description="Why that failed; null: no reason.")]
    waiting: Annotated[int, Field(description="Notices that are in no message yet.")]


@dataclass(frozen=True, slots=True)
class NotificationGroup:
    """A group, and who of it is on duty now."""

    name: str
    on_duty: Annotated[list[str], Field(description="Addresses.")]
    gaps: Annotated[list[MessageObject], Field(description="When no one is on duty.")]


class Notification:
    """``local_time``: of the site, by which duty rosters and the heartbeat go. Call :meth:`load` first."""

    def __init__(
        self,
        settings: Settings,
        database: Database,
        events: EventLog,
        failing: FailingEndpoints,
        languages: Languages,
        local_time: Callable[[], datetime],
        reports: ReportAttachments | None = None,
        clock: Clock = unix_now,
    ) -> None:
        readers = (address for report in settings.report for address in report.to)
        self.plan = NotificationPlan(settings.notify, readers)
        self.store = NotificationStore(database)
        self.outbox = NotificationOutbox(database)
        self.buses = [bus.name for bus in settings.bus]
        zone = ZoneInfo(settings.site.zone)
        self.maintenance = Maintenance(
            self.store, events, settings.notify.maintenance, zone, self.buses, clock
        )
        self.local_time = local_time
        self.events = events
        self._clock = clock
        self._key = b""
        language = languages[settings.site.language]
        formats = Formats(language.locale, settings.site.zone)
        composer = Composer(settings.site.name, language, formats, self._link)
        senders = Senders(settings.notify.smtp, composer, reports)
        self.dispatcher = Dispatcher(self.plan, self.outbox, senders, events, failing, local_time, clock)

    async def load(self) -> None:
        """Read the key of links and the maintenance; once at start, before the notifiers."""
        self._key = await self.store.link_key()
        await self.maintenance.load()

    def present(self) -> tuple[list[QuietSpan], UnixTime, datetime]:
        """When nothing is notified, the present, and the present by the clock of the site."""
        return self.maintenance.spans(), self._clock(), self.local_time()

    async def endpoints(self) -> list[NotificationEndpointShown]:
        """Each address of the configuration, as it is now."""
        waiting, found = await self.outbox.waiting(), []
        for key, endpoint in self.plan.endpoints.items():
            last = await self.outbox.last_of(key)
            tried = last if last is not None and last.attempts > 0 else None
            found.append(
                NotificationEndpointShown(
                    key=key,
                    kind=endpoint.kind,
                    address=endpoint.address,
                    works=None if tried is None else tried.state == "delivered",
                    tried_at=None if tried is None else tried.tried_at,
                    result=None if tried is None else tried.result,
                    waiting=waiting.get(key, 0),
                )
            )
        return found

    def groups(self) -> list[NotificationGroup]:
        """Each group of the configuration, as it is now."""
        local, plan = self.local_time(), self.plan
        return [NotificationGroup(name, plan.on_duty(name, local), plan.gaps(name)) for name in plan.rosters]

    async def test(self, person: Person, key: str) -> NotificationDelivery | None:
        """Send a test message to the address of a key, as `Dispatcher.test`. Raises Problem 403 or 404."""
        SEND_TEST.check(person)
        endpoint = self.plan.endpoints.get(key)
        if endpoint is None:
            raise Problem(404, "not_found", Message.of("notify_endpoint_unknown", endpoint=key[:200]))
        return await self.dispatcher.test(endpoint)

    def check_link(self, alarm_id: str, until: int, signature: str) -> None:
        """Raises Problem for a link that this dashboard did not make, or that has expired."""
        check_link(self._key, alarm_id, until, signature, self._clock())

    def _link(self, alarm_id: str) -> str:
        base = self.plan.settings.dashboard_url
        return "" if base is None else acknowledge_link(base, self._key, alarm_id, self._clock())
