"""A plant's database that does not take what is published: it is said, and nothing of others is changed."""

from __future__ import annotations

import threading
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from pathlib import Path
from typing import Any

import psycopg
import pytest
from click.testing import CliRunner
from pydantic import ValidationError

from app.cli import check
from app.core.database import Database
from app.core.web.access import Role
from app.settings import load
from app.system.postgresql.destination import Destination, PublishError
from app.system.postgresql.publisher import Publisher, PublisherStatus
from app.system.postgresql.settings import PostgresqlSettings
from bus.instants import unix_now
from tests.app.fake_worker import until
from tests.app.plant_database import published, publishing, rows, write_configuration
from tests.for_each import for_each
from tests.postgresql import GUARDED, PASSWORD, USER, needs_postgresql

pytestmark = needs_postgresql


def execute(url: str, *statements: str) -> None:
    with psycopg.connect(url, autocommit=True) as connection:
        for statement in statements:
            connection.execute(statement.encode())


async def fault_of(folder: Path, url: str, name: str = "Mill 7") -> str:
    """What a server says that publishes there, whose line runs on; the same is found by the check."""
    async with publishing(folder, url, name=name) as house:
        status = house.services[Publisher]
        await until(lambda: status.status.fault is not None, "a fault")
        program = await house.program(Role.VIEWER)
        assert (await program.get("/api/v1/line")).status_code == 200
        fault = status.status.fault
    assert fault is not None
    assert str(fault) in checked(folder)
    return fault.code


def checked(folder: Path) -> str:
    words = ["--config", str(folder / "lineside.toml"), "--live"]
    return CliRunner().invoke(check.check, words).output.replace("\n", " ")


async def test_tables_of_another_program_are_left_alone(tmp_path: Path, database: str) -> None:
    table = "CREATE TABLE lineside.reading (id int)"
    execute(database, "CREATE SCHEMA lineside", table, "INSERT INTO lineside.reading VALUES (7)")
    assert await fault_of(tmp_path, database) == "publisher_foreign_tables"
    assert rows(database, "SELECT * FROM lineside.reading") == [(7,)]
    count = "SELECT count(*) FROM pg_class WHERE relnamespace = 'lineside'::regnamespace"
    assert rows(database, count) == [(1,)]


async def test_a_newer_version_of_the_tables_is_refused(tmp_path: Path, database: str) -> None:
    async with publishing(tmp_path, database) as house:
        await published(house)
    execute(database, "UPDATE lineside.lineside_version SET version = 99")
    assert await fault_of(tmp_path, database) == "publisher_newer_schema"


async def test_a_role_without_rights_is_told_which(tmp_path: Path, database: str) -> None:
    role = database.partition("@/")[2].partition("?")[0] + "_reader"
    execute(database, f"CREATE ROLE {role} LOGIN")
    assert await fault_of(tmp_path, database.replace("lineside@", f"{role}@")) == "publisher_no_right"


async def test_two_sites_of_one_name_do_not_mix(tmp_path: Path, database: str) -> None:
    async with publishing(tmp_path / "one", database) as house:
        await published(house)
    before = rows(database, "SELECT * FROM lineside.event ORDER BY id")
    (tmp_path / "other" / "data").mkdir(parents=True)
    with closing(Database(tmp_path / "other" / "data" / "lineside.db")) as other:
        # Stores of tests are copies of one.
        other.write_now(lambda c: c.execute("UPDATE publisher_identity SET id = 'of another site'"))
    assert await fault_of(tmp_path / "other", database) == "publisher_other_site"
    assert rows(database, "SELECT * FROM lineside.event ORDER BY id") == before
    async with publishing(tmp_path / "other", database, name="Mill 8") as house:
        await published(house)
        await published(house)
    assert rows(database, "SELECT name FROM lineside.site ORDER BY name") == [("Mill 7",), ("Mill 8",)]


async def test_a_database_that_is_not_there_is_said_with_the_reason(tmp_path: Path) -> None:
    url = "postgresql://lineside@/plant?host=/nowhere"
    assert await fault_of(tmp_path, url) == "publisher_unreachable"


async def test_a_full_disk_there_costs_nothing_here(tmp_path: Path, database: str) -> None:
    async with publishing(tmp_path, database) as house:
        await published(house)
        execute(
            database,
            "CREATE FUNCTION full_disk() RETURNS trigger LANGUAGE plpgsql AS"
            " $$ BEGIN RAISE EXCEPTION 'no space left on device' USING ERRCODE = '53100'; END $$",
            "CREATE TRIGGER full_disk BEFORE INSERT ON lineside.event"
            " FOR EACH ROW EXECUTE FUNCTION full_disk()",
        )
        await house.add("anna", Role.OPERATOR)
        publisher = house.services[Publisher]
        await until(lambda: publisher.status.fault is not None, "a fault")
        assert publisher.status.fault
        assert publisher.status.fault.code == "publisher_disk_full"
        execute(database, "DROP TRIGGER full_disk ON lineside.event")
        await published(house)
        assert rows(database, "SELECT count(*) FROM lineside.event WHERE kind = 'user'") == [(1,)]


async def test_the_password_is_read_from_its_file(tmp_path: Path, database: str) -> None:
    (tmp_path / "password").write_text(f"{PASSWORD}\n")
    url = database.replace(f"{USER}@", f"{GUARDED}@")
    async with publishing(tmp_path, url, more='password_file = "password"') as house:
        await published(house)
    (tmp_path / "password").write_text("another\n")
    async with publishing(tmp_path, url, more='password_file = "password"') as house:
        publisher = house.services[Publisher]
        await until(lambda: publisher.status.fault is not None, "a fault")
        assert "another" not in str(publisher.status.fault)


def test_a_connection_is_closed_by_the_thread_that_uses_it(
    tmp_path: Path, database: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """psycopg frees what libpq still uses if another thread closes: the server ended with SIGSEGV."""
    settings = load(write_configuration(tmp_path, database, "all"))
    assert settings.postgresql
    destination = Destination(settings.postgresql, "Mill 7", "0" * 32, settings.bus)
    destination.connect()
    close, closed_here = psycopg.Connection.close, []

    def close_and_note(connection: psycopg.Connection[Any]) -> None:
        closed_here.append(threading.current_thread() is threading.main_thread())
        close(connection)

    with ThreadPoolExecutor() as threads, psycopg.connect(database) as locking:
        locking.execute("LOCK TABLE lineside.event")
        waiting = threads.submit(destination.hashes, 0, 1)
        while not rows(database, "SELECT 1 FROM pg_locks WHERE NOT granted"):
            time.sleep(0.01)
        with monkeypatch.context() as noting:
            noting.setattr(psycopg.Connection, "close", close_and_note)
            destination.abandon()
            with pytest.raises(PublishError):
                waiting.result()
    assert closed_here == [False]


async def test_old_months_go_and_none_of_another_site(tmp_path: Path, database: str) -> None:
    async with publishing(tmp_path / "one", database) as house:
        await published(house)
    execute(
        database,
        *(
            f"CREATE TABLE lineside.minute_y2020m{month} PARTITION OF lineside.minute"
            f" FOR VALUES FROM ('2020-{month}-01 00:00+00') TO ('2020-{month + 1}-01 00:00+00')"
            for month in (10, 11)
        ),
        "INSERT INTO lineside.minute (site, at, bus, unit) VALUES ('Mill 7', '2020-10-05', 'dry-end', 1),"
        " ('Mill 7', '2020-11-05', 'dry-end', 1), ('Mill 8', '2020-11-05', 'dry-end', 1)",
    )
    async with publishing(tmp_path / "one", database, more="keep_months = 3") as house:
        await published(house)
        await published(house)
    assert rows(database, "SELECT site FROM lineside.minute WHERE at < '2021-01-01'") == [("Mill 8",)]
    assert rows(database, "SELECT to_regclass('lineside.minute_y2020m10')") == [(None,)]


def test_a_check_leaves_nothing_behind(tmp_path: Path, database: str) -> None:
    write_configuration(tmp_path, database, "1 s")
    assert "can be used, with the schema lineside" in checked(tmp_path)
    assert rows(database, "SELECT 1 FROM pg_namespace WHERE nspname = 'lineside'") == []


def test_a_clock_that_is_an_hour_off_is_said() -> None:
    status = PublisherStatus("db/plant", unix_now(), clock_ahead_s=-3600.0)
    assert status.notice is not None
    assert status.notice.code == "publisher_clock"
    assert "-3600 s" in str(status.notice)


@for_each(
    ("url", "code"),
    [
        ("postgresql://lineside:s3cret@db/plant", "setting_postgresql_password"),
        ("postgresql://db/plant?password=s3cret", "setting_postgresql_password"),
        ("host=db dbname=plant", "setting_postgresql_url"),
        ("mysql://db/plant", "setting_postgresql_url"),
    ],
)
def test_a_url_that_cannot_be_used_is_refused(url: str, code: str) -> None:
    with pytest.raises(ValidationError) as refused:
        PostgresqlSettings(url=url)
    [error] = refused.value.errors()
    assert error["ctx"]["error"].args[0].code == code
