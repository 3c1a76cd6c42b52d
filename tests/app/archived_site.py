"""A site whose old events are archived."""

from __future__ import annotations

from pathlib import Path
from zoneinfo import ZoneInfo

from app.core.database import Database
from app.people.audit.archive import EventArchive
from app.people.audit.keys import open_keys
from app.people.audit.log import EventLog
from app.people.audit.proof import heads_of
from app.settings import Settings, load
from bus.instants import UnixTime

MONTH_S = 31 * 86_400.0


async def archived_site(tmp_path: Path) -> Settings:
    """Five months of events, of which the first three are archived."""
    file = tmp_path / "lineside.toml"
    data = tmp_path / "data"
    audit = '[audit]\narchive = "archive"\nkeep_months = 2\n'
    file.write_text(f'[server]\ndata = "data"\n{audit}')
    for folder in (tmp_path / "archive", data):
        folder.mkdir()
    settings, now = load(file), UnixTime(1_768_000_000.0)
    database = Database(data / "lineside.db")
    keys = open_keys(settings.key_files, database.path, database.read_now(heads_of))
    events = EventLog(database, lambda: now, keys)
    for _ in range(5):
        await events.record(kind="unit", what="offline", bus="dry-end", unit=1)
        await events.record(kind="server", what="started")
        now += MONTH_S
    await EventArchive(
        database, events, settings.audit.archive, 2, ZoneInfo("Europe/Berlin"), lambda: now
    ).archive_due()
    database.close()
    return settings
