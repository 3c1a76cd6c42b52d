"""The event log cannot be written when the server ends: the stores are closed, and other backlogs written."""

from __future__ import annotations

from pathlib import Path
from sqlite3 import Connection

import pytest
from structlog.testing import capture_logs

from app.core.database import Database
from app.errors import StoreError
from app.line.history.service import History
from app.main import create_app
from app.people.audit.log import EventLog
from tests.app.complete_app import settings_in
from tests.app.history_line import NOON, Shelf, polls


def refuse_events(connection: Connection) -> None:
    connection.execute(
        "CREATE TRIGGER full BEFORE INSERT ON events BEGIN SELECT RAISE(ABORT, 'the disk is full'); END"
    )


async def test_every_store_is_closed_and_every_other_backlog_written(tmp_path: Path) -> None:
    services = create_app(settings_in(tmp_path)).state.services
    with capture_logs() as logs:
        async with services.lifespan.running():
            await services[EventLog].repeated.count("login_refused", "refused", who="ann")
            await services[Database].write(refuse_events)
            await services[EventLog].repeated.count("login_refused", "refused", who="ann")
            services[History].append("dry-end", polls(NOON, NOON + 10))
    with pytest.raises(StoreError, match="closed"):
        await services[Database].read(lambda _: None)
    shelf = Shelf(tmp_path / "data" / "history.db")
    assert len(shelf.query("actual", NOON, NOON + 60).series.at) == 50
    shelf.close()
    failed = [entry for entry in logs if entry["event"] == "not ended"]
    assert [entry["part"] for entry in failed] == ["repeated events", "event log"]
    assert all("the disk is full" in entry["why"] for entry in failed)
