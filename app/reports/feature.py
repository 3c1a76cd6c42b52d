"""Reports on a page, as files and by mail."""

from __future__ import annotations

from app.alarms.monitor.line_alarms import LineAlarms
from app.database import Database
from app.feature import Feature, Services
from app.find.finders import Finders, FixedPlace
from app.history.service import History
from app.notification.notice import ReportAttachments
from app.notification.service import Notification
from app.reports import api, pages
from app.reports.document import ReportDocuments
from app.reports.schedule import ReportSchedule
from app.reports.service import Reports
from app.web.rendering.assets import Assets
from app.web.rendering.templating import Templates
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
