"""An attacker who can write the store, but cannot read the key, rewrites the log: `audit verify`
detects it.
"""

from __future__ import annotations

import asyncio
import re
import shutil
import sqlite3
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from app.cli import cli
from app.core.database import Database
from app.people.audit.anchor import Anchoring
from app.people.audit.entry import (
    BEGINNING,
    END_ALTERED,
    OTHER_KEY,
    entry_hash,
    sealed_head,
)
from app.people.audit.keys import open_keys
from app.people.audit.log import EventLog
from app.people.audit.proof import heads_of

Row = dict[str, Any]
ENTRIES = 9
WITHOUT_ANCHOR = ("--anchor", "/dev/null")


class Plant:
    """A store with a log, its configuration, and the two who have to do with it."""

    def __init__(self, folder: Path) -> None:
        self.config = folder / "lineside.toml"
        self.store = folder / "data" / "lineside.db"
        self.key = folder / "lineside.audit.key"
        self.key_anchor = folder / "lineside.audit.key.anchor"
        self.anchor = folder / "anchor"
        self.config.write_text('[server]\ndata = "data"\n[audit]\nanchor = "anchor"\n')

    def work(self, entries: int = ENTRIES) -> None:
        """The server writes so many entries, and anchors the last."""
        asyncio.run(self._work(entries))

    async def _work(self, entries: int) -> None:
        database = Database(self.store)
        try:
            keys = open_keys([self.key], self.store, await database.read(heads_of))
            log = EventLog(database, keys=keys)
            for number in range(entries):
                await log.record(kind="estop", what=f"e-stop {number}", bus="dry-end", unit=1)
            await Anchoring(log, self.anchor).export()
        finally:
            database.close()

    def attack(self, *statements: str) -> None:
        """Write the store past every trigger."""
        with closing(sqlite3.connect(self.store)) as connection:
            for (name,) in connection.execute(
                "SELECT name FROM sqlite_master WHERE type = 'trigger'"
            ).fetchall():
                connection.execute(f"DROP TRIGGER {name}")
            for statement in statements:
                connection.execute(statement)
            connection.commit()

    def rebuild(self, change: Callable[[list[Row]], list[Row]], *, key: str | None = None) -> None:
        """Replace the log by a changed one in which every hash fits; ``key``: the key that it claims."""
        with closing(sqlite3.connect(self.store)) as connection:
            connection.row_factory = sqlite3.Row
            rows = change([dict(row) for row in connection.execute("SELECT * FROM events ORDER BY id")])
            number, previous = 0, BEGINNING
            self.attack("DELETE FROM events")
            for number, row in enumerate(rows, start=1):
                row |= {"id": number, "previous": previous} | ({} if key is None else {"key": key})
                row["hash"] = previous = entry_hash(previous, row)
                marks = ", ".join("?" * len(row))
                connection.execute(f"INSERT INTO events ({', '.join(row)}) VALUES ({marks})", [*row.values()])
            connection.execute("UPDATE events_head SET id = ?, hash = ?", (number, previous))
            if key is not None:
                connection.execute("UPDATE events_head SET key = ?, seal = ''", (key,))
            connection.commit()

    @property
    def cut_off(self) -> tuple[str, str]:
        """SQL that removes the newest entries and sets the end back."""
        return (
            "DELETE FROM events WHERE id > 5",
            "UPDATE events_head SET id = 5, hash = (SELECT hash FROM events WHERE id = 5)",
        )

    def copy_store(self, path: Path) -> None:
        """The store as it is now."""
        with closing(sqlite3.connect(self.store)) as connection:
            connection.execute("VACUUM INTO ?", (str(path),))

    def put_back(self, path: Path) -> None:
        """Put a copy in the place of the store."""
        for companion in ("-wal", "-shm"):
            self.store.with_name(self.store.name + companion).unlink(missing_ok=True)
        shutil.copy(path, self.store)

    def verify(self, *options: str) -> tuple[int, str]:
        """Return the exit code of ``audit verify``, and its output."""
        done = CliRunner().invoke(cli, ["audit", "verify", "--config", str(self.config), *options])
        return done.exit_code, done.output

    def broken_at(self, *options: str) -> str:
        """Return the fault of the log; fail if there is none."""
        code, printed = self.verify(*options)
        assert code == 1, printed
        return re.sub(r"^lineside: the audit log is broken at entry ", "", printed)


@pytest.fixture
def plant(tmp_path: Path) -> Plant:
    made = Plant(tmp_path)
    made.work()
    assert made.verify()[0] == 0
    return made


def changed(rows: list[Row]) -> list[Row]:
    rows[3]["what"] = "nothing happened"
    return rows


@pytest.mark.parametrize(
    "change",
    [changed, lambda rows: rows[:3] + rows[4:], lambda rows: [*rows[:3], dict(rows[0]), *rows[3:]]],
    ids=["changed", "removed", "put in"],
)
def test_an_entry_is_another_and_every_hash_made_to_fit(
    plant: Plant, change: Callable[[list[Row]], list[Row]]
) -> None:
    plant.rebuild(change)
    assert plant.broken_at().startswith("4: ")


@pytest.mark.parametrize(("name", "fault"), [("anchor", "No such file"), ("key", "there is no audit key")])
def test_the_anchor_or_the_key_is_gone(plant: Plant, name: str, fault: str) -> None:
    getattr(plant, name).unlink()
    code, printed = plant.verify()
    assert (code, fault in printed) == (1, True)


def test_the_newest_entries_are_cut_off_and_the_server_goes_on(plant: Plant) -> None:
    """The anchor is not even needed: the server notes in the log itself that the end had no seal."""
    plant.attack(*plant.cut_off)
    plant.work(1)
    with closing(sqlite3.connect(plant.store)) as connection:
        (what,) = connection.execute("SELECT what FROM events WHERE id = 6").fetchone()
    assert what == str(END_ALTERED)
    assert plant.broken_at(*WITHOUT_ANCHOR).startswith("6: ")


def test_an_earlier_copy_of_the_store_is_put_in_its_place(plant: Plant, tmp_path: Path) -> None:
    """Consistent in itself: only the anchor detects it."""
    plant.copy_store(tmp_path / "earlier.db")
    plant.work()
    plant.put_back(tmp_path / "earlier.db")
    assert "but the anchor names entry 18" in plant.broken_at()
    plant.work(12)
    assert "is not the one that the anchor names" in plant.broken_at()


def test_so_are_earlier_copies_of_the_store_and_of_its_anchor(plant: Plant, tmp_path: Path) -> None:
    """Only a copy that is out of reach detects it."""
    plant.copy_store(tmp_path / "earlier.db")
    earlier = plant.anchor.read_bytes()
    plant.work()
    copy = tmp_path / "copy.anchor"
    shutil.copy(plant.anchor, copy)
    plant.put_back(tmp_path / "earlier.db")
    plant.anchor.write_bytes(earlier)
    assert plant.verify()[0] == 0
    assert "but the anchor names entry 18" in plant.broken_at("--anchor", str(copy))


def test_a_text_is_no_text(plant: Plant) -> None:
    plant.attack("UPDATE events SET what = CAST(x'ff00fe' AS TEXT) WHERE id = 3")
    assert plant.broken_at().startswith("3: ")


def test_a_line_of_the_anchor_is_forged(plant: Plant) -> None:
    plant.anchor.write_text(plant.anchor.read_text().replace('"id":9', '"id":8'))
    code, printed = plant.verify()
    assert (code, "line 1 of" in printed) == (1, True)


def test_a_new_key_vouches_for_the_log_from_then_on_only(plant: Plant) -> None:
    """As after a move to another machine without the key. That there is another one is in the log."""
    plant.key.unlink()
    plant.anchor.unlink()
    plant.work(2)
    code, printed = plant.verify()
    assert code == 0
    assert "entries 1 to 9 are older than the key" in printed
    with closing(sqlite3.connect(plant.store)) as connection:
        assert connection.execute("SELECT what FROM events WHERE id = 10").fetchone() == (str(OTHER_KEY),)
    plant.attack("UPDATE events SET what = 'nothing happened' WHERE id = 4")
    assert plant.broken_at().startswith("4: ")


def test_after_a_rotation_the_older_key_forges_nothing(plant: Plant) -> None:
    older = plant.key.read_bytes()
    rotated = CliRunner().invoke(cli, ["audit", "rotate-key", "--config", str(plant.config)])
    assert rotated.exit_code == 0, rotated.output
    plant.work(2)
    assert plant.verify()[0] == 0
    assert plant.key.stat().st_mode & 0o777 == 0o600
    newer = plant.key.read_bytes()
    assert older != newer
    # With the older key any end of the log can be sealed, continuing from before the rotation.
    plant.attack("DELETE FROM events WHERE id > 9", "DELETE FROM events_head")
    plant.key.write_bytes(older)
    ring = open_keys([plant.key], plant.store, {}).ring
    with closing(sqlite3.connect(plant.store)) as connection:
        (digest,) = connection.execute("SELECT hash FROM events WHERE id = 9").fetchone()
        head = sealed_head({"id": 9, "hash": digest}, ring)
        connection.execute(
            "INSERT INTO events_head (chain, id, hash, key, seal) VALUES ('', 9, ?, ?, ?)",
            (digest, ring.newest, head.seal),
        )
        connection.commit()
    plant.work(2)
    assert plant.verify(*WITHOUT_ANCHOR)[0] == 0, "to the older key alone all is well"
    plant.key.write_bytes(newer)
    assert "the log ends before that key" in plant.broken_at(*WITHOUT_ANCHOR)
