"""The audit log as a feature: the event log, its proof, and the record of each start and end of a server."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from zoneinfo import ZoneInfo

from app.core.database import Database
from app.core.database.migration import FIRST, Migration
from app.core.find.finders import Finders
from app.core.server.tls import ServerEvents
from app.feature import Feature, Services
from app.people.audit import api, pages
from app.people.audit.acts import ActLimit
from app.people.audit.anchor import Anchoring, anchor_file
from app.people.audit.archive import EventArchive
from app.people.audit.keys import open_keys
from app.people.audit.log import EventLog
from app.people.audit.pages import EventFinder
from app.people.audit.proof import heads_of
from bus.messages import Message


def make(services: Services) -> None:
    settings, database, lifespan = services.settings, services[Database], services.lifespan
    keys = open_keys(settings.key_files, database.path, database.read_now(heads_of))
    services.add(ActLimit())
    events = services.add(EventLog(database, keys=keys))
    services.add(events, ServerEvents)
    services[Finders].add("find_events", services.add(EventFinder(events, settings.bus)))
    anchor, is_configured = anchor_file(settings.audit, settings.key_files), settings.audit.anchor is not None
    anchoring = services.add(Anchoring(events, anchor, is_configured=is_configured))
    lifespan.add("audit anchor", anchoring.follow, end=anchoring.end)
    archive = EventArchive(
        database, events, settings.audit.archive, settings.audit.keep_months, ZoneInfo(settings.site.zone)
    )
    services.add(archive)
    lifespan.add("event archive", archive.follow)
    begin = partial(_record_start, settings.server.data, database.migrated, events)
    lifespan.add("event log", start=begin, end=partial(_record_end, events))
    lifespan.add("open commands", start=events.close_open_intents)
    record_all = partial(events.repeated.record_due, everything=True)
    lifespan.add("repeated events", events.repeated.follow, end=record_all)


async def _record_start(data: Path, migrated: Sequence[Migration], events: EventLog) -> None:
    """Record with what the server starts."""
    if migrated:
        await events.record(kind="server", what=_store_changed(migrated))
    await events.record(kind="server", what=Message("event_server_started"))
    if events.keys.path is not None and events.keys.path.is_relative_to(data):
        await events.record(kind="audit", what=Message("event_audit_key_in_data"))


async def _record_end(events: EventLog) -> None:
    await events.record(kind="server", what=Message("event_server_ended"))


def _store_changed(steps: Sequence[Migration]) -> Message:
    """Return the event of a store that was made or brought up to date."""
    if steps[0].number == FIRST:
        return Message("event_store_created")
    names = ", ".join(f"{step.number:04d} {step.name}" for step in steps)
    return Message.of("event_store_updated", steps=names)


FEATURE = Feature(make, (api.router, pages.router))
