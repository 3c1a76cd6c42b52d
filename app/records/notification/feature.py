"""Notification of people about alarms."""

from __future__ import annotations

from app.core.database import Database
from app.core.web.rendering.templating import Templates
from app.feature import Feature, Services
from app.line.alarms.bus_alarms import BusAlarms
from app.line.alarms.site_alarms import FailingEndpoints, SiteAlarms
from app.people.audit.log import EventLog
from app.records.notification import api, pages
from app.records.notification.acts import ACTS
from app.records.notification.notice import ReportAttachments
from app.records.notification.notifier import AlarmNotifier
from app.records.notification.service import Notification


def make(services: Services) -> None:
    database, events, languages = services[Database], services[EventLog], services[Templates].languages
    failing = services[FailingEndpoints]
    notification = services.add(
        Notification(
            services.settings,
            database,
            events,
            failing,
            languages,
            services.local_time,
            services[ReportAttachments],
        )
    )
    services.lifespan.add("notification", notification.dispatcher.follow, start=notification.load)
    for name, bus in services.buses.items():
        alarms = bus[BusAlarms]
        notifier = bus.add(AlarmNotifier(notification, name, alarms.list, alarms.place))
        services.lifespan.add(f"notification of {name}", notifier.follow, start=notifier.load)
    of_site = AlarmNotifier(notification, None, services[SiteAlarms].list, lambda _: "")
    services.lifespan.add("notification of the site", of_site.follow, start=of_site.load)


FEATURE = Feature(make, (api.router, pages.router), ACTS)
