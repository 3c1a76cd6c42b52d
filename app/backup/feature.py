"""The backups of the server."""

from __future__ import annotations

from zoneinfo import ZoneInfo

from app.audit.log import EventLog
from app.backup.service import Backups
from app.feature import Feature, Services


def make(services: Services) -> None:
    settings = services.settings
    zone = ZoneInfo(settings.site.zone)
    backups = services.add(Backups(settings.backup, settings._file, zone, services[EventLog]))
    if settings.backup.folder is not None:
        services.lifespan.add("backups", backups.follow)


FEATURE = Feature(make)
