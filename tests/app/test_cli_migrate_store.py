"""migrate-store: both ways over PostgreSQL, while a server uses the source, killed, and what it refuses."""

from __future__ import annotations

import json
import re
import shutil
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from zoneinfo import ZoneInfo

import psycopg
import pytest

from app.audit.archive.archiving import EventArchive
from app.audit.events.store import heads_of
from app.audit.log import EventLog
from app.audit.proof.keys import open_keys
from app.cli.stores import copy_report, migrate_store
from app.database import Database, SqliteDatabase
from app.database.copying.places import Folder, PostgresqlPlace
from app.database.engine import upsert
from app.database.opening import open_database, require_finished_database
from app.database.settings import StoreSettings
from app.errors import ConstraintError, StoreError
from app.home.lease import HomeRow
from app.home.store import NO_TIME
from app.settings import load
from bus.instants import UnixTime
from tests import fork_server
from tests.app.intents import intend
from tests.app.moved_site import FILES, MovedSite, folder_of, numbers_in, rows_at
from tests.postgresql import fresh_database, needs_postgresql

pytestmark = needs_postgresql


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> MovedSite:
    site = MovedSite(tmp_path_factory.mktemp("model"))
    site.make()
    return site


@pytest.fixture
def site(model: MovedSite, tmp_path: Path) -> MovedSite:
    shutil.copytree(model.folder, tmp_path / "site")
    return MovedSite(tmp_path / "site")


@pytest.fixture
def empty() -> Iterator[StoreSettings]:
    with fresh_database(empty=True) as store:
        yield store


def opened(store: StoreSettings) -> Database:
    return open_database(store, Path("unused"))


def test_a_site_is_the_same_after_it_went_into_postgresql_and_back(
    site: MovedSite, empty: StoreSettings
) -> None:
    before, numbers = rows_at(folder_of(site)), numbers_in(site.data)
    there = site.migrate(empty.url, "--json")
    assert there.exit_code == 0, there.output
    *tables, end = map(json.loads, there.stdout.splitlines())
    assert all(table["equal"] and table["source"] == table["target"] for table in tables)
    assert {table["table"] for table in tables} >= {"events", "sessions", "raw", "picture", "home"}
    assert end["finished"]
    assert end["audit_holds"]
    assert end["changes"][1]["detail"].strip() == f'under [store]: url = "{empty.url}"'
    assert rows_at(PostgresqlPlace(empty)) == rows_at(folder_of(site)) == before
    site.configure(f'[store]\nurl = "{empty.url}"\n')
    assert site.run("audit", "verify").exit_code == 0
    with closing(opened(empty)) as main:
        # Numbers go on after those of the source, and its rules hold.
        quiet = (
            "INSERT INTO notification_quiet (starts, ends, who, reason) VALUES (1, 2, '', '') RETURNING id"
        )
        columns = "hash, name, role, created_by, created_at"
        token = f"INSERT INTO tokens ({columns}) VALUES (?, 'b', 'viewer', '', 1) RETURNING id"
        assert main.write_now(lambda connection: connection.execute(quiet).fetchone()[0]) == 2
        assert main.write_now(lambda connection: connection.execute(token, (b"h",)).fetchone()[0]) == 6
        main.write_now(lambda connection: connection.execute("DELETE FROM notification_quiet"))
        main.write_now(lambda connection: connection.execute("DELETE FROM tokens WHERE name = 'b'"))
        with pytest.raises(ConstraintError):
            main.write_now(lambda connection: connection.execute("UPDATE events SET who = ''"))
    back = site.migrate(str(site.folder / "back"))
    assert back.exit_code == 0, back.output
    assert 'data = "back"' in back.output
    assert 'key_file = "lineside.audit.key"' in back.output
    assert "remove the lines url" in back.output
    assert rows_at(Folder(site.folder / "back")) == before
    changed = {"notification_quiet": 2}
    assert numbers_in(site.folder / "back") == [(name, changed.get(name, number)) for name, number in numbers]
    site.config.write_text('[server]\ndata = "back"\n')
    assert site.run("audit", "verify").exit_code == 0


def test_a_running_site_is_copied_and_finished_once_it_is_stopped(
    site: MovedSite, empty: StoreSettings
) -> None:
    site.add_blocks(40, 100)
    with site.served():
        first = site.migrate(empty.url, "--json")
        assert first.exit_code == 0, first.output
        *tables, end = map(json.loads, first.stdout.splitlines())
        assert not any(table["equal"] for table in tables)
        assert end["finished"] is False
        with pytest.raises(StoreError, match="not finished"):
            opened(empty)
        with pytest.raises(StoreError, match="not finished"):
            require_finished_database(empty)
        site.change(
            "main",
            "DELETE FROM users WHERE name = 'Ben'",
            "INSERT INTO users (name, role, secret_hash, created_at) VALUES ('Aa', 'viewer', '', 1)",
            "INSERT INTO sessions VALUES (x'01', 'Aa', 1, 1, 1)",
            "UPDATE users SET role = 'viewer' WHERE name = 'anna'",
            "DELETE FROM tokens",
            "INSERT INTO tokens VALUES (9, x'74', 'scada', 'viewer', 'anna', 1, NULL, NULL, 4)",
        )
        site.change(
            "history",
            "UPDATE raw SET data = x'00' WHERE id = 12",
            "DELETE FROM raw WHERE id % 5 = 1",
            "UPDATE raw SET data = x'01', points = 61 WHERE id = 40",
        )
        again = site.migrate(empty.url)
        assert again.exit_code == 0
        assert "not finished" in again.output
        assert rows_at(PostgresqlPlace(empty)) == rows_at(folder_of(site))
        site.change("history", "UPDATE raw SET data = x'02' WHERE id = 13", "DELETE FROM minutes")
    last = site.migrate(empty.url)
    assert last.exit_code == 0, last.output
    assert rows_at(PostgresqlPlace(empty)) == rows_at(folder_of(site))
    opened(empty).close()
    assert site.migrate(empty.url).exit_code == 1


def test_a_command_that_is_killed_goes_on_where_it_was(site: MovedSite, empty: StoreSettings) -> None:
    site.add_blocks(2000, 3000)
    command = ("migrate-store", "--to", empty.url, "--config", str(site.config))
    with (site.folder / "log").open("w") as log:
        process = fork_server.start(*command, stdout=log, stderr=log)
    end = time.monotonic() + 60
    with psycopg.connect(empty.url, autocommit=True) as watching:
        while not _copied(watching):
            assert time.monotonic() < end
            time.sleep(0.002)
        process.kill()
        process.wait()
        assert 0 < _copied(watching) < 2000
    ended = site.migrate(empty.url)
    assert ended.exit_code == 0, ended.output
    assert rows_at(PostgresqlPlace(empty)) == rows_at(folder_of(site))


def _copied(watching: psycopg.Connection) -> int:
    try:
        row = watching.execute("SELECT n FROM history.copying WHERE item = 'raw'").fetchone()
    except psycopg.errors.UndefinedTable:
        return 0
    return row[0] if row else 0


def test_a_difference_is_found_and_named(site: MovedSite, empty: StoreSettings) -> None:
    with site.served():
        assert site.migrate(empty.url).exit_code == 0
    with psycopg.connect(empty.url, autocommit=True) as database:
        database.execute(
            "SET search_path = history; CREATE FUNCTION spoil() RETURNS trigger LANGUAGE plpgsql AS"
            " $$BEGIN NEW.data = 'x'; RETURN NEW; END$$;"
            "CREATE TRIGGER spoil BEFORE INSERT ON raw FOR EACH ROW EXECUTE FUNCTION spoil()"
        )
    site.add_blocks(1, 10)
    ended = site.migrate(empty.url)
    assert ended.exit_code == 1
    assert "history.raw: NOT THE SAME" in ended.output
    assert "not the same as the source in history.raw" in ended.output
    with pytest.raises(StoreError, match="not finished"):
        opened(empty)


def test_a_lost_connection_is_named_and_the_copy_goes_on(
    site: MovedSite, empty: StoreSettings, monkeypatch: pytest.MonkeyPatch
) -> None:
    follow = migrate_store.SiteCopy.follow

    def cut(copy: migrate_store.SiteCopy) -> object:
        for step in follow(copy):
            yield step
            if step.part.name == "history":
                with psycopg.connect(empty.url, autocommit=True) as database:
                    database.execute(
                        "SELECT pg_terminate_backend(pid) FROM pg_stat_activity"
                        " WHERE datname = current_database() AND pid <> pg_backend_pid()"
                    )

    with monkeypatch.context() as patched:
        patched.setattr(migrate_store.SiteCopy, "follow", cut)
        ended = site.migrate(empty.url)
    assert ended.exit_code == 1
    assert "cannot be reached" in ended.output
    assert site.migrate(empty.url).exit_code == 0
    assert rows_at(PostgresqlPlace(empty)) == rows_at(folder_of(site))


def test_a_server_that_started_meanwhile_ends_the_copy(
    site: MovedSite, empty: StoreSettings, monkeypatch: pytest.MonkeyPatch
) -> None:
    refuse = migrate_store._refuse_changed

    def started(*given: object) -> None:
        site.run("token", "create", "late", "--role", "viewer")
        refuse(*given)  # type: ignore[arg-type]

    with monkeypatch.context() as patched:
        patched.setattr(migrate_store, "_refuse_changed", started)
        ended = site.migrate(empty.url)
    assert ended.exit_code == 1
    assert "a server used" in ended.output
    assert site.migrate(empty.url).exit_code == 0
    assert rows_at(PostgresqlPlace(empty)) == rows_at(folder_of(site))


def test_a_database_that_a_server_uses_is_not_finished(site: MovedSite, empty: StoreSettings) -> None:
    assert site.migrate(empty.url).exit_code == 0
    site.configure(f'[store]\nurl = "{empty.url}"\n')
    back = str(site.folder / "back")
    with closing(opened(empty)) as main:
        assert "used by a server" in site.migrate(back).output
        renewed = HomeRow("dry", "app-2", "i", 1, UnixTime(9e12), 0, "", NO_TIME, "", "", "", "", NO_TIME)
        row = upsert("home", HomeRow._fields[:1], HomeRow._fields[1:])
        main.write_now(lambda connection: connection.execute(row, renewed))
    assert "used by app-2" in site.migrate(back).output
    with closing(opened(empty)) as main:
        main.write_now(lambda connection: connection.execute("UPDATE home SET until = 0"))
    assert "is complete" in site.migrate(back).output


def test_a_terminal_shows_how_far_it_is(site: MovedSite, monkeypatch: pytest.MonkeyPatch) -> None:
    site.add_blocks(50, 10)
    monkeypatch.setattr(copy_report, "SHOW_EVERY_S", 0)
    monkeypatch.setattr(copy_report, "is_terminal", lambda: True)
    ended = site.migrate(str(site.folder / "copy"))
    assert ended.exit_code == 0, ended.output
    shown = re.findall(r"history.raw: (\d+) of 53 rows, (\d+) %, 0 MB, \d+ MB/s, \d+:\d\d left", ended.stderr)
    assert shown == [("16", "30")]
    assert "left" not in ended.stdout


def test_places_that_hold_something_else(site: MovedSite, empty: StoreSettings) -> None:
    with psycopg.connect(empty.url, autocommit=True) as database:
        database.execute("CREATE SCHEMA history CREATE TABLE invoices (id int)")
        foreign = site.migrate(empty.url)
        assert foreign.exit_code == 1
        assert "tables of another program (invoices)" in foreign.output
        database.execute("DROP SCHEMA history CASCADE")
        with site.served():
            assert site.migrate(empty.url).exit_code == 0
        database.execute("UPDATE main.copying SET mark = 'another' WHERE item = ''")
        assert "unfinished copy of another site" in site.migrate(empty.url).output
        database.execute("DROP TABLE main.copying, history.copying, pictures.copying")
        assert "holds a site already" in site.migrate(empty.url).output
        database.execute("INSERT INTO main.migrations VALUES (9000, 'later', 0)")
        assert "newer version" in site.migrate(empty.url).output
        database.execute("DROP SCHEMA main, history, pictures CASCADE; CREATE ROLE guest LOGIN")
        guest = empty.url.replace("lineside@", "guest@", 1)
    lacking = site.migrate(guest)
    assert lacking.exit_code == 1
    assert "lacks rights" in lacking.output
    assert site.migrate(empty.url.replace("/test_", "/no_")).exit_code == 1


def test_sources_that_cannot_be_copied(site: MovedSite, empty: StoreSettings, tmp_path: Path) -> None:
    site.change("main", "UPDATE recipe SET comment = 'a' || char(0)")
    nul = site.migrate(empty.url)
    assert nul.exit_code == 1
    assert "table recipe cannot be copied, rows with the keys (3,) to (3,)" in nul.output
    site.change("main", "UPDATE recipe SET comment = '', saved_at = 'soon'")
    assert "value of another type" in site.migrate(empty.url).output
    site.change("main", "UPDATE recipe SET saved_at = 1, comment = CAST(x'ff' AS TEXT)")
    assert "table recipe cannot be read" in site.migrate(empty.url).output
    site.change("main", "UPDATE recipe SET comment = ''")
    site.add_blocks(300, 3000)
    file = site.data / FILES["history"]
    content = bytearray(file.read_bytes())
    middle = len(content) // 2
    content[middle : middle + 65_536] = b"\xee" * 65_536
    sound = file.read_bytes()
    file.write_bytes(content)
    damaged = site.migrate(empty.url)
    assert damaged.exit_code == 1
    assert "table raw cannot be read after the key '(" in damaged.output
    file.write_bytes(sound)
    assert site.migrate(empty.url).exit_code == 0
    site.change("main", "DELETE FROM migrations WHERE number = (SELECT max(number) FROM migrations)")
    assert "older version" in site.migrate(str(tmp_path / "elsewhere")).output
    (site.data / FILES["main"]).unlink()
    assert "there is no store" in site.migrate(str(tmp_path / "elsewhere")).output
    assert not (tmp_path / "elsewhere").exists()


def test_wrong_use_and_no_space(site: MovedSite, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    for to in ("mysql://db/x", "postgresql:///", "", str(site.config), "sqlite", str(site.data)):
        ended = site.migrate(to)
        assert ended.exit_code == 2, to
        assert "--to" in ended.output
    assert site.migrate(str(tmp_path), "--password-file", "x").exit_code == 2
    monkeypatch.setattr(migrate_store, "free_bytes", lambda _: 1000)
    full = site.migrate(str(tmp_path / "elsewhere"))
    assert full.exit_code == 1
    assert "make room" in full.output


def test_a_folder_to_a_folder_needs_no_database(site: MovedSite, tmp_path: Path) -> None:
    ended = site.migrate((tmp_path / "elsewhere").as_uri())
    assert ended.exit_code == 0, ended.output
    assert rows_at(Folder(tmp_path / "elsewhere")) == rows_at(folder_of(site))
    assert (tmp_path / "elsewhere").stat().st_mode & 0o077 == 0


async def test_events_that_are_archived_between_two_copies_leave_the_copy(
    empty: StoreSettings, tmp_path: Path
) -> None:
    """A command goes after its result, on both engines."""
    site = MovedSite(tmp_path / "site")
    for folder in (site.folder, site.data, tmp_path / "archive"):
        folder.mkdir()
    site.configure(f'[audit]\narchive = "{tmp_path}/archive"\n')
    settings, now = load(site.config), UnixTime(1_768_000_000.0)
    with closing(SqliteDatabase(site.data / FILES["main"])) as main:
        keys = open_keys(settings.key_files, main.file, main.read_now(heads_of))
        events = EventLog(main, lambda: now, keys)
        for _ in range(4):
            commands = [
                await intend(events, bus="dry-end", unit=unit, who="ann", origin="api", what="set speed")
                for unit in range(1, 201)
            ]
            await events.conclude_together(dict.fromkeys(commands, ("verified", "")))
            now += 31 * 86_400.0
        with site.served():
            assert site.migrate(empty.url).exit_code == 0
        zone = ZoneInfo("Europe/Berlin")
        archive = EventArchive(main, events, settings.audit.archive, 2, zone, lambda: now)
        await archive.archive_due()
        assert archive.failing is None
    there = site.migrate(empty.url)
    assert there.exit_code == 0, there.output
    site.configure(f'[store]\nurl = "{empty.url}"\n[audit]\narchive = "{tmp_path}/archive"\n')
    assert site.run("audit", "verify").exit_code == 0
