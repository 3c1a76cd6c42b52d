"""A site whose stores are copied: files with a row in most tables, and its configuration."""

from __future__ import annotations

import fcntl
import os
import sqlite3
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

from click.testing import CliRunner, Result

from app.cli import cli
from app.cli.stores.migrate_store import PARTS
from app.database import SqliteDatabase
from app.database.copying.places import Folder, StorePlace
from app.database.copying.statements import quoted
from app.database.copying.tables import tables_of
from app.handover.notes.pictures import MIGRATIONS as PICTURE_STEPS
from app.history.series.runs import HOUR
from tests.app.history_line import NOON, Shelf, polls

FILES = {part.name: part.file for part in PARTS}
Rows = dict[str, list[bytes]]


class MovedSite:
    """The site in a folder."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.data, self.config = folder, folder / "data", folder / "lineside.toml"

    def make(self) -> None:
        """Its stores, by what writes them."""
        self.folder.mkdir(exist_ok=True)
        self.configure()
        secret = "correct horse battery\n"
        assert not self.run(
            "user", "add", "anna", "--role", "admin", "--password-stdin", secret=secret
        ).exit_code
        with closing(SqliteDatabase(self.data / FILES["main"])) as main:
            main.write_now(_fill_main)
        shelf = Shelf(self.data / FILES["history"])
        shelf.keep(polls(NOON, NOON + 150))
        shelf.fold()
        shelf.close()
        with closing(SqliteDatabase(self.data / FILES["pictures"], PICTURE_STEPS)) as pictures:
            row = ("d1", "image/png", bytes(range(256)))
            pictures.write_now(
                lambda connection: connection.execute("INSERT INTO picture VALUES (?, ?, ?)", row)
            )

    def configure(self, extra: str = "") -> None:
        self.config.write_text(f'[server]\ndata = "./data"\n{extra}')

    def run(self, *words: str, secret: str | None = None) -> Result:
        return CliRunner().invoke(cli, [*words, "--config", str(self.config)], input=secret)

    def migrate(self, to: str, *options: str) -> Result:
        return self.run("migrate-store", "--to", to, *options)

    @contextmanager
    def served(self) -> Iterator[None]:
        """As while a server has the data folder."""
        with (self.data / "lock").open("a") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            yield

    def change(self, store: str, *statements: str) -> None:
        with closing(sqlite3.connect(self.data / FILES[store])) as connection, connection:
            connection.execute("PRAGMA foreign_keys = ON")
            for statement in statements:
                connection.execute(statement)

    def add_blocks(self, count: int, size: int) -> None:
        """Hours of history of ten units, of so many bytes each."""
        with closing(sqlite3.connect(self.data / FILES["history"])) as connection, connection:
            connection.executemany(
                "INSERT OR IGNORE INTO unit (bus, number) VALUES ('wet', ?)", [(unit,) for unit in range(10)]
            )
            connection.executemany(
                "INSERT INTO raw (unit, start, span, points, data)"
                " VALUES ((SELECT id FROM unit WHERE bus = 'wet' AND number = ?), ?, ?, 60, ?)",
                [(hour % 10, hour * HOUR, HOUR, os.urandom(size)) for hour in range(count)],
            )


def rows_at(place: StorePlace) -> dict[str, Rows]:
    """Every row of each table of each store, as rows are compared."""
    found: dict[str, Rows] = {}
    for part in PARTS:
        with place.reading(part) as side:
            found[part.name] = {
                table.name: [*side.chunk(table, None, 100_000).forms.values()]
                for table in tables_of(part.steps)
            }
    return found


def numbers_in(folder: Path) -> list[Any]:
    """The highest number that SQLite gave in each table that remembers it."""
    with closing(sqlite3.connect(folder / FILES["main"])) as store:
        return store.execute(f"SELECT * FROM {quoted('sqlite_sequence')} ORDER BY name").fetchall()


def folder_of(site: MovedSite) -> Folder:
    return Folder(site.data)


def _fill_main(connection: Any) -> None:
    run = connection.execute
    run("INSERT INTO users (name, role, secret_hash, created_at) VALUES ('Ben', 'viewer', '', 0.1)")
    run("INSERT INTO users (name, role, secret_hash, created_at) VALUES ('Äbc', 'viewer', '', 1e-300)")
    run("INSERT INTO sessions VALUES (?, 'anna', 1.5, 2.25, 1e300)", (b"\x00\xff",))
    run("INSERT INTO sessions VALUES (?, 'Ben', 1.5, 2.25, 3)", (b"",))
    run("INSERT INTO tokens VALUES (5, ?, 'scada', 'viewer', 'anna', 1, NULL, NULL, 4)", (b"t",))
    run("INSERT INTO parameter_set VALUES (7, 'dry', 'Grün', '', 1.0, 'anna', '')")
    run("INSERT INTO parameter_set_unit VALUES (7, 1, 'Unwind')")
    run("INSERT INTO parameter_set_row VALUES (7, 1, 2, NULL, 0, -0.0, ?)", (b"",))
    run("INSERT INTO recipe VALUES (3, 'dry', 'A', 1, '', 'anna', 1.0, 0)")
    run("INSERT INTO notification_quiet (bus, starts, ends, who, reason) VALUES (NULL, 1, 2, 'anna', '')")
    run("DELETE FROM notification_quiet")
    for number in range(3):
        columns = "at, written_at, who, text, sender, corrects"
        values = (number, 1.0, "a", "x", f"{number}", number or None)
        run(f"INSERT INTO shift_note ({columns}) VALUES (?, ?, ?, ?, ?, ?)", values)
