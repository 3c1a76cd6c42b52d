"""The page *System*: each guard of the records with its state, its times and what to do."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import AsyncMock

from app.core.web.access import Role
from app.line.alarms.line_alarms import SiteAlarms
from app.people.audit.anchor import Anchoring
from app.people.auth.single_sign_on import SingleSignOn
from app.system.backup.service import Backups
from app.system.backup.settings import BackupSettings
from app.system.configuration.service import ConfigurationFile
from app.system.postgresql.outbox import Cursor
from app.system.postgresql.publisher import Publisher
from app.system.state.feature import SystemRow, system_rows
from bus.instants import monotonic_now, unix_now
from bus.messages import Message
from tests.app.complete_app import House, complete_app
from tests.app.plant_database import write_configuration


async def rows_of(house: House) -> dict[str, SystemRow]:
    rows = await system_rows(house.services, unix_now(), monotonic_now())
    return {row.name.code if isinstance(row.name, Message) else row.name: row for row in rows}


async def test_what_is_not_set_up_says_the_first_step(tmp_path: Path) -> None:
    async with complete_app(tmp_path) as house:
        found = await rows_of(house)
        for name in ("system_backups", "system_plant_database"):
            row = found[name]
            assert row.state == Message("system_not_set_up")
            assert row.to_do is not None
        page = (await (await house.signed_in(Role.VIEWER)).get("/system")).text
        assert "Name a folder on another computer" in page


async def test_the_audit_log_has_the_time_of_its_anchor(tmp_path: Path) -> None:
    async with complete_app(tmp_path) as house:
        await house.services[Anchoring].export()
        row = (await rows_of(house))["system_audit"]
        assert row.state == Message("system_audit_is_anchored")
        assert row.last is not None
        assert row.next == row.last + 60


async def test_a_backup_has_its_times_and_a_failing_one_its_reason(tmp_path: Path) -> None:
    async with complete_app(tmp_path) as house:
        settings = house.services.settings
        settings.__dict__["backup"] = BackupSettings(folder=tmp_path / "backups")
        backups = house.services[Backups]
        backups._settings = settings.backup
        backups.written = unix_now() - 60
        row = (await rows_of(house))["system_backups"]
        assert row.state == Message("system_backup_is_written")
        assert row.last == backups.written
        assert row.next == backups.next_due(unix_now())
        backups.failing = Message.of("backup_folder_missing", folder="/mnt")
        assert (await rows_of(house))["system_backups"].state == backups.failing


async def test_an_alarm_of_the_site_is_its_row(tmp_path: Path) -> None:
    async with complete_app(tmp_path) as house:
        site = house.services[SiteAlarms]
        alarms = site.list.alarms
        site.watch("disk_low", lambda: True)
        for code in ("disk_low", "clock_stepped"):
            alarm = alarms[f"_.{code}"]
            alarm.facts = replace(alarm.facts, active=True, acknowledged=False)
        found = await rows_of(house)
        disk = found["system_disk_name"]
        definition = alarms["_.disk_low"].definition
        assert (disk.level, disk.to_do) == (definition.priority, definition.record.response)
        # One that belongs to none of the rows has its own.
        stepped = found["alarm_clock_stepped"]
        assert (stepped.alarm, stepped.state.code) == (
            alarms["_.clock_stepped"].id,
            "alarm_state_unack_active",
        )
        page = (await (await house.signed_in(Role.VIEWER)).get("/system")).text
        assert f'href="/alarms/{disk.alarm}"' in page


async def test_a_plant_database_that_is_not_reached_is_marked_and_has_no_last_time(tmp_path: Path) -> None:
    config = write_configuration(tmp_path, "postgresql://lineside@127.0.0.1:1/plant", "all")
    async with complete_app(tmp_path, config=config) as house:
        publisher = house.services[Publisher]
        publisher.status = replace(publisher.status, fault=Message("publisher_unreachable"))
        row = (await rows_of(house))["system_plant_database"]
        assert (row.is_faulty, row.last, row.to_do) == (True, None, Message("system_check_database"))
        had_everything = int(unix_now()) - 3600
        await publisher._store(Cursor(0, 0, 0, had_everything * 1_000_000))
        publisher._cursor = None
        await publisher._attempt()
        row = (await rows_of(house))["system_plant_database"]
        assert (row.is_faulty, row.last) == (True, had_everything), "the server was restarted into the fault"


async def test_company_accounts_have_a_row_where_they_are_set_up(tmp_path: Path) -> None:
    async with complete_app(tmp_path) as house:
        assert "system_company_accounts" not in await rows_of(house)
        sign_on: Any = house.services[SingleSignOn]
        sign_on.settings = object()
        assert (await rows_of(house))["system_company_accounts"].state.code == "system_provider_responds"
        sign_on.provider = SimpleNamespace(fault=Message("company_account_away"), close=AsyncMock())
        row = (await rows_of(house))["system_company_accounts"]
        assert (row.is_faulty, row.to_do) == (True, Message("system_check_provider"))


async def test_a_configuration_that_waits_for_a_restart_has_a_row(tmp_path: Path) -> None:
    config = write_configuration(tmp_path, "postgresql://lineside@127.0.0.1:1/plant", "all")
    async with complete_app(tmp_path, config=config) as house:
        assert "system_configuration" not in await rows_of(house)
        versions = await house.services[ConfigurationFile].versions()
        config.write_text(config.read_text().replace("Mill 7", "Mill 8"))
        row = (await rows_of(house))["system_configuration"]
        assert (row.is_faulty, row.to_do) == (True, Message("system_restart"))
        assert await house.services[ConfigurationFile].versions() == versions, "to look stores nothing"
