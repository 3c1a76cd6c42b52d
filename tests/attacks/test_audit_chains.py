"""An attacker who can write the store, but cannot read the key, takes the chains of a log of 0.2 apart,
before or after it goes on as one chain: whatever is changed, removed, moved or put back is found.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from app.core.database import Database
from app.people.audit.entry import KeyOrigin, KeyRing, sealed_entry, sealed_head
from app.people.audit.keys import make_key_file, owners_of, read_key_file
from tests.app.former_log import DRY, SITE, WET, FormerLog
from tests.attacks.test_audit_log import WITHOUT_ANCHOR, Plant

Row = dict[str, Any]


class FormerPlant(Plant):
    """A plant with two buses, whose log 0.2 has written: ids 1 to 9. Entry 1 begins the chain of the first,
    2 that of the second."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        make_key_file(self.key, KeyOrigin())
        self.store.parent.mkdir(exist_ok=True)
        with closing(Database(self.store)) as database:
            former = FormerLog(database, self.ring())
            former.work()
            self.anchor.write_bytes(former.anchor_line())

    def ring(self) -> KeyRing:
        ring = read_key_file(self.key, owners_of(None))
        assert ring is not None
        return ring

    def rows(self, query: str) -> list[Row]:
        with closing(sqlite3.connect(self.store)) as connection:
            connection.row_factory = sqlite3.Row
            return [dict(row) for row in connection.execute(query)]

    def put(self, table: str, *rows: Row) -> None:
        """Write rows, each in the place of one with the same key."""
        self.attack()
        with closing(sqlite3.connect(self.store)) as connection:
            for row in rows:
                marks = ", ".join("?" * len(row))
                columns = ", ".join(row)
                connection.execute(
                    f"INSERT OR REPLACE INTO {table} ({columns}) VALUES ({marks})", [*row.values()]
                )
            connection.commit()

    def reseal(self, chain: str, change: Callable[[Row], Row], ring: KeyRing) -> None:
        """Change the entries of a chain of 0.2 from number 5 on, sealed with a ring, and its end."""
        rows = self.rows(f"SELECT * FROM events WHERE chain = '{chain}' AND id >= 5 ORDER BY id")
        previous = rows[0]["previous"]
        for row in rows:
            row |= sealed_entry(previous, change(row), ring)
            previous = row["hash"]
        self.put("events", *rows)
        head = sealed_head(rows[-1], ring, chain)
        self.put("events_head", {**vars(head)})

    def found(self, *options: str) -> str:
        return self.broken_at(*(options or WITHOUT_ANCHOR)).replace("\n", " ")


@pytest.fixture(params=[False, True], ids=["as 0.2 left it", "after it goes on as one chain"])
def plant(tmp_path: Path, request: pytest.FixtureRequest) -> FormerPlant:
    made = FormerPlant(tmp_path)
    assert made.verify()[0] == 0
    if request.param:
        made.work(3)
        assert made.verify()[0] == 0
    return made


def nothing(row: Row) -> Row:
    return row | {"what": "nothing happened"}


@pytest.mark.parametrize("number", [1, 5, 9])
def test_an_entry_is_changed(plant: FormerPlant, number: int) -> None:
    plant.attack(f"UPDATE events SET what = 'nothing happened' WHERE id = {number}")
    assert plant.found().startswith(f"{number}: ")


@pytest.mark.parametrize("number", [1, 5, 9])
def test_an_entry_is_removed(plant: FormerPlant, number: int) -> None:
    plant.attack(f"DELETE FROM events WHERE id = {number}")
    assert plant.found().startswith(f"{number}: ")


@pytest.mark.parametrize("chain", [DRY, WET, SITE])
def test_a_complete_chain_is_removed(plant: FormerPlant, chain: str) -> None:
    plant.attack(
        f"DELETE FROM events WHERE chain = '{chain}'", f"DELETE FROM events_head WHERE chain = '{chain}'"
    )
    assert "is missing" in plant.found() or "were written" in plant.found()


@pytest.mark.parametrize(("number", "to"), [(5, DRY), (4, SITE), (7, None)])
def test_an_entry_is_moved_to_another_chain(plant: FormerPlant, number: int, to: str | None) -> None:
    chain = "NULL" if to is None else f"'{to}'"
    plant.attack(f"UPDATE events SET chain = {chain} WHERE id = {number}")
    assert plant.found().startswith(f"{number}: ")


def test_the_end_of_one_chain_is_put_back(plant: FormerPlant) -> None:
    """With an end that was sealed: only the numbers that are missing show it."""
    four = plant.rows("SELECT * FROM events WHERE id = 4")[0]
    plant.attack("DELETE FROM events WHERE id = 7")
    plant.put("events_head", {**vars(sealed_head(four, plant.ring(), DRY))})
    assert "entry 7 is missing" in plant.found()


def test_a_chain_is_cut_off_before_the_log_goes_on(tmp_path: Path) -> None:
    """The server seals the ends that were noted, and an entry that is missing stays missing."""
    plant = FormerPlant(tmp_path)
    plant.attack("DELETE FROM events WHERE id >= 8")
    plant.work(3)
    assert "entry 8 is missing" in plant.found()


def test_an_entry_is_added_behind_the_ends_before_the_log_goes_on(tmp_path: Path) -> None:
    plant = FormerPlant(tmp_path)
    [row] = plant.rows("SELECT * FROM events WHERE id = 7")
    plant.put("events", row | {"id": 10})
    plant.work(3)
    assert plant.found().startswith("10: ")
    plant.attack("DELETE FROM events WHERE id = 10")
    assert "entry 10 is missing" in plant.found()


def test_with_the_key_a_former_chain_is_rewritten_up_to_what_an_anchor_names(tmp_path: Path) -> None:
    plant = FormerPlant(tmp_path)
    plant.reseal(WET, nothing, plant.ring())
    assert plant.verify(*WITHOUT_ANCHOR)[0] == 0, "no seal shows it"
    assert "entry 8 is not the one that the anchor names" in plant.found("--anchor", str(plant.anchor))


def test_with_the_key_no_former_chain_is_rewritten_once_the_log_went_on(tmp_path: Path) -> None:
    """The entry that continues the chains seals how they ended."""
    plant = FormerPlant(tmp_path)
    plant.work(3)
    plant.reseal(WET, nothing, plant.ring())
    assert plant.found().startswith("10: entry 10 does not continue the one before it")


def test_a_seal_of_an_end_is_of_its_chain_alone() -> None:
    ring = KeyRing((b"k" * 32,))
    seals = {sealed_head({"id": 1, "hash": "a" * 64}, ring, chain).seal for chain in (SITE, DRY, WET)}
    assert len(seals) == 3
    assert ring.seal("head", "1", "a" * 64) in seals, "as the first versions sealed it"
