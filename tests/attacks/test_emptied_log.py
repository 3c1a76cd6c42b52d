"""The log is emptied, cut off or put back, and no anchor is configured: the one beside the key notices."""

from __future__ import annotations

import asyncio
import sqlite3
from contextlib import closing
from pathlib import Path

import pytest
from click.testing import CliRunner
from structlog.testing import capture_logs

from app.cli import cli
from app.core.database import Database
from app.line.alarms.alarm import alarm_key
from app.line.alarms.line_alarms import LineAlarms
from app.main import create_app
from app.people.audit.anchor import Anchoring, AnchorStatus
from app.people.audit.keys import open_keys
from app.people.audit.log import EventLog
from app.people.audit.proof import heads_of
from app.settings import load
from tests.app.complete_app import settings_in
from tests.attacks.test_audit_log import ENTRIES, Plant


class QuietPlant(Plant):
    """A plant whose configuration names no anchor; its server has written some entries."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        self.config.write_text('[server]\ndata = "data"\n')
        self.anchor = folder / "lineside.audit.key.anchor"

    def serve(self, entries: int = 1) -> AnchorStatus:
        """What a server finds that starts, writes so many entries, and ends."""

        async def run() -> AnchorStatus:
            database = Database(self.store)
            try:
                keys = open_keys(load(self.config).key_files, self.store, await database.read(heads_of))
                log = EventLog(database, keys=keys)
                for number in range(entries):
                    await log.record(kind="estop", what=f"e-stop {number}")
                anchoring = Anchoring(log, self.anchor, is_configured=False)
                await anchoring.export()
                assert (await anchoring.verify()).broken is None or anchoring.status.altered
                return anchoring.status
            finally:
                database.close()

        return asyncio.run(run())

    def command(self, *words: str) -> str:
        done = CliRunner().invoke(cli, [*words, "--config", str(self.config)])
        assert done.exit_code == 0, done.output
        return done.stdout

    def events(self, what: str) -> list[str]:
        with closing(sqlite3.connect(self.store)) as connection:
            rows = connection.execute("SELECT message FROM events WHERE what = ?", (what,))
            return [message for (message,) in rows]


def remove_store(data: Path) -> None:
    for path in data.glob("lineside.db*"):
        path.unlink()


@pytest.fixture
def plant(tmp_path: Path) -> QuietPlant:
    made = QuietPlant(tmp_path)
    assert made.serve(ENTRIES) == AnchorStatus()
    assert made.verify()[0] == 0
    return made


def test_the_start_reports_an_emptied_log(plant: QuietPlant) -> None:
    remove_store(plant.store.parent)
    status = plant.serve(3)
    assert str(status.altered) == "the log ends at entry 3, but the anchor names entry 9"
    [message] = plant.events("audit log altered")
    assert "the anchor names entry 9" in message
    assert "the anchor names entry 9" in plant.broken_at()
    plant.serve(20)
    assert "entry 9 is not the one that the anchor names" in plant.broken_at(), "it was not anchored again"


async def test_a_server_over_an_emptied_log_raises_the_alarm(tmp_path: Path) -> None:
    settings = settings_in(tmp_path)
    async with create_app(settings).state.services.lifespan.running():
        pass
    remove_store(tmp_path / "data")
    services = create_app(settings).state.services
    with capture_logs() as logs:
        async with services.lifespan.running():
            await services[Anchoring].export()
            services[LineAlarms].site.tick()
            alarm = services[LineAlarms].site.list.alarms[alarm_key(None, None, "audit_degraded")]
            assert alarm.holds is True
    assert [entry["event"] for entry in logs if entry["log_level"] == "error"] == ["audit log altered"]


def test_a_kill_between_the_log_and_its_anchors_raises_no_alarm(plant: QuietPlant) -> None:
    """The log is ahead of them, which is no alteration; the next start makes up for it."""
    anchor = plant.anchor.read_bytes()
    plant.serve(5)
    plant.anchor.write_bytes(anchor)
    assert plant.verify()[0] == 0
    assert plant.serve(1) == AnchorStatus()
    assert plant.events("audit log altered") == []
    assert plant.anchor.read_bytes() != anchor


def test_a_lost_key_begins_the_anchor_again_and_keeps_the_old_one(plant: QuietPlant) -> None:
    plant.key.unlink()
    assert plant.serve() == AnchorStatus()
    assert plant.verify()[0] == 0
    assert len(list(plant.key.parent.glob("*.anchor.until-*"))) == 1


def test_a_restored_store_is_recorded_and_begins_a_new_anchor(plant: QuietPlant, tmp_path: Path) -> None:
    plant.command("backup-store", str(tmp_path / "one.tar"))
    plant.serve(5)
    printed = plant.command("restore-store", str(tmp_path / "one.tar"), "--yes")
    [aside] = tmp_path.glob("lineside.audit.key.anchor.until-*")
    assert str(aside) in printed
    assert plant.verify()[0] == 0
    assert plant.serve() == AnchorStatus()
    assert plant.verify()[0] == 0
    [message] = plant.events("the stores were restored from a backup")
    assert "the audit log that was replaced ended at entry 14, " in message
    assert "the anchor names entry 14" in plant.broken_at("--anchor", str(aside)), "it stays as evidence"
