"""Reports on a page, as files and by mail."""

from __future__ import annotations

from app.core.database import Database
from app.core.find.finders import Finders, FixedPlace
from app.core.web.assets import Assets
from app.core.web.templating import Templates
from app.feature import Feature, Services
from app.line.alarms.line_alarms import LineAlarms
from app.line.history.service import History
from app.records.notification.outbox import ReportAttachments
from app.records.notification.service import Notification
from app.records.reports import api, pages
from app.records.reports.service import ReportDocuments, Reports, ReportSchedule
from bus.messages import Message


def make(services: Services) -> None:
    settings, database = services.settings, services[Database]
    reports = services.add(Reports(settings, database, services[History]))
    templates, assets = services[Templates], services[Assets]
    documents = services.add(ReportDocuments(reports, templates, assets, services[LineAlarms]))
    services.add(ReportAttachments(documents.attachment))
    services[Finders].add_links("find_actions", [FixedPlace(Message("find_report"), "/reports")])
    if settings.report:
        # Notification is made later: it needs the attachments.
        schedule = ReportSchedule(settings, lambda items: services[Notification].dispatcher.add(items))
        services.lifespan.add("reports", schedule.follow)


FEATURE = Feature(make, (api.router, pages.router))
