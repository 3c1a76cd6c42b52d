"""The audit log as a feature: the event log, its proof, and the record of each start and end of the server,
with what changed in the configuration since the last one."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any
from zoneinfo import ZoneInfo

from app.core.database import Database
from app.core.database.files import write_file
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

FILE = "configuration.json"
"""The configuration that the server ran with last; beside the store."""


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
    configuration = settings.model_dump(mode="json")
    begin = partial(_record_start, settings.server.data, configuration, database.migrated, events)
    lifespan.add("event log", start=begin, end=partial(_record_end, events))
    lifespan.add("open commands", start=events.close_open_intents)
    record_all = partial(events.repeated.record_due, everything=True)
    lifespan.add("repeated events", events.repeated.follow, end=record_all)


async def _record_start(
    data: Path, configuration: dict[str, Any], migrated: Sequence[Migration], events: EventLog
) -> None:
    """Record with what the server starts."""
    if migrated:
        await events.record(kind="server", what=_store_changed(migrated))
    await events.record(kind="server", what=Message("event_server_started"))
    if events.keys.path is not None and events.keys.path.is_relative_to(data):
        await events.record(kind="audit", what=Message("event_audit_key_in_data"))
    if changed := await asyncio.to_thread(change_since_last, data, configuration):
        what = Message("event_configuration_changed")
        await events.record(kind="configuration", what=what, message=changed)


async def _record_end(events: EventLog) -> None:
    await events.record(kind="server", what=Message("event_server_ended"))


def _store_changed(steps: Sequence[Migration]) -> Message:
    """Return the event of a store that was made or brought up to date."""
    if steps[0].number == FIRST:
        return Message("event_store_created")
    names = ", ".join(f"{step.number:04d} {step.name}" for step in steps)
    return Message.of("event_store_updated", steps=names)


def _flat(value: Any, path: str = "") -> Iterator[tuple[str, str]]:
    """Yield every leaf with its path, such as ``bus.dry-end.unit.1.name``, which has the id or name of
    elements."""
    if isinstance(value, Mapping):
        for key, inner in value.items():
            yield from _flat(inner, f"{path}.{key}" if path else str(key))
    elif isinstance(value, list):
        for index, inner in enumerate(value):
            yield from _flat(inner, f"{path}.{_name(inner, index)}")
    else:
        yield path, json.dumps(value, ensure_ascii=False)


def _name(element: Any, index: int) -> str:
    named = element if isinstance(element, Mapping) else {}
    return str(named.get("id", named.get("name", index)))


def differences(before: Any, now: Any) -> list[str]:
    """Return a phrase for each leaf that was added, removed or changed."""
    old, new = dict(_flat(before)), dict(_flat(now))
    return [
        f"{path}: {old.get(path, 'nothing')} → {new.get(path, 'nothing')}"
        for path in sorted(old.keys() | new.keys())
        if old.get(path) != new.get(path)
    ]


def change_since_last(folder: Path, now: dict[str, Any]) -> str:
    """Return the changes as one text, empty without any, and store the configuration for the next start."""
    file = folder / FILE
    try:
        before = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        before = None
    write_file(file, json.dumps(now, ensure_ascii=False, indent=1).encode())
    if before is None:
        return ""
    return "; ".join(differences(before, now))


FEATURE = Feature(make, (api.router, pages.router))
