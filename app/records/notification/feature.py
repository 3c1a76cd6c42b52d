"""Notification of people about alarms."""

from __future__ import annotations

from zoneinfo import ZoneInfo

from app.core.database import Database
from app.core.web.templating import Templates
from app.feature import Feature, Services
from app.line.alarms.line_alarms import LineAlarms
from app.line.alarms.site_alarms import SiteAlarms
from app.line.conditions.catalogue import NOTIFICATION_FAILED
from app.people.audit.log import EventLog
from app.records.notification import api, pages
from app.records.notification.compose import AcknowledgeLinks, Composer
from app.records.notification.dispatcher import Dispatcher
from app.records.notification.outbox import NotificationOutbox, ReportAttachments
from app.records.notification.plan import NotificationPlan
from app.records.notification.senders import Senders
from app.records.notification.service import ACTS, AlarmNotifier, Maintenance, Notification


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


FEATURE = Feature(make, (api.router, pages.router), ACTS)
