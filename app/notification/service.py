"""Notification of a site: its outbox, its dispatcher and its maintenance, and a notifier for each bus."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime
from zoneinfo import ZoneInfo

from app.alarms.alarm_list import AlarmList
from app.alarms.site_alarms import FailingEndpoints
from app.audit.log import EventLog
from app.database import Database
from app.errors import Problem
from app.messages.languages import Languages
from app.notification.acknowledge_link import acknowledge_link, check_link
from app.notification.acts import SEND_TEST
from app.notification.compose import Composer
from app.notification.dispatcher import Dispatcher
from app.notification.endpoints import NotificationEndpoint, NotificationPlan
from app.notification.maintenance import Maintenance
from app.notification.notifier import AlarmNotifier
from app.notification.outbox import NotificationDelivery, NotificationOutbox
from app.notification.senders import Senders
from app.notification.store import NotificationStore
from app.settings import Settings
from app.web.access import Person
from app.web.formats import Formats
from bus.instants import Clock, unix_now
from bus.messages import Message


@dataclass(frozen=True, slots=True)
class EndpointStatus:
    """``last``: the message that was tried last; None: there was none yet. ``waiting``: how many notices are
    in no message yet."""

    endpoint: NotificationEndpoint
    last: NotificationDelivery | None
    waiting: int

    @property
    def works(self) -> bool | None:
        """Whether the last message was delivered."""
        return None if self.last is None else self.last.state == "delivered"


@dataclass(frozen=True, slots=True)
class GroupDuty:
    """A group, who of it is on duty now, and when no one is."""

    name: str
    present: list[str]
    gaps: list[Message]


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
        clock: Clock = unix_now,
    ) -> None:
        self.plan = NotificationPlan(settings.notify)
        self.store = NotificationStore(database)
        self.outbox = NotificationOutbox(database)
        self.buses = [bus.name for bus in settings.bus]
        zone = ZoneInfo(settings.site.zone)
        self.maintenance = Maintenance(
            self.store, events, settings.notify.maintenance, zone, self.buses, clock
        )
        self.local_time = local_time
        self._clock = clock
        self._key = b""
        language = languages[settings.site.language]
        formats = Formats(language.locale, settings.site.zone)
        composer = Composer(settings.site.name, language, formats, self._link)
        senders = Senders(settings.notify.smtp, composer)
        self.dispatcher = Dispatcher(self.plan, self.outbox, senders, events, failing, local_time, clock)

    async def load(self) -> None:
        """Read the key of links and the maintenance; once at start, before the notifiers."""
        self._key = await self.store.link_key()
        await self.maintenance.load()

    def notifier(
        self, bus: str | None, alarms: AlarmList, place: Callable[[int | None], str]
    ) -> AlarmNotifier:
        """What notifies of the alarms of one bus, or (None) of the site."""
        return AlarmNotifier(
            bus,
            alarms,
            self.plan,
            self.store,
            self.maintenance,
            place,
            self.local_time,
            self.dispatcher.wake,
            self._clock,
        )

    async def statuses(self) -> list[EndpointStatus]:
        """Each address of the configuration, as it is now."""
        waiting, found = await self.outbox.waiting(), []
        for key, endpoint in self.plan.endpoints.items():
            last = await self.outbox.last_of(key)
            is_tried = last is not None and last.attempts > 0
            found.append(EndpointStatus(endpoint, last if is_tried else None, waiting.get(key, 0)))
        return found

    def duties(self) -> list[GroupDuty]:
        """Each group of the configuration, as it is now."""
        local, plan = self.local_time(), self.plan
        return [GroupDuty(name, plan.on_duty(name, local), plan.gaps(name)) for name in plan.rosters]

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
