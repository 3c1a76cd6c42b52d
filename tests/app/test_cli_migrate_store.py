"""migrate-store: both ways over PostgreSQL, while a server uses the source, and for what it refuses."""

from __future__ import annotations

import fcntl
import json
import sqlite3
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import pytest
from click.testing import Result
from typer.testing import CliRunner

from app.cli import cli
from app.database import SqliteDatabase
from app.database.copying.tables import tables_of
from app.database.postgresql.database import PostgresqlDatabase
from app.database.settings import StoreSettings
from app.errors import StoreError
from app.handover.pictures import MIGRATIONS as PICTURE_STEPS
from app.history.intake.writer import MIGRATIONS as HISTORY_STEPS
from tests.app.history_line import NOON, Shelf, polls
from tests.postgresql import SCHEMAS, fresh_database, needs_postgresql

pytestmark = needs_postgresql
FILES = {"main": "lineside.db", "history": "history.db", "pictures": "pictures.db"}


class MovedSite:
    """A site in a folder, with a row in most tables, and its configuration."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.data = folder, folder / "data"
        self.config = folder / "lineside.toml"
        self.configure()
        self.run("user", "add", "anna", "--role", "admin", "--password-stdin", input="correct horse battery\n")
        self.run("user", "add", "ben", "--role", "viewer", "--password-stdin", input="another long secret\n")
        self.run("token", "create", "scada", "--role", "viewer")
        with closing(SqliteDatabase(self.data / FILES["main"])) as main:
            main.write_now(_fill_main)
        shelf = Shelf(self.data / FILES["history"])
        shelf.keep(polls(NOON, NOON + 150))
        shelf.fold()
        shelf.close()
        with closing(SqliteDatabase(self.data / FILES["pictures"], PICTURE_STEPS)) as pictures:
            row = ("d1", "image/png", bytes(range(256)))
            pictures.write_now(lambda connection: connection.execute("INSERT INTO picture VALUES (?, ?, ?)", row))

    def configure(self, extra: str = "") -> None:
        self.config.write_text(f'[server]\ndata = "{self.data}"\n{extra}')

    def run(self, *words: str, input: str | None = None) -> Result:
        return CliRunner().invoke(cli, [*words, "--config", str(self.config)], input=input)

    def migrate(self, to: str, *options: str) -> Result:
        return self.run("migrate-store", "--to", to, *options)


def _fill_main(connection: Any) -> None:
    run = connection.execute
    run("INSERT INTO sessions VALUES (?, 'anna', 1.5, 2.25, 1e300)", (b"\x00\xff",))
    run("INSERT INTO parameter_set VALUES (7, 'dry', 'Grün', '', 1.0, 'anna', '')")
    run("INSERT INTO parameter_set_unit VALUES (7, 1, 'Unwind')")
    run("INSERT INTO parameter_set_row VALUES (7, 1, 2, NULL, 0, -0.0, ?)", (b"",))
    run("INSERT INTO recipe VALUES (3, 'dry', 'A', 1, '', 'anna', 1.0, 0)")
    run("INSERT INTO notification_quiet (bus, starts, ends, who, reason) VALUES (NULL, 1, 2, 'anna', '')")
    run("DELETE FROM notification_quiet")
    for number in range(3):
        run("INSERT INTO shift_note (at, written_at, who, text, sender) VALUES (?, 1, 'a', 'x', ?)", (number, f"{number}"))


def rows_in(path: Path) -> dict[str, list[Any]]:
    with closing(sqlite3.connect(path)) as store:
        names = [name for (name,) in store.execute("SELECT name FROM sqlite_master WHERE type = 'table'")]
        return {
            name: sorted(map(repr, store.execute(f'SELECT * FROM "{name}"'))) for name in names if name != "migrations"
        }


@pytest.fixture
def site(tmp_path: Path) -> MovedSite:
    return MovedSite(tmp_path)


@pytest.fixture
def empty() -> StoreSettings:
    return fresh_database(empty=True)


def test_a_site_is_the_same_after_it_went_into_postgresql_and_back(site: MovedSite, empty: StoreSettings) -> None:
    before = {name: rows_in(site.data / file) for name, file in FILES.items()}
    there = site.migrate(empty.url, "--json")
    assert there.exit_code == 0, there.output
    print(there.output)
    *tables, end = map(json.loads, there.stdout.splitlines())
    assert all(table["equal"] for table in tables)
    assert end["finished"] and end["audit_holds"]
    site.configure(f'[store]\nurl = "{empty.url}"\n')
    back = site.migrate(str(site.folder / "back"))
    assert back.exit_code == 0, back.output
    print(back.output)
    assert {name: rows_in(site.folder / "back" / file) for name, file in FILES.items()} == before
