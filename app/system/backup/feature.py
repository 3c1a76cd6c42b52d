"""The feature of the server's backups."""

from __future__ import annotations

from zoneinfo import ZoneInfo

from app.feature import Feature, Services
from app.line.alarms.line_alarms import SiteAlarms
from app.people.audit.log import EventLog
from app.system.backup.service import Backups


def make(services: Services) -> None:
    settings = services.settings
    zone = ZoneInfo(settings.site.zone)
    backups = services.add(Backups(settings.backup, settings._file, zone, services[EventLog]))
    services[SiteAlarms].watch("backup_overdue", lambda: backups.missing)
    if settings.backup.folder is not None:
        services.lifespan.add("backups", backups.follow)


FEATURE = Feature(make)
